# SPDX-License-Identifier: Apache-2.0
"""Grasps of requests, as messages or as arrays, read and posed; or why they cannot be predicted."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.errors import CloudError, ForetouchError, FrameError, GraspError, LimitError
from foretouch.grasp import GeoGraspConfig, hand_rotation, object_axis
from foretouch.grasp.messages import decode_grasp, has_orientation
from foretouch.grasp.pose import joined_faults, rotation_faults
from foretouch.pipeline import Object
from foretouch.ros.messages.answers import Refusal
from foretouch.ros.messages.requests import GraspArrays, RefusalError, status_name
from foretouch.ros.touch.config import TouchSettings
from foretouch.types import Float64, Grasp, Grasps, Predictions
from foretouch.types.arrays import objects
from foretouch.types.channels import Channels
from foretouch.types.grasps import contact_faults
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status


def posed_grasps(
    grasps: Sequence[GraspMsg] | GraspArrays,
    target: Object,
    config: TouchSettings,
    posing: GeoGraspConfig | None,
    channels: Channels,
) -> Predictions:
    """Read the grasps of a request, posed as by `Pipeline.grasp_between` where they have no orientation.

    Returns:
        A row for each grasp, without values yet: its status is `ok`, or what it is refused as, with a reason.
    """
    axis: list[Float64] = []

    def posed(g1: Float64, g2: Float64) -> Float64:
        if posing is None:
            raise GraspError("pose: no orientation, and no table to compute it with")
        if not axis:
            axis.append(_axis(target, config.limits, posing))
        return hand_rotation(g1, g2, axis[0])

    rows, errors = _of_arrays(grasps, posed) if isinstance(grasps, GraspArrays) else _of_messages(grasps, posed)
    statuses = ["ok" if error is None else status_name(refusal_of(error).status) for error in errors]
    return Predictions.refused(rows, channels, statuses, ["" if error is None else str(error) for error in errors])


def _of_messages(
    messages: Sequence[GraspMsg], posed: Callable[[Float64, Float64], Float64]
) -> tuple[Grasps, list[ForetouchError | None]]:
    """Rows of NaN where there is an error."""
    known: dict[int, Grasp] = {}
    errors: list[ForetouchError | None] = [None] * len(messages)
    for k, message in enumerate(messages):
        try:
            grasp = decode_grasp(message, None if has_orientation(message) else np.eye(3))
            if not has_orientation(message):
                grasp = replace(grasp, rotation=posed(grasp.g1, grasp.g2))
            known[k] = grasp
        except (GraspError, CloudError, RefusalError) as err:
            errors[k] = err
    return Grasps.unknown(len(messages)).put(list(known), Grasps.of(list(known.values()))), errors


def _of_arrays(
    grasps: GraspArrays, posed: Callable[[Float64, Float64], Float64]
) -> tuple[Grasps, list[ForetouchError | None]]:
    count, given = len(grasps), grasps.rotations is not None
    turned = np.tile(np.eye(3), (count, 1, 1)) if grasps.rotations is None else grasps.rotations.copy()
    g1, g2 = grasps.contacts[:, 0], grasps.contacts[:, 1]
    faults = joined_faults(contact_faults(g1, g2, turned), rotation_faults(turned))
    errors: list[ForetouchError | None] = [GraspError(fault) if fault else None for fault in faults]
    for k in [] if given else [k for k, fault in enumerate(faults) if not fault]:
        try:
            turned[k] = posed(g1[k], g2[k])
        except (GraspError, CloudError, RefusalError) as err:
            errors[k] = err
    ids = objects([f"{grasps.id}/{k}" if grasps.id else "" for k in range(count)])
    return Grasps(g1, g2, turned, id=ids, object_id=objects([grasps.object_id] * count)), errors


def _axis(target: Object, limits: ObjectLimits, config: GeoGraspConfig) -> Float64:
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
