# SPDX-License-Identifier: Apache-2.0
"""Grasps: contacts for two fingers on the cloud of an unknown object, and the pose of the hand."""

from foretouch.grasp.axis import object_axis, with_rotations
from foretouch.grasp.config import DEFAULT_HAND, CarriedConfig, GeoGraspConfig, HandConfig, SceneGeoGraspConfig
from foretouch.grasp.geograsp import GraspPlan, PlanOptions, PlanStatus, plan_grasps
from foretouch.grasp.hold import GraspHold, HeldGrasp
from foretouch.grasp.pose import closing_faults, hand_rotation
from foretouch.types.rotations import quaternion_xyzw
from foretouch.types.scene import Obstacles

__all__ = [
    "DEFAULT_HAND",
    "CarriedConfig",
    "GeoGraspConfig",
    "GraspHold",
    "GraspPlan",
    "HandConfig",
    "HeldGrasp",
    "Obstacles",
    "PlanOptions",
    "PlanStatus",
    "SceneGeoGraspConfig",
    "closing_faults",
    "hand_rotation",
    "object_axis",
    "plan_grasps",
    "quaternion_xyzw",
    "with_rotations",
]
