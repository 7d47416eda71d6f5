# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the simulator: meshes, grips, views, and every effect at zero and at its bounds."""

import dataclasses
import math
import typing
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from types import NoneType, UnionType
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting_infos
from foretouch.selftest.case import HardCase

_ABSURD = 1e300
_NOT_CLOSED = "not shared by two faces"
_NO_VOLUME = "encloses"


def simulator_cases() -> Iterator[HardCase]:
    """All cases of this module."""
    yield from mesh_cases()
    yield from scene_cases()
    yield from effect_cases()


# --- meshes -----------------------------------------------------------------------------------------------------


def mesh_cases() -> Iterator[HardCase]:
    """Meshes that are no solids, and solids of absurd size."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    sides = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    sides += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    faces = np.array(sides, np.int64)
    damaged = corners.copy()
    damaged[3, 1] = np.nan
    for name, vertices, triangles, reason in (
        ("flat", corners * [1.0, 1.0, 0.0], faces, "has no extent"),
        ("one point", corners * 0.0, faces, "has no extent"),
        ("open", corners, faces[1:], _NOT_CLOSED),
        ("inside out", corners, faces[:, ::-1], _NO_VOLUME),
        ("a NaN vertex", damaged, faces, "not finite"),
        ("an infinite vertex", np.where(corners > 0, np.inf, 0.0), faces, "not finite"),
        ("no face", corners, faces[:0], "no face|no triangle"),
        ("no vertex", corners[:0], faces[:0], "no face|no triangle|no vertex"),
        ("a face of no vertex", corners, faces + 1, "no vertex"),
        ("a negative index", corners, faces - 1, "no vertex"),
        ("a degenerate face", corners, np.concatenate([faces, [[0, 0, 0]]]), _NOT_CLOSED),
    ):
        yield HardCase(f"simulator: a mesh with {name}", partial(_unit_mesh, vertices, triangles), reason)
    for size in (1e-9, 1e3, 1e-300, 1e150):
        yield HardCase(
            f"simulator: a cube of {size:g} m",
            partial(_unit_mesh, size * corners, faces),
            right=lambda vertices: bool(np.allclose(np.abs(vertices), 0.5)),
        )


def _unit_mesh(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    from foretouch.simulation.objects import TriangleMesh

    mesh = TriangleMesh(vertices, faces).in_unit_box()
    mesh.require_closed("mesh")
    return mesh.vertices


# --- scenes -----------------------------------------------------------------------------------------------------

_CAN = {"name": "can", "shape": "can", "size_m": [0.07, 0.07, 0.1], "pose": {"rest": "side"}}
_SPONGE = {"name": "sponge", "shape": "sponge", "size_m": [0.07, 0.11, 0.05], "young_pa": 2e5, "thickness_m": 0.02}


def scene_cases() -> Iterator[HardCase]:
    """Scenes whose sample cannot be made, or is right nevertheless."""
    for size in (1e-9, 1e-3, 1e3):
        yield _scene(f"a can of {size:g} m", {"objects": [{**_CAN, "size_m": [size] * 3}]}, "size_m")
    yield _scene("a can wider than the hand", {"objects": [{**_CAN, "size_m": [0.2] * 3}]}, "the hand opens")
    yield _scene("a plate of 5 mm", {"objects": [{**_CAN, "shape": "box", "size_m": [0.12, 0.12, 0.005]}]}, "?")
    for force in (0.0, 5e-324, 1e-30, 1e300):
        reason = "" if force in (0.0, 1e-30) else "force_n"
        yield _scene(f"a force of {force:g} N", {"grasps": {"thumb": {"force_n": [force, force]}}}, reason)
    for depth in (0.0, 1e-12, 1.0):
        reason = "" if depth < 1.0 else "compressed by|given up|window is wide"
        grasps = {"control": "depth", "thumb": {"depth_m": [depth, depth]}}
        yield _scene(f"a depth of {depth:g} m", {"grasps": grasps}, reason)
    yield _scene("fingers far below the object", {"grasps": {"insertion_m": 0.9}}, "closes beside")
    yield _scene("fingers through the object", {"grasps": {"insertion_m": 0.035}}, "?")
    yield _scene("an object out of view", {"objects": [{**_CAN, "pose": {"x_m": [5.0, 5.0]}}]}, "outside of the view")
    yield _scene("a view of 16 x 16 pixels", {"camera": {"width": 16, "height": 16, "hfov_deg": 55.0}}, "?")
    yield _scene("a camera inside the object", {"camera": {"distance_m": 0.16}}, "outside of the view|given up")
    yield _scene("a camera 10 m away", {"camera": {"distance_m": 10.0}}, "?")
    holes = {"share": 0.5, "grazing_deg": 1.0}
    yield _scene("a view of holes alone", {"camera": {"holes": holes}}, "given up")
    yield _scene("a table of 1 mm", {"table": {"size_m": [1e-3, 1e-3]}}, "beside the table")
    yield _scene("an object without weight", {"gravity": {}, "objects": [{**_CAN, "mass_kg": 0.0}]}, "")
    yield _scene(
        "an object of 1e6 kg", {"gravity": {}, "objects": [{**_CAN, "mass_kg": 1e6}]}, "slips|falls|opens|given up"
    )


def effect_cases() -> Iterator[HardCase]:
    """Each group of effects with all of its settings at their lowest, at their highest, and at absurd values."""
    from foretouch.simulation.scene import SceneConfig

    for name, group in _groups(SceneConfig):
        for end in ("lowest", "highest", "absurd"):
            values = _ends(group, end)
            if not values or (name == "fingers.timeline" and end != "lowest"):
                continue  # a million messages are right, and take half a minute
            document: dict[str, Any] = values
            for word in reversed(name.split(".")):
                document = {word: document}
            if name in ("fingers.creep", "fingers.slip", "fingers.scan"):
                document["fingers"]["timeline"] = {}
            if name == "gravity":
                document["objects"] = [{**_CAN, "mass_kg": 0.1}]
            if name == "grasps.middle":
                document["grasps"]["balanced"] = False
            yield _scene(f"{name} at its {end} values", document, "?")


def _groups(config: type[Settings], prefix: str = "") -> Iterator[tuple[str, type[Settings]]]:
    """Dotted names and types of all groups of settings, optional ones too; not those of lists."""
    hints = typing.get_type_hints(config)
    for field in dataclasses.fields(config):
        kind = hints[field.name]
        if isinstance(kind, UnionType):
            kind = next(part for part in typing.get_args(kind) if part is not NoneType)
        if isinstance(kind, type) and issubclass(kind, Settings):
            yield prefix + field.name, kind
            yield from _groups(kind, f"{prefix}{field.name}.")


def _ends(group: type[Settings], end: str) -> dict[str, Any]:
    """The numbers of a group at one end of their bounds; `absurd` is 1e300 where there is none above."""
    values: dict[str, Any] = {}
    for info in setting_infos(group):
        bound = info.minimum if end == "lowest" else info.maximum
        if end == "absurd":
            bound = _ABSURD if bound is None and info.type is float else None
        if "." in info.name or info.type not in (int, float) or bound is None:
            continue
        value = info.type(bound)
        values[info.name] = [value] * len(info.default or (0, 0)) if info.is_list else value
    return values


def _scene(name: str, document: Mapping[str, Any], reason: str) -> HardCase:
    """A sample of a scene; with the reason `?` it may be refused by any name."""
    run: Callable[[], Any] = partial(_sample, document)
    if reason != "?":
        return HardCase(f"simulator: {name}", run, reason)

    def either() -> Any:
        from foretouch.errors import ForetouchError

        try:
            return run()
        except ForetouchError as err:
            return "" if len(str(err)) < 500 else math.nan

    return HardCase(f"simulator: {name}", either)


def _sample(document: Mapping[str, Any]) -> list[Any]:
    """Touch, tare, contacts and cloud of the first sample, which a working sensor can have produced."""
    from foretouch.simulation.scene import SceneConfig
    from foretouch.simulation.simulate import Simulation
    from foretouch.tactile import check_touch

    scene = SceneConfig.from_mapping({"objects": [_CAN], "max_attempts": 2, **document})
    (made,) = Simulation(scene).samples(1)
    sample = made.sample
    parts: list[Any] = [dict(sample.extra), sample.grasp.g1, sample.grasp.g2, sample.grasp.rotation]
    for touch in (sample.touch, sample.tare):
        if touch is not None:
            if scene.fingers.dead is None:
                check_touch(touch).require()
            parts.append(touch.vector())
    xyz = sample.cloud.xyz
    parts.append(xyz[np.isfinite(xyz).all(axis=-1)])
    return parts
