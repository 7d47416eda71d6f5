# SPDX-License-Identifier: Apache-2.0
"""Grasps of requests, as messages or as arrays, read and posed; or why they cannot be predicted."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.errors import CloudError, ForetouchError, FrameError, GraspError, LimitError
from foretouch.grasp import GeoGraspConfig, hand_rotation, object_axis
from foretouch.grasp.messages import decode_grasp, has_orientation, require_rotation, surely_sound
from foretouch.pipeline import FoundObject
from foretouch.ros.messages.answers import Refusal
from foretouch.ros.messages.requests import GraspArrays, RefusalError
from foretouch.ros.touch.config import TouchSettings
from foretouch.types import Float64, Grasp
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status


def posed_grasps(
    grasps: Sequence[GraspMsg] | GraspArrays, target: FoundObject, config: TouchSettings, posing: GeoGraspConfig | None
) -> list[Grasp | Refusal]:
    """The grasps of a request, posed as by `Pipeline.grasp_between` where they have no orientation, or why there is none."""
    read = _reader_of_arrays(grasps) if isinstance(grasps, GraspArrays) else lambda k: _read(grasps[k])
    axis: Float64 | None = None
    found: list[Grasp | Refusal] = []
    for k in range(len(grasps)):
        try:
            grasp, oriented = read(k)
            if not oriented:
                if posing is None:
                    raise GraspError("pose: no orientation, and no table to compute it with")
                axis = _axis(target, config.limits, posing) if axis is None else axis
                rotation = hand_rotation(grasp.g1, grasp.g2, axis)
                grasp = Grasp.checked(grasp.g1, grasp.g2, rotation, grasp.score, grasp.id, grasp.object_id)
            found.append(grasp)
        except (GraspError, CloudError, RefusalError) as err:
            found.append(refusal_of(err))
    return found


def _read(message: GraspMsg) -> tuple[Grasp, bool]:
    """A grasp, and whether it has an orientation."""
    oriented = has_orientation(message)
    return decode_grasp(message, None if oriented else np.eye(3)), oriented


def _reader_of_arrays(grasps: GraspArrays) -> Callable[[int], tuple[Grasp, bool]]:
    """As `_read`, by number; most grasps are found to be sound all at once."""
    oriented = grasps.rotations is not None
    turned = np.broadcast_to(np.eye(3), (len(grasps), 3, 3)) if grasps.rotations is None else grasps.rotations
    sound = surely_sound(grasps.contacts, turned).tolist()

    def read(k: int) -> tuple[Grasp, bool]:
        (g1, g2), rest = grasps.contacts[k], (math.nan, f"{grasps.id}/{k}" if grasps.id else "", grasps.object_id)
        if sound[k]:
            return Grasp.checked(g1, g2, turned[k], *rest), oriented
        require_rotation(turned[k])
        return Grasp(g1, g2, turned[k], *rest), oriented

    return read


def _axis(target: FoundObject, limits: ObjectLimits, config: GeoGraspConfig) -> Float64:
    check_object(target.cloud.xyz, limits)
    try:
        check_table(target.plane, limits)
    except LimitError as err:
        raise RefusalError(Status.BAD_PLANE, str(err)) from err
    return object_axis(target.cloud, target.plane, config)[0]


def refusal_of(err: ForetouchError) -> Refusal:
    """What an error keeps from being predicted."""
    if isinstance(err, RefusalError):
        return Refusal(err.status, err.reason)
    statuses = {
        FrameError: Status.UNKNOWN_FRAME,
        LimitError: Status.BAD_CLOUD,
        CloudError: Status.TOO_FEW_POINTS,
        GraspError: Status.BAD_GRASP,
    }
    return Refusal(next((code for kind, code in statuses.items() if isinstance(err, kind)), Status.REFUSED), str(err))
