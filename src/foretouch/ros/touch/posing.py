# SPDX-License-Identifier: Apache-2.0
"""Grasps of requests, as messages or as arrays, read and posed; or why they cannot be predicted."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.errors import CloudError, ForetouchError, GraspError, LimitError
from foretouch.grasp import GeoGraspConfig, hand_rotation, object_axis
from foretouch.grasp.messages import decode_grasp, decode_grasps, has_orientation, require_rotation, surely_sound
from foretouch.pipeline import FoundObject
from foretouch.ros.messages.answers import Refusal
from foretouch.ros.messages.requests import GraspArrays, RefusalError
from foretouch.ros.touch.config import TouchPredictorConfig
from foretouch.types import Float64, Grasp
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status


def posed_grasps(
    grasps: Sequence[GraspMsg] | GraspArrays,
    target: FoundObject,
    config: TouchPredictorConfig,
    posing: GeoGraspConfig | None,
) -> list[Grasp | Refusal]:
    """The grasps of a request, posed as by `Pipeline.grasp_between` where they have no orientation, or why there is none."""
    known, decide = _of_arrays(grasps) if isinstance(grasps, GraspArrays) else _of_messages(grasps)
    axis: Float64 | None = None
    found: list[Grasp | Refusal] = []
    for k, (sound, oriented) in enumerate(known):
        try:
            grasp = decide(k) if sound is None else sound
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


_Known = list[tuple[Grasp | None, bool]]  # grasps, None where only `decide` can, and whether they have an orientation


def _of_messages(messages: Sequence[GraspMsg]) -> tuple[_Known, Callable[[int], Grasp]]:
    decoded = zip(decode_grasps(messages), messages, strict=True)
    known = [(grasp, grasp is not None or has_orientation(message)) for grasp, message in decoded]
    return known, lambda k: decode_grasp(messages[k], None if known[k][1] else np.eye(3))


def _of_arrays(grasps: GraspArrays) -> tuple[_Known, Callable[[int], Grasp]]:
    oriented = grasps.rotations is not None
    turned = np.broadcast_to(np.eye(3), (len(grasps), 3, 3)) if grasps.rotations is None else grasps.rotations
    rest = [(math.nan, f"{grasps.id}/{k}" if grasps.id else "", grasps.object_id) for k in range(len(grasps))]
    sound = surely_sound(grasps.contacts, turned).tolist()
    rows = zip(sound, grasps.contacts, turned, rest, strict=True)
    known = [(Grasp.checked(g1, g2, one, *more) if fine else None, oriented) for fine, (g1, g2), one, more in rows]

    def decide(k: int) -> Grasp:
        require_rotation(turned[k])
        g1, g2 = grasps.contacts[k]
        return Grasp(g1, g2, turned[k], *rest[k])

    return known, decide


def _axis(target: FoundObject, limits: ObjectLimits, config: GeoGraspConfig) -> Float64:
    try:
        check_table(target.plane, limits)
    except LimitError as err:
        raise RefusalError(Status.BAD_PLANE, str(err)) from err
    check_object(target.cloud.xyz, limits)
    return object_axis(target.cloud, target.plane, config)[0]


def refusal_of(err: ForetouchError) -> Refusal:
    """What an error keeps from being predicted."""
    if isinstance(err, RefusalError):
        return Refusal(err.status, err.reason)
    statuses = {LimitError: Status.BAD_CLOUD, CloudError: Status.TOO_FEW_POINTS, GraspError: Status.BAD_GRASP}
    return Refusal(next((code for kind, code in statuses.items() if isinstance(err, kind)), Status.REFUSED), str(err))
