# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the simulator, for `check_outcome`: meshes, scenes, and every effect at its bounds."""

import dataclasses
import typing
from collections.abc import Iterator, Mapping
from functools import partial
from types import NoneType, UnionType
from typing import Any

import numpy as np

from foretouch.config import Settings, setting_infos
from foretouch.errors import ForetouchError, TactileError
from foretouch.tactile import touch_faults
from foretouch_lab.simulation.objects import TriangleMesh
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.simulate import Simulation

Cases = Iterator[tuple[Any, ...]]

_CAN = {"name": "can", "shape": "can", "size_m": [0.07, 0.07, 0.1], "pose": {"rest": "side"}}
_ANY = "?"  # answered, or refused by any name


def mesh_cases() -> Cases:
    """Meshes that are no solids, and solids of absurd size."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    sides = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces = np.array([*sides, (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)], np.int64)
    for name, vertices, triangles, reason in (
        ("flat", corners * [1.0, 1.0, 0.0], faces, "has no extent"),
        ("inside out", corners, faces[:, ::-1], "encloses"),
        ("an infinite vertex", np.where(corners > 0, np.inf, 0.0), faces, "not finite"),
        ("no face", corners, faces[:0], "no face|no triangle"),
        ("a negative index", corners, faces - 1, "no vertex"),
        ("a degenerate face", corners, np.concatenate([faces, [[0, 0, 0]]]), "not shared by two faces"),
        *((f"a size of {size:g} m", size * corners, faces, _in_unit_box) for size in (1e-9, 1e3, 1e-300, 1e150)),
    ):
        yield f"mesh: {name}", partial(_unit_mesh, vertices, triangles), reason


def _unit_mesh(vertices: Any, faces: Any) -> Any:
    return TriangleMesh(vertices, faces).in_unit_box().closed("mesh").vertices


def _in_unit_box(vertices: Any) -> bool:
    return bool(np.allclose(np.abs(vertices), 0.5))


def sample_cases() -> Cases:
    """Scenes whose sample cannot be made, or is right nevertheless."""
    small = "compressed by|given up|window is wide"
    for name, document, reason in (
        *((f"a can of {m:g} m", _can(size_m=[m] * 3), "size_m") for m in (1e-9, 1e-3, 1e3)),
        ("a can wider than the hand", _can(size_m=[0.2] * 3), "the hand opens"),
        *((f"a force of {n:g} N", _force(n), None) for n in (0.0, 1e-30)),
        *((f"a force of {n:g} N", _force(n), "force_n") for n in (5e-324, 1e300)),
        *((f"a depth of {m:g} m", _depth(m), small if m == 1.0 else None) for m in (0.0, 1e-12, 1.0)),
        ("fingers far below the object", {"grasps": {"insertion_m": 0.9}}, "closes beside"),
        ("an object out of view", _can(pose={"x_m": [5.0, 5.0]}), "outside of the view"),
        ("an object without weight", {"gravity": {}, **_can(mass_kg=0.0)}, None),
    ):
        yield f"scene: {name}", *_scene(document, reason)


def _can(**changes: Any) -> dict[str, Any]:
    return {"objects": [{**_CAN, **changes}]}


def _force(newton: float) -> dict[str, Any]:
    return {"grasps": {"thumb": {"force_n": [newton, newton]}}}


def _depth(metres: float) -> dict[str, Any]:
    return {"grasps": {"control": "depth", "thumb": {"depth_m": [metres, metres]}}}


def effect_cases() -> Cases:
    """Each group of settings of a scene with all of them at their lowest, at their highest, and at absurd values."""
    for name, group in _groups(SceneConfig):
        for end in ("lowest", "highest", "absurd"):
            values = _ends(group, end)
            if not values or (name == "fingers.timeline" and end != "lowest"):
                continue  # a million messages are right, and take half a minute
            document: dict[str, Any] = values
            for word in reversed(name.split(".")):
                document = {word: document}
            if name in ("fingers.creep", "fingers.slip", "fingers.vibration", "fingers.scan"):
                document["fingers"]["timeline"] = {}
            if name == "gravity":
                document |= _can(mass_kg=0.1)
            if name == "grasps.middle":
                document["grasps"]["balanced"] = False
            yield f"effects: {name} at its {end} values", *_scene(document, _ANY)


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
            bound = 1e300 if bound is None and info.type is float else None
        if "." in info.name or info.type not in (int, float) or bound is None:
            continue
        value = info.type(bound)
        values[info.name] = [value] * len(info.default or (0, 0)) if info.is_list else value
    return values


def _scene(document: Mapping[str, Any], reason: str | None) -> tuple[Any, ...]:
    run = partial(_sample, document)
    return (partial(_short_refusal, run), None) if reason == _ANY else (run, reason)


def _short_refusal(run: Any) -> Any:
    try:
        return run()
    except ForetouchError as err:
        assert len(str(err)) < 500  # noqa: PT017
        return None


def _sample(document: Mapping[str, Any]) -> list[Any]:
    """Touch, tare, contacts and cloud of the first sample, which a working sensor can have produced."""
    scene = SceneConfig.from_mapping({"objects": [_CAN], "max_attempts": 2, **document})
    (sample,) = Simulation(scene).samples(1)
    for touch in (sample.touch, sample.tare):
        if touch is not None and scene.fingers.dead is None and (faults := touch_faults(touch)):
            raise TactileError("; ".join(faults))
    touches = [touch.values for touch in (sample.touch, sample.tare) if touch is not None]
    xyz = sample.cloud.xyz[np.isfinite(sample.cloud.xyz).all(axis=-1)]
    return [dict(sample.extra), sample.grasp.g1, sample.grasp.g2, sample.grasp.rotation, *touches, xyz]
