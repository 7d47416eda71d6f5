# SPDX-License-Identifier: Apache-2.0
"""The hard clouds through segmentation, GeoGrasp and the default model."""

import math
import re
from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Any

from foretouch.errors import CloudError, GraspError
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.models import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.selftest.case import HardCase
from foretouch.selftest.clouds import ObjectCase, SceneCase, object_cases, scene_cases
from foretouch.types import Cloud


def pipeline_cases() -> Iterator[HardCase]:
    """Each object is planned on and predicted, each scene is segmented."""
    for case in object_cases():
        yield HardCase(f"grasp: {case.name}", partial(_planned, case), "" if case.planned == "ok" else case.planned)
        predicted = "" if case.predicted == "ok" else case.predicted
        yield HardCase(f"touch: {case.name}", partial(_predicted, case), predicted)
    for scene in scene_cases():
        refused = "" if scene.segmented == "ok" else f"^{scene.segmented}: .*({scene.reason})"
        yield HardCase(f"segment: {scene.name}", partial(_segmented, scene), refused)


def _planned(case: ObjectCase) -> list[Any]:
    plan = plan_grasps(case.cloud, case.plane, GeoGraspConfig())
    if plan.status not in ("ok", "initial_points"):
        raise GraspError(plan.reason)
    scored = [grasp.score for grasp in plan.grasps if math.isfinite(grasp.score) or "score" not in plan.reason]
    return [plan.axis, plan.centroid, plan.initial_points, scored, *(grasp.rotation for grasp in plan.grasps)]


def _predicted(case: ObjectCase) -> list[Any]:
    (one,) = _default_model().predict(case.cloud, [case.grasp])
    if one.value is None:
        raise GraspError(one.reason)
    return [touch.vector() for touch in (one.value, one.lower, one.upper) if touch is not None]


@lru_cache(maxsize=1)
def _default_model() -> TouchModel:
    return load_model()


def _segmented(case: SceneCase) -> list[Any]:
    from foretouch.cloud.segmentation.segment import segment

    found = segment(Cloud(case.cloud.xyz))
    if found.status != "ok":
        raise CloudError(f"{found.status}: {found.reason}")
    if found.plane is None or not re.search(case.reason, found.reason) or len(found.objects) != 1:
        raise AssertionError(f"{len(found.objects)} objects: {found.reason}")
    return [found.plane.coefficients, found.objects[0].cloud.xyz]
