# SPDX-License-Identifier: Apache-2.0
"""Objects of the piles: each is one solid or a union of convex parts, which are both what collides and what the camera sees.

Boxes, cans and balls are shapes of the simulator. Hollow bowls, mugs with a handle and bottles with a neck are turned
profiles cut into convex parts. Objects of the YCB set come from the convex parts in `FORETOUCH_DATA/ycb`, where they are.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull

from foretouch.types import Float64, Int64

_SECTORS: Final = 32  # of a hollow solid
BANDS: Final = 4  # of its height
_SHRINK: Final = 1.0 - 1e-5  # of each part about its middle, so that no two parts have an edge in common

#: Solid of the physics that stands for a shape of the simulator.
SOLIDS: Final = {"box": "box", "can": "cylinder", "ball": "sphere"}


@dataclass(frozen=True, eq=False)
class Model:
    """One object.

    Attributes:
        name: Of the object.
        shape: Of the simulator, or empty.
        size: (3,) float64, edges of its bounding box [m].
        parts: (V, 3) float64 vertices of each convex part about the middle of that box [m]; none for a shape.
        flat: Whether it stands and has a flat top, so that others can stand on it.
    """

    name: str
    shape: str
    size: Float64
    parts: tuple[Float64, ...] = ()
    flat: bool = False

    def scaled(self, factor: float) -> "Model":
        """The same object, larger or smaller."""
        return replace(self, size=self.size * factor, parts=tuple(part * factor for part in self.parts))


def catalogue(ycb: Path | None) -> dict[str, Model]:
    """All objects by name, those of the YCB set only where their folder is."""
    models = [*_shapes(), *_turned()]
    if ycb is not None and ycb.is_dir():
        models += [_ycb(folder) for folder in sorted(ycb.iterdir()) if (folder / "collision_vhacd.obj").is_file()]
    return {model.name: model for model in models}


def _shapes() -> Iterator[Model]:
    yield Model("carton", "box", np.array([0.06, 0.10, 0.15]), flat=True)
    yield Model("packet", "box", np.array([0.03, 0.09, 0.14]), flat=True)
    yield Model("block", "box", np.array([0.07, 0.08, 0.06]), flat=True)
    yield Model("tin", "can", np.array([0.075, 0.075, 0.10]), flat=True)
    yield Model("flat_tin", "can", np.array([0.085, 0.085, 0.04]), flat=True)
    yield Model("tube", "can", np.array([0.05, 0.05, 0.16]))
    yield Model("ball", "ball", np.array([0.07, 0.07, 0.07]))


def _turned() -> Iterator[Model]:
    angle = np.linspace(0.0, np.pi / 2.0, 4 * BANDS + 1)
    bowl = np.stack([0.030 + 0.042 * np.sin(angle), 0.055 * (1.0 - np.cos(angle))], axis=1)
    yield centred("bowl", hollow(bowl, 0.004))
    dish = np.stack([0.050 + 0.040 * np.sin(angle), 0.035 * (1.0 - np.cos(angle))], axis=1)
    yield centred("dish", hollow(dish, 0.004))
    wall = np.stack([np.full(BANDS + 1, 0.040), np.linspace(0.0, 0.095, BANDS + 1)], axis=1)
    yield centred("mug", [*hollow(wall, 0.004), *handle(0.040, 0.050, 0.028)])
    conical = np.stack([np.linspace(0.030, 0.043, BANDS + 1), np.linspace(0.0, 0.080, BANDS + 1)], axis=1)
    yield centred("cup", [*hollow(conical, 0.004), *handle(0.036, 0.042, 0.022)])
    yield centred("bottle", turned([(0.033, 0.0), (0.035, 0.004), (0.035, 0.115), (0.030, 0.135), (0.013, 0.160), (0.013, 0.200), (0.015, 0.201), (0.015, 0.212)]))  # fmt: skip
    yield centred("flask", turned([(0.040, 0.0), (0.042, 0.004), (0.042, 0.075), (0.036, 0.090), (0.020, 0.105), (0.018, 0.130), (0.022, 0.131), (0.022, 0.150)]))  # fmt: skip


def turned(profile: list[tuple[float, float]]) -> list[Float64]:
    """A solid of revolution as truncated cones, from (radius, height) bottom to top [m]."""
    rings = [_ring(radius, height, 2 * _SECTORS) for radius, height in profile]
    return [np.concatenate(pair) for pair in pairwise(rings)]


def hollow(outer: Float64, wall_m: float) -> list[Float64]:
    """A vessel as sectors of its wall and a bottom, from its outer profile (n, 2) of (radius, height), n = k bands + 1 [m]."""
    inner = outer - (wall_m, 0.0)
    inner[:, 1] = wall_m + outer[:, 1] * (1.0 - wall_m / outer[-1, 1])
    bottom = [_ring(outer[0, 0], 0.0, 2 * _SECTORS), _ring(outer[0, 0], wall_m, 2 * _SECTORS)]
    parts = [np.concatenate(bottom)]
    step = (len(outer) - 1) // BANDS
    for start in range(0, len(outer) - 1, step):
        band = slice(start, start + step + 1)
        for sector in range(_SECTORS):
            angle = 2.0 * np.pi / _SECTORS * (sector + np.array([0.0, 0.5, 1.0]))
            parts.append(np.concatenate([_arc(outer[band], angle), _arc(inner[band], angle[[0, 2]])]))
    return parts


def handle(radius: float, middle: float, reach: float) -> list[Float64]:
    """A handle beside a wall of a radius, about a height, that reaches so far out [m]: half a ring of straight pieces."""
    bend = np.linspace(-np.pi / 2.0, np.pi / 2.0, 11)
    path = np.stack([radius - 0.002 + reach * np.cos(bend), np.zeros(11), middle + reach * np.sin(bend)], axis=1)
    outward = np.stack([np.cos(bend), np.zeros(11), np.sin(bend)], axis=1)
    half = 0.004 * outward[:, None] * np.array([-1.0, 1.0])[:, None]
    edges = (path[:, None] + half)[:, :, None] + np.array([[0.0, -0.006, 0.0], [0.0, 0.006, 0.0]])
    corners = edges.reshape(11, 4, 3)
    return [corners[k : k + 2].reshape(-1, 3) for k in range(10)]


def _ring(radius: float, height: float, count: int) -> Float64:
    return _arc(np.array([[radius, height]]), np.linspace(0.0, 2.0 * np.pi, count, endpoint=False))


def _arc(profile: Float64, angle: Float64) -> Float64:
    radius, height = np.repeat(profile, len(angle), axis=0).T
    angle = np.tile(angle, len(profile))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


def _ycb(folder: Path) -> Model:
    """One object of the set, from the vertices of its convex parts."""
    parts: list[list[list[float]]] = [[]]
    for line in (folder / "collision_vhacd.obj").read_text(encoding="utf-8").splitlines():
        if line.startswith("o "):
            parts.append([])
        elif line.startswith("v "):
            parts[-1].append([float(word) for word in line.split()[1:4]])
    flat = folder.name in {"CrackerBox", "FoamBrick", "MasterChefCan"}
    return replace(centred(folder.name, [np.array(part) for part in parts if part]), flat=flat)


def centred(name: str, parts: list[Float64]) -> Model:
    every = np.concatenate(parts)
    low, high = every.min(axis=0), every.max(axis=0)
    return Model(name, "", high - low, tuple(part - (low + high) / 2.0 for part in parts))


def hull(part: Float64) -> tuple[Float64, Int64]:
    """Vertices and faces of a convex part, counter-clockwise seen from outside."""
    found = ConvexHull(part)
    used = np.unique(found.simplices)
    vertices = part[used]
    vertices = vertices.mean(axis=0) + _SHRINK * (vertices - vertices.mean(axis=0))
    faces = np.searchsorted(used, found.simplices)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces.astype(np.int64)


def write_mesh(model: Model, folder: Path) -> str:
    """The shape of the simulator for a model: its own, or a mesh file that is written into a folder."""
    if model.shape:
        return model.shape
    vertices, faces, first = [], [], 1
    for part in model.parts:
        corners, triangles = hull(part)
        vertices += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in corners]
        faces += [f"f {a} {b} {c}" for a, b, c in triangles + first]
        first += len(corners)
    path = folder / f"{model.name}.obj"
    text = "\n".join([*vertices, *faces, ""])
    path.write_text(text, encoding="utf-8")
    return f"{hashlib.sha256(text.encode()).hexdigest()}:{path}"
