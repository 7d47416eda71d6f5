# SPDX-License-Identifier: Apache-2.0
"""The levels of contact, grids and effects that are compared, on three scenes."""

from collections.abc import Iterator
from typing import Any, Final

from foretouch.tradeoff.area import Variant

RIGID: Final = "rigid"
SOFT: Final = "deformables"
EVERYTHING: Final = "everything"
SCENES: Final = (RIGID, SOFT, EVERYTHING)

_LEVELS: Final = (
    *(("hertz", 24), ("winkler", 12), ("winkler", 24), ("winkler", 48)),
    *(("layer", 8), ("layer", 12), ("layer", 16), ("layer", 24), ("layer", 32), ("layer", 48)),
)
_FEW_LEVELS: Final = (("hertz", 24), ("winkler", 12), ("winkler", 24), ("layer", 12), ("layer", 24))

DEPTH_EFFECTS: Final = {
    "clutter": "clutter",
    "flying_pixels": "camera.flying_pixels",
    "depth_noise": "camera.noise",
    "stereo_shadow": "camera.stereo",
    "holes": "camera.holes",
    "depth_steps": "camera.z_step_m",
}
_OTHER_EFFECTS: Final = {
    "execution_error": "grasps.error",
    "weight": "gravity",
    "creep": "fingers.creep",
    "slip": "fingers.slip",
    "drift": "fingers.drift",
    "noise": "fingers.noise",
    "scan_hold": "fingers.scan",
}
"""Effects by name, with the setting of the scene whose absence switches each off."""

_ALWAYS: Final = {RIGID: {}, SOFT: {}, EVERYTHING: {"fingers.dead": None}}
"""Changes of all variants of a scene: no training accepts readings with a dead electrode."""


def shipped(scene: str) -> str:
    """Name of the variant that simulates a scene as its file says."""
    return f"{scene} as shipped"


def finest(scene: str) -> str:
    """Name of the variant that simulates a scene at the finest level; scenes of effects have no other level."""
    return shipped(scene) if scene == EVERYTHING else f"{scene}: finest layer"


def list_variants(detail: str, finest_cells: int) -> list[Variant]:
    """All variants of `few` or `all`."""
    return [one for scene in SCENES for one in _of_scene(scene, detail, finest_cells)]


def _of_scene(scene: str, detail: str, finest_cells: int) -> Iterator[Variant]:
    yield _variant(shipped(scene), "shipped", scene, {})
    if scene != EVERYTHING:
        level = {"fidelity": "layer", "fingers.pad.cells": finest_cells}
        yield _variant(finest(scene), "reference", scene, level)
        for name, cells in _LEVELS if detail == "all" else _FEW_LEVELS:
            changes = {"fidelity": name, "fingers.pad.cells": cells}
            yield _variant(f"{scene}: {name} {cells}x{cells}", name, scene, changes)
        return
    effects = DEPTH_EFFECTS | (_OTHER_EFFECTS if detail == "all" else {})
    for name, field in effects.items():
        factor = "depth effect" if name in DEPTH_EFFECTS else "other effect"
        yield _variant(f"without {name}", factor, scene, {field: None}, effect=name)
    if detail == "all":
        ideal = dict.fromkeys(DEPTH_EFFECTS.values())
        yield _variant("ideal camera", "depth effect", scene, ideal)
        yield _variant("ideal camera and sensor", "other effect", scene, ideal | dict.fromkeys(_OTHER_EFFECTS.values()))


def _variant(name: str, factor: str, scene: str, changes: dict[str, Any], effect: str = "") -> Variant:
    values = {"scene": scene, "changes": {**_ALWAYS[scene], **changes}, "effect": effect}
    return Variant(name, factor, values, compared_with=shipped(scene), reference=finest(scene))
