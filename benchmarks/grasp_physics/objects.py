# SPDX-License-Identifier: Apache-2.0
"""Rigid objects made of convex parts, and their poses on the table z = 0."""

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, cKDTree

from foretouch.errors import FileError
from foretouch.types import Float64

PARTS = "collision_vhacd.obj"  # convex parts [m]
MASS = "model.urdf"  # holds the mass [kg]
SPREAD_M = 0.04  # objects stand up to this far from the world's origin, along x and along y
GAP_M = (0.01, 0.03)  # from an object to those around it
RARE = 0.01  # a pose of this probability or more may count as upright


@dataclass(frozen=True, eq=False)
class Item:
    """A rigid object of uniform density.

    Attributes:
        name: Its name, which also decides its random poses.
        parts: Its convex parts, each a closed mesh in the object's frame [m].
        mass_kg: Its mass.
    """

    name: str
    parts: tuple[trimesh.Trimesh, ...]
    mass_kg: float

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """The surfaces of all parts; those inside of another part are never met from outside."""
        return trimesh.util.concatenate(list(self.parts))

    def at(self, pose: Float64) -> trimesh.Trimesh:
        """Return the mesh at a pose (4, 4), object to world."""
        moved = self.mesh.copy()
        moved.apply_transform(pose)
        return moved

    @cached_property
    def centre(self) -> Float64:
        """(3,) float64, centre of mass in the object's frame [m]."""
        volumes = np.array([part.volume for part in self.parts])
        centres = np.array([part.center_mass for part in self.parts])
        return np.asarray(volumes @ centres / volumes.sum(), np.float64)

    @cached_property
    def inertia(self) -> Float64:
        """(3, 3) float64, about the centre of mass [kg m²], by the parallel axes of the parts."""
        total = np.zeros((3, 3))
        for part in self.parts:
            arm = part.center_mass - self.centre
            total += part.moment_inertia + part.volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return np.asarray(self.mass_kg * total / sum(part.volume for part in self.parts), np.float64)

    @cached_property
    def _rests(self) -> tuple[Float64, Float64]:
        """(n, 4, 4) poses at rest on the table, and the (n,) probability of each."""
        poses, probabilities = trimesh.poses.compute_stable_poses(
            self.mesh.convex_hull, center_mass=self.centre, sigma=0.0, n_samples=1, threshold=0.0
        )
        return poses, probabilities / probabilities.sum()

    def footprint(self, pose: Float64) -> Float64:
        """Return (n, 2) float64 points [m] around the convex hull of what stands at a pose (4, 4), seen from above, 2 mm apart or less."""
        flat = trimesh.transform_points(self.mesh.vertices, pose)[:, :2]
        corners = flat[ConvexHull(flat).vertices]
        ends = np.stack([corners, np.roll(corners, -1, axis=0)])
        steps = [np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / 0.002)) for a, b in zip(*ends, strict=True)]
        return np.concatenate(steps)

    def random(self, number: int) -> np.random.Generator:
        """Return the random numbers of one pose, whatever other objects there are."""
        return np.random.default_rng([zlib.crc32(self.name.encode()), number])

    def pose(self, number: int) -> Float64:
        """Return (4, 4) float64 pose at rest: even ones upright (the highest centre of mass), odd ones as it falls."""
        poses, probabilities = self._rests
        rng = self.random(number)
        heights = poses[:, 2, :3] @ self.centre + poses[:, 2, 3]
        likely = probabilities >= min(RARE, float(probabilities.max()))
        upright = int(np.argmax(np.where(likely, heights, -np.inf)))
        rest = poses[rng.choice(len(poses), p=probabilities) if number % 2 else upright]
        turned = trimesh.transformations.rotation_matrix(rng.uniform(0.0, 2.0 * np.pi), [0.0, 0.0, 1.0]) @ rest
        return placed(self, turned, rng.uniform(-SPREAD_M, SPREAD_M, 2))


def placed(item: Item, pose: Float64, at: Float64) -> Float64:
    """Return the pose (4, 4) shifted so that the object stands on the table, the middle of its footprint at (2,) [m]."""
    vertices = trimesh.transform_points(item.mesh.vertices, pose)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    shifted = pose.copy()
    shifted[:3, 3] += [*(at - (low + high)[:2] / 2.0), -low[2]]
    return shifted


def read_item(folder: Path) -> Item:
    """Return an object from its folder."""
    loaded = trimesh.load(folder / PARTS, process=False, split_object=True, group_material=False)
    meshes = list(loaded.geometry.values()) if isinstance(loaded, trimesh.Scene) else [loaded]
    mass = re.search(r'mass value="([\d.]+)"', (folder / MASS).read_text(encoding="utf-8"))
    if mass is None:
        raise FileError(folder / MASS, "holds no mass")
    parts = tuple(trimesh.Trimesh(mesh.vertices, mesh.faces).convex_hull for mesh in meshes)
    return Item(folder.name, parts, float(mass[1]))


def read_items(folder: Path) -> list[Item]:
    """Return all objects of a folder, by name."""
    folders = sorted(path.parent for path in folder.glob(f"*/{PARTS}"))
    if not folders:
        raise FileError(folder, f"holds no folder with {PARTS}")
    return [read_item(item_folder) for item_folder in folders]


Placed = tuple[Item, Float64]
"""An object, and its pose (4, 4), object to world."""


def huddle(items: Sequence[Item], number: int) -> list[Placed]:
    """Return three different objects close together: the first at the world's origin, and 10 to 30 mm from it, or from each other, two neighbours.

    Args:
        items: To draw from.
        number: Of the scene; whatever it is, the objects stand as in `Item.pose`, half of them upright.
    """
    rng = np.random.default_rng([zlib.crc32(b"huddle"), number])
    first, *others = (items[k] for k in rng.permutation(len(items))[:3])
    stand = [(first, placed(first, first.pose(int(rng.integers(8))), np.zeros(2)))]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    for item in others:
        gap, start = rng.uniform(*GAP_M), item.pose(int(rng.integers(8)))
        trees = [cKDTree(one.footprint(pose)) for one, pose in stand]
        for away in np.arange(0.5, 0.0, -0.002):  # from outside, until it is as near as wanted
            pose = placed(item, start, away * np.array([np.cos(angle), np.sin(angle)]))
            if min(tree.query(item.footprint(pose))[0].min() for tree in trees) < gap:
                break
        stand.append((item, pose))
        angle += rng.uniform(*np.radians([100.0, 260.0]))
    return stand
