# SPDX-License-Identifier: Apache-2.0
"""Where to grasp: the methods of foretouch, and a rule of a few lines that any method should beat."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np

from benchmarks.grasp_physics.camera import Seen
from foretouch.grasp.config import GraspMethod
from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.types import Float64

RULE: Final = "simple rule"
NO_OBJECT: Final = "no object found"
NO_GRASP: Final = "no grasp"
METHODS: Final = (*get_args(GraspMethod), RULE)
DEFAULT: Final = PipelineConfig().grasp.method
_DIRECTIONS = np.radians(np.arange(0.0, 180.0, 5.0))
_TAIL = 0.01  # of the points, left out at either end


@dataclass(frozen=True)
class Proposal:
    """The first grasp of a method."""

    contacts: Float64 | None  # (2, 3) float64, g1 and g2 in the world [m]; None where there is none
    reason: str = ""  # why there is none
    status: str = ""  # of the plan, with its reason where there is none
    ms: float = float("nan")  # time of the thread for the plan, without the segmentation [ms]


class Planner:
    """One method.

    Args:
        method: One of `METHODS`.
        settings: Of the pipeline, besides the method, by dotted keys such as `grasp.max_points`; the simple rule has none.
    """

    def __init__(self, method: str, settings: Mapping[str, Any] | None = None) -> None:
        self.method = method
        chosen = {} if method == RULE else {"grasp.method": method, **(settings or {})}
        self.pipeline = Pipeline(PipelineConfig().updated(chosen))

    def propose(self, seen: Seen, target: FoundObject | None, repeats: int = 1) -> Proposal:
        """The first grasp on a target of the scene; none where segmentation has found none.

        It is planned so many times again, and the least time counts.
        """
        if target is None:
            return Proposal(None, NO_OBJECT)
        ms = math.inf
        for _ in range(repeats):
            start = time.thread_time()
            contacts, status = self._plan(target)
            ms = min(ms, (time.thread_time() - start) * 1e3)
        if contacts is None:
            return Proposal(None, NO_GRASP, status, ms)
        return Proposal(seen.camera.to_world(contacts), "", status, ms)

    def _plan(self, target: FoundObject) -> tuple[Float64 | None, str]:
        """Contacts (2, 3) in the camera frame, and the status of the plan; None, and why, where there is no grasp."""
        if self.method == RULE:
            return simple_rule(target), "ok"
        plan = self.pipeline.plan(target)
        if not plan.grasps:
            return None, f"{plan.status}: {plan.reason}"
        return np.stack([plan.grasps[0].g1, plan.grasps[0].g2]), plan.status


def find(seen: Seen, pipeline: Pipeline) -> FoundObject | None:
    """The first target of the scene, None where segmentation finds none."""
    found = pipeline.segment(seen.cloud).targets
    return found[0] if found else None


def simple_rule(target: FoundObject) -> Float64:
    """(2, 3) contacts in the camera frame: a horizontal line across the narrower side of the visible footprint.

    It passes through the middle of the footprint, at half of the height that is seen, 10 mm or more over the table.
    """
    up = target.plane.normal
    xyz = target.cloud.xyz[np.isfinite(target.cloud.xyz).all(axis=1)].astype(np.float64)
    height = xyz @ up + target.plane.offset
    east = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    east /= np.linalg.norm(east)
    axes = np.stack([east, np.cross(up, east)])
    flat = xyz @ axes.T
    turned = np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])
    low, high = np.quantile(flat @ turned, [_TAIL, 1.0 - _TAIL], axis=0)
    k = int(np.argmin(high - low))
    across = turned[:, k]
    along = np.array([-across[1], across[0]])
    middle = along * np.quantile(flat @ along, [_TAIL, 1.0 - _TAIL]).mean()
    level = max(0.5 * float(np.quantile(height, 1.0 - 2.0 * _TAIL)), 0.010) - target.plane.offset
    return np.stack([(middle + end * across) @ axes + level * up for end in (low[k], high[k])])
