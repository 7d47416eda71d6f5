# SPDX-License-Identifier: Apache-2.0
"""Messages of grasps, planes and predictions to the core's types and back: pure functions without a node."""

import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from shape_msgs.msg import Plane as PlaneMsg
from std_msgs.msg import Header

from foretouch.errors import CloudError, ModelError
from foretouch.grasp import Obstacles
from foretouch.grasp.messages import REFERENCES, MessageClasses, decode_predictions, encode_grasp
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.types import SECOND_NS, Evidence, Float64, Grasp, Plane, Prediction
from foretouch.types.predictions import evidence_text
from foretouch.types.rotations import quaternion_xyzw
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TablePlane
from foretouch_msgs.msg import TouchPrediction as TouchPredictionMsg

REFERENCE_CODES: dict[str, int] = {name: code for code, name in enumerate(REFERENCES)}
"""Numbers of references in messages."""

_CLASSES = MessageClasses(GraspMsg, Point, Vector3, Pose, Quaternion)


def stamp_to_msg(nanoseconds: int) -> Time:
    """Convert a stamp [ns]."""
    sec, nanosec = divmod(nanoseconds, SECOND_NS)
    return Time(sec=sec, nanosec=nanosec)


def duration_to_msg(seconds: float) -> Duration:
    """Convert a time span [s], which may be negative."""
    sec, nanosec = divmod(round(seconds * SECOND_NS), SECOND_NS)
    return Duration(sec=max(-(2**31), min(sec, 2**31 - 1)), nanosec=nanosec)


def header_to_msg(frame_id: str, nanoseconds: int) -> Header:
    """Make a header of a frame and a stamp [ns]."""
    return Header(frame_id=frame_id, stamp=stamp_to_msg(nanoseconds))


def point_to_msg(point: Float64) -> Point:
    """Convert a point (3,) [m]."""
    x, y, z = map(float, point)
    return Point(x=x, y=y, z=z)


def plane_to_msg(plane: Plane | None) -> PlaneMsg:
    """Convert a plane; four zeros stand for none."""
    return PlaneMsg(coef=np.zeros(4) if plane is None else plane.coefficients)


def obstacles_to_msg(obstacles: Obstacles | None) -> dict[str, Any]:
    """Make the fields of `TablePlane` that hold the points of all objects of a scene."""
    if obstacles is None:
        return {}
    ids = obstacles.object_ids.astype(np.uint32)
    xyz = np.ascontiguousarray(obstacles.xyz, np.float32)
    return {"obstacles": array.array("f", xyz.tobytes()), "obstacle_ids": array.array("I", ids.tobytes())}


def obstacles_from_msg(message: TablePlane) -> Obstacles | None:
    """Convert the finite points of all objects of a scene.

    Raises:
        CloudError: If the two fields do not have three numbers and one id for each point.
    """
    ids = np.asarray(message.obstacle_ids, np.uint32).astype(np.int32)
    if len(message.obstacles) != 3 * len(ids):
        raise CloudError(f"table: {len(message.obstacles)} numbers in obstacles are not x, y, z of {len(ids)} points")
    if not len(ids):
        return None
    xyz = np.asarray(message.obstacles, np.float32).reshape(-1, 3)
    finite = np.isfinite(xyz).all(axis=1)
    return Obstacles(xyz[finite], ids[finite])


def rotation_to_msg(rotation: Float64) -> Quaternion:
    """Convert a rotation matrix (3, 3)."""
    x, y, z, w = map(float, quaternion_xyzw(rotation))
    return Quaternion(x=x, y=y, z=z, w=w)


def grasp_to_msg(grasp: Grasp, status: int = Status.OK, reason: str = "") -> GraspMsg:
    """Convert a grasp, which has a status and its reason, by `encode_grasp`."""
    made: GraspMsg = encode_grasp(grasp, status, reason, _CLASSES)
    return made


def prediction_from_msg(message: TouchPredictionMsg, sensor: Sensor = BIOTAC_SP) -> Prediction:
    """Convert a received prediction, whose values are float32; what it holds none of is NaN.

    Args:
        message: The prediction.
        sensor: Whose readings are predicted.

    Raises:
        ModelError: If the reference is unknown, or the prediction is for another sensor.
        TactileError: If its arrays do not fit their names.
    """
    if message.reference not in REFERENCE_CODES.values():
        raise ModelError(f"reference: {message.reference} is not one of {', '.join(REFERENCE_CODES)}")
    if message.fingers and message.sensor_sha256 != sensor.sha256:  # without a model there is no sensor
        raise ModelError(f"sensor: {message.sensor} ({message.sensor_sha256[:8]}) is not {sensor.config.name}")
    return decode_predictions(message, sensor.channels)[0]


def evidence_fields(evidence: Evidence) -> dict[str, Any]:
    """Make the fields of a prediction that hold its evidence."""
    ages = {"touch_age": evidence.touch_age_s, "reading_age": evidence.reading_age_s}
    return {
        "touches": evidence.touches,
        "readings": evidence.readings,
        **{name: duration_to_msg(-1.0 if age is None else age) for name, age in ages.items()},  # -1 for none
    }


def reference_text(message: TouchPredictionMsg) -> str:
    """Describe what a prediction is based on: `cloud only`, `tare`, `3 touches`, `history of 40 readings`."""
    name = dict(enumerate(REFERENCES)).get(message.reference, f"reference {message.reference}")
    return evidence_text(name, message.touches, message.readings)
