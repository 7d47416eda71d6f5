# SPDX-License-Identifier: Apache-2.0
"""`foretouch_msgs/Grasp` and `TouchPrediction` without ROS: written and decoded alike for rclpy and rosbags."""

import math
from array import array as packed
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, Final, NamedTuple, get_args

import numpy as np

from foretouch.errors import GraspError, TactileError
from foretouch.types import SECOND_NS, Evidence, Float64, Grasp, Grasps, Predictions, Reference, WayIn
from foretouch.types.arrays import Bool, objects
from foretouch.types.channels import LARGEST, Channel, Channels
from foretouch.types.grasps import TILTS
from foretouch.types.rotations import check_rotation, quaternion_xyzw

_MAX_UNIT: Final = 2.0  # no component of a rotation is larger; the square of such a number may overflow
_UNIT_TOLERANCE: Final = 1e-3  # of a quaternion's length; planners work with float32
_AGREEMENT: Final = 1e-3  # between a grasp's matrix and its quaternion, per element
_NO_TURN: Final = (
    [0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 1.0],
)  # quaternions that give no orientation, the second of a new message

STATUSES: Final = {
    0: "ok",
    1: "initial_points",
    2: "bad_request",
    3: "busy",
    10: "bad_cloud",
    11: "empty_cloud",
    12: "too_few_points",
    13: "unknown_frame",
    14: "no_plane",
    15: "no_object",
    16: "no_target",
    17: "doubtful_plane",
    20: "no_grasp",
    21: "bad_grasp",
    22: "bad_plane",
    30: "refused",
    31: "no_model",
    40: "failed",
}
"""Names of the numbers in `foretouch_msgs/Status`."""

REFERENCES: Final[tuple[Reference, ...]] = get_args(Reference)
"""Names of the numbers of `reference` in `foretouch_msgs/TouchPrediction`."""


_ENDS: Final = {
    "value": ("values", "scalars"),
    "lower": ("lower", "scalars_lower"),
    "upper": ("upper", "scalars_upper"),
}


class MessageClasses(NamedTuple):
    """What makes messages of their fields; by default plain objects, as rosbags writes them."""

    grasp: Callable[..., Any] = SimpleNamespace
    point: Callable[..., Any] = SimpleNamespace
    vector: Callable[..., Any] = SimpleNamespace
    pose: Callable[..., Any] = SimpleNamespace
    quaternion: Callable[..., Any] = SimpleNamespace


PLAIN: Final = MessageClasses()


def encode_grasp(grasp: Grasp, status: int = 0, reason: str = "", new: MessageClasses = PLAIN) -> Any:
    """Make the `foretouch_msgs/Grasp` of a grasp; `pose` is redundant, `pose_of_hand` is for those who move the hand.

    Args:
        grasp: In the frame of its cloud.
        status: Of `foretouch_msgs/Status`.
        reason: Of the status.
        new: Makes the messages.
    """

    def vector(kind: Callable[..., Any], numbers: Float64) -> Any:
        x, y, z = map(float, numbers)
        return kind(x=x, y=y, z=z)

    def pose(position: Float64, rotation: Float64) -> Any:
        x, y, z, w = map(float, quaternion_xyzw(rotation))
        return new.pose(position=vector(new.point, position), orientation=new.quaternion(x=x, y=y, z=z, w=w))

    way: dict[str, Any] = {}
    if grasp.way is not None:  # how the hand comes to it
        at, posture = grasp.way.pose_of_hand, np.ascontiguousarray(grasp.way.posture, np.float64)
        way = {
            "hand": grasp.way.hand,
            "approach": vector(new.vector, grasp.way.approach),
            "depth_m": grasp.way.depth_m,
            "width_at_most_m": grasp.way.width_at_most_m,
            "approaches": packed("f", np.ascontiguousarray(grasp.way.approaches, np.float32).tobytes()),
            "thumb_at": grasp.way.thumb_at,
            "pose_of_hand": pose(at[:3, 3], at[:3, :3]),
            "joints": list(grasp.way.joints),
            "posture": packed("d", posture.tobytes()),
        }
    return new.grasp(
        id=grasp.id,
        object_id=grasp.object_id,
        g1=vector(new.point, grasp.g1),
        g2=vector(new.point, grasp.g2),
        pose=pose(grasp.midpoint, grasp.rotation),
        rotation=np.ascontiguousarray(grasp.rotation.reshape(9), np.float64),
        score=float(grasp.score),
        status=status,
        reason=reason,
        width_m=grasp.width_m,
        flags=list(grasp.flags),
        **way,
    )


def has_orientation(message: Any) -> bool:
    """Return whether a `foretouch_msgs/Grasp` holds a rotation: a matrix, or a quaternion other than that of a new message, w = 1."""
    return bool(np.any(message.rotation) or _quaternion(message).tolist() not in _NO_TURN)


def decode_grasp(message: Any, rotation: Float64 | None = None, score: float | None = None) -> Grasp:
    """Decode a `foretouch_msgs/Grasp`. The position of its pose is not used: it is the midpoint of the contacts.

    Args:
        message: With a matrix, a quaternion, or both; nine zeros as matrix mean that only the quaternion counts.
        rotation: (3, 3) float64, instead of the message's rotation.
        score: Instead of the message's, which is a float32.

    Raises:
        GraspError: If a number is not finite, the contacts are one point, matrix and quaternion are absent or
            differ, or the way of a hand is incomplete.
    """
    g1, g2 = (np.array([p.x, p.y, p.z], np.float64) for p in (message.g1, message.g2))
    rotation = _rotation_of(message) if rotation is None else rotation
    score = float(message.score) if score is None else score
    flags = tuple(getattr(message, "flags", ()))  # which messages before 0.5 lack
    return Grasp(g1, g2, rotation, score, message.id, message.object_id, _way_of(message), flags)


def decode_grasps(messages: Sequence[Any]) -> tuple[Grasps, Bool, list[str]]:
    """Decode K messages of requests as `decode_grasp` does each, most of them at once.

    Args:
        messages: `foretouch_msgs/Grasp` of rclpy.

    Returns:
        K rows, NaN where one cannot be read; (K,) which have an orientation, without which that of a row has no meaning; and
        why a grasp cannot be read, "" if it can.
    """
    grasps, reasons = Grasps.unknown(len(messages)), [""] * len(messages)
    if not messages:
        return grasps, np.empty(0, np.bool_), reasons
    points = ((m.g1, m.g2) for m in messages)
    contacts = np.array([(p.x, p.y, p.z, q.x, q.y, q.z) for p, q in points], np.float64)
    turns = (m.pose.orientation for m in messages)
    quaternions = np.array([(q.x, q.y, q.z, q.w) for q in turns], np.float64)
    matrices = np.array([m.rotation for m in messages], np.float64).reshape(-1, 3, 3)
    turned = matrices.any(axis=(1, 2)) | ~(quaternions[:, None] == np.array(_NO_TURN)).all(axis=2).any(axis=1)
    matrices[~turned] = np.eye(3)
    sure = _surely_read(contacts, quaternions, matrices, turned)
    sure &= np.array([not m.hand for m in messages])
    known: dict[int, Grasp] = {}
    for k, message in enumerate(messages):
        grasps.object_id[k] = message.object_id
        if not sure[k]:  # a way in, or what is to be refused in words
            try:
                known[k] = decode_grasp(message, None if turned[k] else np.eye(3))
            except GraspError as err:
                reasons[k] = str(err)
    rows = np.flatnonzero(sure).tolist()
    own = [messages[k] for k in rows]
    plain = Grasps(
        g1=contacts[rows, :3],
        g2=contacts[rows, 3:],
        rotation=matrices[rows],
        score=np.array([float(m.score) for m in own]),
        id=objects([m.id for m in own]),
        object_id=objects([m.object_id for m in own]),
        flags=objects([tuple(m.flags) for m in own]),
    )
    return grasps.put(rows, plain).put(list(known), Grasps.of(list(known.values()))), turned, reasons


def _surely_read(contacts: Float64, quaternions: Float64, matrices: Float64, turned: Bool) -> Bool:
    """Return (K,) which grasps can be read without a closer look: matrices that are rotations, and quaternions of these, if any."""
    with np.errstate(all="ignore"):  # what is not finite is not sure
        skewed = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        off = np.abs(np.sqrt((quaternions**2).sum(axis=1)) - 1.0)
        apart = np.abs(_rotations(quaternions) - matrices).max(axis=(1, 2))
        agrees = ~quaternions.any(axis=1) | ((off < 0.1 * _UNIT_TOLERANCE) & (apart < 0.5 * _AGREEMENT)) | ~turned
        right = (skewed < 0.5 * _UNIT_TOLERANCE) & (np.linalg.det(matrices) > 0.5)
        whole = np.isfinite(contacts).all(axis=1) & (contacts[:, :3] != contacts[:, 3:]).any(axis=1)
    return np.asarray(whole & right & agrees, np.bool_)


def _way_of(message: Any) -> WayIn | None:
    """Read how the hand comes to a grasp; None of a message without a way in, or of a version before 0.4."""
    if not getattr(message, "hand", ""):
        return None
    pose, (x, y, z) = np.eye(4), (getattr(message.approach, axis) for axis in "xyz")
    place, turn = message.pose_of_hand.position, message.pose_of_hand.orientation
    pose[:3, 3] = place.x, place.y, place.z
    arrays = {"approach": np.array([x, y, z]), "depth_m": np.array(message.depth_m), "pose_of_hand": pose}
    arrays |= {name: np.asarray(getattr(message, name), np.float64) for name in ("approaches", "posture")}
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise GraspError(f"{name}: {array.tolist()} is not finite")
    if arrays["approaches"].size != 2 * len(TILTS):
        raise GraspError(f"approaches: {arrays['approaches'].size} numbers are not 2 x {len(TILTS)}")
    if len(message.joints) != len(message.posture):
        raise GraspError(f"posture: {len(message.posture)} angles do not fit {len(message.joints)} joints")
    if message.thumb_at not in ("g1", "g2"):
        raise GraspError(f"thumb_at: {message.thumb_at!r} is neither g1 nor g2")
    pose[:3, :3] = rotation_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w], np.float64))
    return WayIn(
        arrays["approach"],
        message.thumb_at,
        float(message.depth_m),
        arrays["approaches"].reshape(2, -1),
        pose,
        arrays["posture"],
        tuple(message.joints),
        message.hand,
        getattr(message, "width_at_most_m", 0.0) or float("nan"),  # which messages before 0.5 lack
    )


def decode_predictions(message: Any, channels: Channels | None = None) -> Predictions:
    """Read a `foretouch_msgs/TouchPrediction` as one row, a `TouchPredictionBatch` as K, a `TouchPredictionArray` as its messages.

    Args:
        message: Any object with the fields of one of these. A batch holds no contacts, which are then NaN.
        channels: Channels of its sensor, whose names the message must have; by default made of the message's names, without units.

    Raises:
        TactileError: If the number of values does not fit the names, or a name is missing.
    """
    if hasattr(message, "predictions"):
        rows = [decode_predictions(part, channels) for part in message.predictions]
        if rows:
            return Predictions.join(rows)
        return Predictions.refused(Grasps.unknown(0), channels or Channels("", "", (), ()), "ok", "")
    many = hasattr(message, "statuses")
    count, fingers = (len(message.statuses) if many else 1), len(message.fingers)
    taxels = len(message.valid) // max(1, fingers)
    sizes = dict.fromkeys(message.scalar_channels, 1) | dict.fromkeys(message.channels, taxels)
    if channels is None:
        own = (Channel(name, size, "", -LARGEST, LARGEST, 0, False, 0.0, 0.0) for name, size in sizes.items())
        channels = Channels(message.sensor, message.sensor_sha256, tuple(message.fingers), tuple(own))
    if not fingers:  # without a model there is no sensor
        ends = {"value": np.full((count, channels.size), np.nan)}
    else:
        lead = (count,) if many else ()
        ends = {end: _values(message, names, (*lead, fingers, taxels), channels) for end, names in _ENDS.items()}
    flags = [tuple(message.flags)]
    statuses = [message.status]
    reasons = [message.reason]
    if many:
        marks = np.reshape(message.flagged, (count, len(message.flags))).tolist()
        flags = [tuple(flag for flag, mark in zip(message.flags, row, strict=True) if mark) for row in marks]
        statuses, reasons = list(message.statuses), list(message.reasons)
    reference = dict(enumerate(REFERENCES)).get(message.reference, f"reference {message.reference}")
    return Predictions(
        grasps=Grasps.unknown(count) if many else _row_of(message.grasp),
        channels=channels,
        flags=objects(flags),
        status=objects([STATUSES.get(code, f"status {code}") for code in statuses]),
        reason=objects(reasons),
        reference=objects([reference] * count),
        evidence=objects([_evidence(message)] * count),
        **ends,
    )


def _values(message: Any, fields: tuple[str, str], shape: tuple[int, ...], channels: Channels) -> Float64:
    """Return (K, D) values or bounds in the order of the channels, from the fields of the taxels and of the scalars."""
    parts: dict[str, Float64] = {}
    rows = shape[0] if len(shape) == 3 else 1
    for field, names, size in zip(
        fields, (message.channels, message.scalar_channels), (shape, shape[:-1]), strict=True
    ):
        array = np.asarray(getattr(message, field), np.float64)
        if array.size != math.prod(size) * len(names):
            raise TactileError(f"{field}: {array.size} values are not {' x '.join(map(str, (*size, len(names))))}")
        parts |= {name: array.reshape(rows, -1, len(names))[..., k] for k, name in enumerate(names)}
    if missing := [channel.name for channel in channels.channels if channel.name not in parts]:
        raise TactileError(f"channels: {missing[0]} of {channels.sensor} is missing")
    return np.concatenate([np.empty((rows, 0)), *(parts[channel.name] for channel in channels.channels)], axis=1)


def _row_of(message: Any) -> Grasps:
    """Return the grasp of a message as a row; NaN where it is none."""
    try:
        return Grasps.of([decode_grasp(message)])
    except GraspError:
        return Grasps.unknown(1)


def _evidence(message: Any) -> Evidence:
    ages = []
    for duration in (message.touch_age, message.reading_age):
        seconds = duration.sec + duration.nanosec / SECOND_NS
        ages.append(None if seconds < 0.0 else float(seconds))
    return Evidence(message.touches, ages[0], message.readings, ages[1])


def rotation_from_quaternion(xyzw: Float64) -> Float64:
    """Return (3, 3) float64 rotation of a quaternion (4,), whose length must be 1 within 1e-3, else a `GraspError`."""
    length = float(np.linalg.norm(xyzw)) if (np.abs(xyzw) <= _MAX_UNIT).all() else float(np.abs(xyzw).max())
    if not abs(length - 1.0) <= _UNIT_TOLERANCE:
        raise GraspError(f"orientation: length {length:g} of {xyzw.tolist()} is not 1")
    return _rotations(xyzw / length)


def _rotations(xyzw: Float64) -> Float64:
    """Return (..., 3, 3) rotations of unit quaternions (..., 4)."""
    x, y, z, w = (xyzw[..., k] for k in range(4))
    matrices = np.empty((*xyzw.shape[:-1], 3, 3))
    matrices[..., 0, 0], matrices[..., 0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w)
    matrices[..., 0, 2], matrices[..., 1, 0] = 2 * (x * z + y * w), 2 * (x * y + z * w)
    matrices[..., 1, 1], matrices[..., 1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    matrices[..., 2, 0], matrices[..., 2, 1] = 2 * (x * z - y * w), 2 * (y * z + x * w)
    matrices[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return matrices


def _rotation_of(message: Any) -> Float64:
    quaternion = _quaternion(message)
    matrix = np.asarray(message.rotation, np.float64).reshape(3, 3)
    if not np.any(matrix):
        if not np.any(quaternion):
            raise GraspError("pose: no orientation")
        return rotation_from_quaternion(quaternion)
    check_rotation(matrix)
    if np.any(quaternion) and np.abs(rotation_from_quaternion(quaternion) - matrix).max() > _AGREEMENT:
        raise GraspError("rotation: differs from pose.orientation")
    return matrix


def _quaternion(message: Any) -> Float64:
    q = message.pose.orientation
    return np.array([q.x, q.y, q.z, q.w], np.float64)
