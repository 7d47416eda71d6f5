# SPDX-License-Identifier: Apache-2.0
"""Area `grasp`: first grasps that hold against the time of a plan on one object.

The objects are those that the default segmentation finds of `shared.touched_scenes`, which says what holds. How many grasps
hold household objects that MuJoCo lifts and shakes is measured by `benchmarks/grasp_physics`. The published C++ GeoGrasp, where
`foretouch_lab.experiments.peers` can compile it, gives the contacts of *original*.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import cycle
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.types import Grasp
from foretouch.types.scene import Object
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.tradeoff import Panel, Timed, Variant, make_area
from foretouch_lab.experiments.peers import check_geograsp, geograsp, has_geograsp
from foretouch_lab.experiments.shared.touched_scenes import HARD, TIMED, SceneSettings, TouchedScenes, drawn_rows, share

_CPP: Final = "C++ GeoGrasp, all points"


def _variants() -> Iterator[Variant]:
    yield Variant("default", "shipped")
    for count in (250, 500, 1000, 2000, 0):  # the last one: all
        yield Variant(f"completed, {count or 'all'} points", "points", {"grasp.max_points": count})
    original = {"grasp.method": "original"}
    for count in (500, 2000, 8000):
        yield Variant(f"original, {count} points", "reference", {**original, "grasp.max_points": count})
    yield Variant("original, slab 4 mm", "reference", {**original, "grasp.slab_half_width_m": 0.004})
    if has_geograsp():
        yield Variant(_CPP, "reference", original)


VARIANTS: Final = tuple(_variants())


@dataclass(frozen=True, eq=False)
class FoundObjects(TouchedScenes):
    """The scenes with the first objects as they are found."""

    @cached_property
    def targets(self) -> list[tuple[int, Object]]:
        """Each first object that the default segmentation finds, with the number of its image."""
        pipeline = self.pipeline({})
        found = [(k, self.wanted(k, pipeline.segment(self.cloud(k)))) for k in range(len(self))]
        return [(k, target) for k, target in found if target is not None]


def _planner(variant: Variant, data: FoundObjects) -> Callable[[Object], Sequence[Grasp]]:
    """Return what plans grasps on an object, best first."""
    pipeline = data.pipeline(variant.values)
    if variant.name != _CPP:
        return lambda target: pipeline.plan(target).grasps
    tip_mm = pipeline.config.grasp.tip_mm

    def plan(target: Object) -> list[Grasp]:
        grasp = geograsp(target.cloud, target.plane, tip_mm)
        return [] if grasp is None else [grasp]

    return plan


def _accuracy(skill: str, settings: SceneSettings, data: FoundObjects) -> Mapping[str, Row]:
    sums = {}
    for variant in VARIANTS:
        plan, held = _planner(variant, data), []
        for number, target in data.targets:
            grasps = plan(target)
            held.append(bool(grasps) and data.read(number, grasps[0]) is not None)
        sums[variant.name] = np.array([(one, 1.0) for one in held])
    return drawn_rows(skill, sums, share, settings.bootstrap)


def _timed(variant: Variant, _settings: SceneSettings, data: FoundObjects) -> Timed:
    """Return what plans one grasp on objects of all sizes, one after the other."""
    plan = _planner(variant, data)
    ordered = sorted((target for _, target in data.targets), key=lambda target: target.cloud.size)
    chosen = np.linspace(0, len(ordered) - 1, min(TIMED, len(ordered))).astype(int)  # evenly spread
    turn = cycle([partial(plan, ordered[k]) for k in chosen])
    return lambda _: next(turn)(), 1.0


def _prepare(_settings: SceneSettings, _source: Path | None, out: Path) -> Path:
    """Return any folder, since scenes are generated."""
    check_geograsp()
    return out


EXPERIMENT = make_area(
    _accuracy,
    name="tradeoff_grasp",
    question="How many first grasps hold, planned in a few milliseconds?",
    module=__name__,
    settings=SceneSettings,
    presets={
        "smoke": {"scenes": 3, "timing_s": 1.0},
        "small": {"scenes": 100, "timing_s": 30.0},
        "full": {"timing_s": 120.0},
    },
    prepare=_prepare,
    load=lambda settings, _path: FoundObjects.render(settings.scenes, HARD),
    variants=VARIANTS,
    timed=_timed,
    panels=(Panel("held", 1, "First grasps on objects that others touch", "share that holds, 95 % interval"),),
)
