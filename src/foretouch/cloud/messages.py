# SPDX-License-Identifier: Apache-2.0
"""Messages without ROS: headers, clouds and grasps, decoded alike from rclpy and rosbags, and serialised by rosbags.

`object_cloud` holds the points of all target objects, one object after the other, best first. Beside x, y, z (and
rgb) each point carries `label` (UINT32, id of the object) and, where the cloud was cut from an image, `row` and
`column` (UINT16, its pixel). A cloud without these fields is one object without an image. Decoders of tactile messages
are in `foretouch.tactile.messages`.

CDR as ROS 2 uses it: four bytes of encapsulation, whose second gives the byte order, then the fields. A header is
int32 seconds, uint32 nanoseconds, uint32 length of the frame with its final zero, the frame.
"""

import struct
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

import numpy as np

from foretouch.cloud.io.pointcloud2 import DATATYPES, PointCloud2Layout, PointField, decode, encode
from foretouch.errors import CloudError, DatasetError, GraspError
from foretouch.grasp.pose import quaternion_xyzw
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import SECOND_NS, AnyArray, Bool, Cloud, Float64, Grasp, Index, Int64

_START: Final = 4  # of the fields in CDR
_STAMP_END_NS: Final = 2**31 * SECOND_NS  # builtin_interfaces/Time counts seconds in an int32
_MAX_UNIT: Final = 2.0  # no component of a rotation is larger; the square of such a number may overflow
_UNIT_TOLERANCE: Final = 1e-3  # of a quaternion's length; planners work with float32
_AGREEMENT: Final = 1e-3  # between a grasp's matrix and its quaternion, per element
_SURELY: Final = 0.999  # of a limit: below, rounding in another order makes no difference


def read_header(data: bytes) -> tuple[int, str]:
    """Stamp [ns] and frame of a serialised message that begins with a header; a `DatasetError` if it cannot be read."""
    try:
        seconds, nanoseconds, length = struct.unpack_from(f"{_byte_order(data)}iII", data, _START)
        frame = data[_START + 12 : _START + 12 + length]
        if len(frame) != length:
            raise DatasetError(f"header: frame_id of {length} bytes, {len(frame)} are there")
        return seconds * SECOND_NS + nanoseconds, frame.rstrip(b"\0").decode()
    except (struct.error, UnicodeDecodeError) as err:
        raise DatasetError(f"header: {err}") from err


def with_stamp(data: bytes, stamp_ns: int) -> bytes:
    """Replace the stamp [ns] in the header of a serialised message; all other bytes are kept."""
    changed = bytearray(data)
    try:
        struct.pack_into(f"{_byte_order(data)}iI", changed, _START, *divmod(stamp_ns, SECOND_NS))
    except struct.error as err:
        raise DatasetError(f"header: stamp {stamp_ns} ns: {err}") from err
    return bytes(changed)


def _byte_order(data: bytes) -> str:
    if len(data) < _START:
        raise DatasetError(f"header: {len(data)} bytes are no message")
    return "<" if data[1] & 1 else ">"


def header_fields(stamp_ns: int, frame_id: str, name: str) -> SimpleNamespace:
    """The fields of a `std_msgs/Header`; a `DatasetError` names the stamp [ns] if ROS cannot represent it."""
    if not 0 <= stamp_ns < _STAMP_END_NS:
        raise DatasetError(f"{name}: {stamp_ns} is before 1970 or after 2038, where the stamps of ROS end")
    seconds, nanoseconds = divmod(int(stamp_ns), SECOND_NS)
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def cloud_fields(cloud: Cloud, stamp_name: str = "stamp_ns") -> SimpleNamespace:
    """The fields of a `sensor_msgs/PointCloud2` (raises as `header_fields`)."""
    layout, data = encode(cloud)
    header = header_fields(cloud.stamp_ns, cloud.frame_id, stamp_name)
    return SimpleNamespace(header=header, data=np.frombuffer(data, np.uint8), **vars(layout))


def grasp_fields(grasp: Grasp) -> SimpleNamespace:
    """The fields of a `foretouch_msgs/Grasp`."""
    x, y, z, w = map(float, quaternion_xyzw(grasp.rotation))
    return SimpleNamespace(
        id=grasp.id,
        object_id=grasp.object_id,
        g1=_point(grasp.g1),
        g2=_point(grasp.g2),
        pose=SimpleNamespace(position=_point(grasp.midpoint), orientation=SimpleNamespace(x=x, y=y, z=z, w=w)),
        rotation=np.ascontiguousarray(grasp.rotation.reshape(9), np.float64),
        score=float(grasp.score),
        status=0,
        reason="",
    )


def _point(position: Any) -> SimpleNamespace:
    x, y, z = map(float, position)
    return SimpleNamespace(x=x, y=y, z=z)


class ObjectCloud(NamedTuple):
    """One object of an `object_cloud`."""

    id: str  # its label as text; "" in a cloud without labels
    cloud: Cloud  # (N, 3), the points of this object
    pixels: Int64 | None = None  # (N,) int64, flat index of each point in the image that it was cut from, if any
    image_shape: tuple[int, int] | None = None  # (H, W) of that image


def decode_cloud(message: Any) -> Cloud:
    """A `sensor_msgs/PointCloud2`; the arrays are read-only views of the message where its layout allows.

    Raises a `CloudError` if the sizes do not add up, or x, y or z is missing or of another type.
    """
    layout = PointCloud2Layout(
        height=message.height,
        width=message.width,
        fields=tuple(PointField(f.name, f.offset, f.datatype, f.count) for f in message.fields),
        is_bigendian=bool(message.is_bigendian),
        point_step=message.point_step,
        row_step=message.row_step,
    )
    xyz, rgb = decode(layout, message.data)
    return Cloud(xyz, rgb, message.header.frame_id, stamp_ns(message.header.stamp))


def decode_objects(message: Any) -> tuple[ObjectCloud, ...]:
    """The objects of an `object_cloud` in their order; a cloud without labels is one object, without its NaN points.

    Raises a `CloudError` as `decode_cloud`, and if a label, row or column is of another type.
    """
    cloud = decode_cloud(message)
    if cloud.size == 0:
        return ()
    labels, rows, columns = (_integer_field(message, name) for name in ("label", "row", "column"))
    if labels is None:
        finite = np.flatnonzero(np.isfinite(cloud.xyz).all(axis=-1))
        return (ObjectCloud("", cloud.take(finite)),) if finite.size else ()
    shape = pixels = None
    if rows is not None and columns is not None:
        shape = (int(rows.max()) + 1, int(columns.max()) + 1)
        pixels = rows.astype(np.int64) * shape[1] + columns
    return tuple(
        ObjectCloud(str(label), cloud.take(members), None if pixels is None else pixels[members], shape)
        for label, members in _by_label(labels)
    )


def _by_label(labels: AnyArray) -> list[tuple[Any, Index]]:
    """Each label with its points, in the order of their first points."""
    if (labels == labels[0]).all():  # the usual case
        return [(labels[0], np.arange(len(labels)))]
    found, first, inverse, counts = np.unique(labels, return_index=True, return_inverse=True, return_counts=True)
    members = np.split(np.argsort(inverse, kind="stable"), np.cumsum(counts)[:-1])
    return [(found[k], members[k]) for k in np.argsort(first)]


def has_orientation(message: Any) -> bool:
    """Whether a `foretouch_msgs/Grasp` holds a rotation, as a matrix or as a quaternion."""
    return bool(np.any(_quaternion(message)) or np.any(message.rotation))


def decode_grasp(message: Any, rotation: Float64 | None = None) -> Grasp:
    """A `foretouch_msgs/Grasp`. The position of its pose is not used: it is the midpoint of the contacts.

    Args:
        message: With a matrix, a quaternion, or both; nine zeros as matrix mean that only the quaternion counts.
        rotation: (3, 3) float64, instead of that of the message.

    Raises:
        GraspError: If a number is not finite, the contacts are one point, or matrix and quaternion are absent or
            differ.
    """
    g1, g2 = (np.array([p.x, p.y, p.z], np.float64) for p in (message.g1, message.g2))
    rotation = _rotation_of(message) if rotation is None else rotation
    return Grasp(g1, g2, rotation, float(message.score), message.id, message.object_id)


def _grasp_numbers(messages: Sequence[Any]) -> tuple[Float64, Float64, Float64]:
    """(K, 2, 3) contacts, (K, 4) quaternions xyzw and (K, 3, 3) rotations of K `foretouch_msgs/Grasp`, float64."""
    rows = []
    for one in messages:
        g1, g2, q = one.g1, one.g2, one.pose.orientation
        rows.append((g1.x, g1.y, g1.z, g2.x, g2.y, g2.z, q.x, q.y, q.z, q.w))
    numbers = np.array(rows, np.float64).reshape(-1, 10)
    rotations = np.array([one.rotation for one in messages], np.float64).reshape(-1, 3, 3)
    return numbers[:, :6].reshape(-1, 2, 3), numbers[:, 6:], rotations


def surely_sound(contacts: Float64, matrices: Float64) -> Bool:
    """(K,) whether (K, 2, 3) contacts are finite and apart and (K, 3, 3) matrices rotations; false close to a limit."""
    with np.errstate(all="ignore"):  # what is not finite is not sound
        skewed = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    apart = np.isfinite(contacts).all(axis=(1, 2)) & (contacts[:, 0] != contacts[:, 1]).any(axis=1)
    return np.asarray(apart & (skewed < _SURELY * _AGREEMENT), np.bool_)


def decode_grasps(messages: Sequence[Any]) -> list[Grasp | None]:
    """As `decode_grasp` of each message, in a tenth of the time for many; None where that has to decide."""
    contacts, xyzw, matrices = _grasp_numbers(messages)
    with np.errstate(all="ignore"):  # what is not finite is not fine
        length = np.sqrt((xyzw**2).sum(axis=1))
        turned = np.abs(_rotations(xyzw / length[:, None]) - matrices).max(axis=(1, 2))
        agrees = (np.abs(length - 1.0) < _SURELY * _UNIT_TOLERANCE) & (turned < _SURELY * _AGREEMENT)
    fine = surely_sound(contacts, matrices) & (agrees | ~xyzw.any(axis=1))
    return [
        Grasp.checked(g1, g2, matrix, float(one.score), one.id, one.object_id) if good else None
        for one, (g1, g2), matrix, good in zip(messages, contacts, matrices, fine.tolist(), strict=True)
    ]


def rotation_from_quaternion(xyzw: Float64) -> Float64:
    """(3, 3) float64 rotation of a quaternion (4,), whose length must be 1 within 1e-3, else a `GraspError`."""
    length = float(np.linalg.norm(xyzw)) if (np.abs(xyzw) <= _MAX_UNIT).all() else float(np.abs(xyzw).max())
    if not abs(length - 1.0) <= _UNIT_TOLERANCE:
        raise GraspError(f"orientation: length {length:g} of {xyzw.tolist()} is not 1")
    return _rotations(xyzw / length)


def _rotations(xyzw: Float64) -> Float64:
    """(..., 3, 3) rotations of unit quaternions (..., 4)."""
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
    require_rotation(matrix)
    if np.any(quaternion) and not np.allclose(rotation_from_quaternion(quaternion), matrix, rtol=0.0, atol=_AGREEMENT):
        raise GraspError("rotation: is not that of pose.orientation")
    return matrix


def require_rotation(matrix: Float64) -> None:
    """Refuse a matrix (3, 3) whose columns are not of unit length and perpendicular within 1e-3, by a `GraspError`."""
    bounded = (np.abs(matrix) <= _MAX_UNIT).all()
    if not (bounded and np.allclose(matrix @ matrix.T, np.eye(3), rtol=0.0, atol=_AGREEMENT)):
        raise GraspError(f"rotation: {matrix.tolist()} is not a rotation")


def _quaternion(message: Any) -> Float64:
    q = message.pose.orientation
    return np.array([q.x, q.y, q.z, q.w], np.float64)


def _integer_field(message: Any, name: str) -> AnyArray | None:
    """One of the whole-number fields of an unorganised object cloud, or None where it is absent."""
    field = next((f for f in message.fields if f.name == name), None)
    if field is None:
        return None
    kind = DATATYPES.get(field.datatype)
    if kind not in {"u4", "u2"} or field.count != 1 or message.height != 1:
        raise CloudError(f"{name}: is not one UINT32 or UINT16 a point of an unorganised cloud")
    order = ">" if message.is_bigendian else "<"
    return np.ndarray(
        (message.width,), order + kind, buffer=message.data, offset=field.offset, strides=(message.point_step,)
    )
