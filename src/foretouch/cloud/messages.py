# SPDX-License-Identifier: Apache-2.0
"""Messages without ROS: headers, clouds and planes, decoded alike from rclpy and rosbags, and serialised by rosbags.

`object_cloud` holds the points of all target objects, one object after the other, best first. Beside x, y, z (and
rgb) each point carries `label` (UINT32, id of the object) and, where the cloud was cut from an image, `row` and
`column` (UINT16, its pixel). A cloud without these fields is one object without an image. Decoders of grasps are
in `foretouch.grasp.messages`, tactile messages in `foretouch.tactile.messages`.

CDR as ROS 2 uses it: four bytes of encapsulation, whose second gives the byte order, then the fields. A header is
int32 seconds, uint32 nanoseconds, uint32 length of the frame with its final zero, the frame.
"""

import struct
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from foretouch.cloud.geometry.frames import has_depth
from foretouch.cloud.io.pointcloud2 import DATATYPES, decode, encode
from foretouch.errors import CloudError, DatasetError
from foretouch.types import ASSUMED_TABLE, SECOND_NS, AnyArray, Cloud, Index, Plane, stamp_ns
from foretouch.types.scene import Object

_START: Final = 4  # of the fields in CDR
_STAMP_END_NS: Final = 2**31 * SECOND_NS  # builtin_interfaces/Time counts seconds in an int32
_MAX_OFFSET_M: Final = 1000.0  # of a table from the camera, or more by the largest component of its normal
_MAX_COEFFICIENT: Final = 1e100  # of a plane


def read_header(data: bytes) -> tuple[int, str]:
    """Return the stamp [ns] and frame of a serialised message that begins with a header; a `DatasetError` if it cannot be read."""
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
        raise DatasetError(f"header: {len(data)} bytes are not a message")
    return "<" if data[1] & 1 else ">"


def header_fields(stamp_ns: int, frame_id: str, name: str) -> SimpleNamespace:
    """Return the fields of a `std_msgs/Header`; a `DatasetError` names the stamp [ns] if ROS cannot represent it."""
    if not 0 <= stamp_ns < _STAMP_END_NS:
        raise DatasetError(f"{name}: {stamp_ns} is before 1970 or after 2038, where the stamps of ROS end")
    seconds, nanoseconds = divmod(int(stamp_ns), SECOND_NS)
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def cloud_fields(cloud: Cloud, stamp_name: str = "stamp_ns") -> SimpleNamespace:
    """Return the fields of a `sensor_msgs/PointCloud2`; a `DatasetError` for a stamp that a message cannot hold."""
    header = header_fields(cloud.stamp_ns, cloud.frame_id, stamp_name)
    return SimpleNamespace(header=header, **vars(encode(cloud)))


def join_objects(objects: Sequence[Object], frame_id: str, stamp_ns: int) -> tuple[Cloud, dict[str, AnyArray]]:
    """Join objects to the points of an `object_cloud`.

    Args:
        objects: Their ids are integers.
        frame_id: Frame of the scene's cloud.
        stamp_ns: Stamp of the scene's cloud [ns].

    Returns:
        The cloud, without points if there is no object, and the further numbers of each point by name, for `encode`.
    """
    colours = [object_.cloud.rgb for object_ in objects if object_.cloud.rgb is not None]
    pixels = [np.divmod(object_.pixels, object_.image_shape[1]) for object_ in objects if object_.image_shape]
    xyz = np.concatenate([object_.cloud.xyz for object_ in objects] or [np.empty((0, 3), np.float32)])
    rgb = np.concatenate(colours) if objects and len(colours) == len(objects) else None
    ids = np.array([int(object_.id) for object_ in objects], np.uint32)
    sizes = [object_.cloud.size for object_ in objects]
    columns: dict[str, AnyArray] = {"label": np.repeat(ids, sizes or 1)}  # NumPy refuses an empty list of counts
    if pixels:
        rows, places = map(np.concatenate, zip(*pixels, strict=True))
        columns |= {"row": rows.astype(np.uint16), "column": places.astype(np.uint16)}
    return Cloud(xyz, rgb, frame_id, stamp_ns), columns


def decode_cloud(message: Any) -> Cloud:
    """Decode a `sensor_msgs/PointCloud2`; the arrays are read-only views of the message where its layout allows.

    Raises a `CloudError` if the sizes do not add up, or x, y or z is missing or of another type.
    """
    xyz, rgb = decode(message)
    return Cloud(xyz, rgb, message.header.frame_id, stamp_ns(message.header.stamp))


def decode_plane(message: Any) -> Plane | None:
    """Decode a `shape_msgs/Plane`; None for four zeros.

    Raises:
        CloudError: If a number is not finite, only the normal is zero, or the plane is farther away than any table.
    """
    if not np.any(message.coef):
        return None
    exact = np.asarray(message.coef, np.float64)
    scale = float(np.abs(exact[:3]).max())
    if np.isfinite(exact).all() and scale and not abs(float(exact[3])) / scale <= _MAX_OFFSET_M:
        raise CloudError(f"plane: {exact.tolist()} is farther away than {_MAX_OFFSET_M:g} m")
    if np.isfinite(exact).all() and scale > _MAX_COEFFICIENT:  # its square may overflow
        raise CloudError(f"plane: {exact.tolist()} has a number beyond {_MAX_COEFFICIENT:g}")
    plane = Plane.from_coefficients(message.coef)
    if abs(float(np.linalg.norm(exact[:3])) - 1.0) < 1e-12:
        # A unit normal must stay as it is: dividing it by its length again may change its last bit.
        return Plane(exact[:3], float(exact[3]))
    return plane


def decode_objects(message: Any, table: Plane = ASSUMED_TABLE) -> tuple[Object, ...]:
    """Decode the objects of an `object_cloud` in their order. A cloud without labels is one object with the id "".

    Args:
        message: The cloud. Of one without labels, points without depth are left out.
        table: Of all objects, in the frame of the cloud.

    Raises:
        CloudError: If its sizes do not add up, x, y or z is missing, or a label, row or column is of another type.
    """
    cloud = decode_cloud(message)
    if cloud.size == 0:
        return ()
    labels, rows, columns = (_integer_field(message, name) for name in ("label", "row", "column"))
    if labels is None:
        finite = np.flatnonzero(has_depth(cloud.xyz))
        return (Object.of("", cloud.take(finite), table),) if finite.size else ()
    shape, pixels = None, np.empty(0, np.int64)
    if rows is not None and columns is not None:
        shape = (int(rows.max()) + 1, int(columns.max()) + 1)
        pixels = rows.astype(np.int64) * shape[1] + columns
    return tuple(
        Object.of(
            str(label), cloud.take(members), table, pixels=pixels[members] if shape else pixels, image_shape=shape
        )
        for label, members in _by_label(labels)
    )


def _by_label(labels: AnyArray) -> list[tuple[Any, Index]]:
    """Return each label with its points, in the order of their first points."""
    if (labels == labels[0]).all():  # the usual case
        return [(labels[0], np.arange(len(labels)))]
    present, first, inverse, counts = np.unique(labels, return_index=True, return_inverse=True, return_counts=True)
    members = np.split(np.argsort(inverse, kind="stable"), np.cumsum(counts)[:-1])
    return [(present[k], members[k]) for k in np.argsort(first)]


def _integer_field(message: Any, name: str) -> AnyArray | None:
    """Return one of the whole-number fields of an unorganised object cloud, or None where it is absent."""
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
