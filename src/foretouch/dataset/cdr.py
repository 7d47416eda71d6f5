# SPDX-License-Identifier: Apache-2.0
"""Serialised messages without ROS: the `std_msgs/Header` they begin with, and clouds as the fields of `PointCloud2`.

CDR as ROS 2 uses it: four bytes of encapsulation, whose second gives the byte order, then the
fields: int32 seconds, uint32 nanoseconds, uint32 length of the frame with its final zero, the frame.
"""

import struct
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

import numpy as np

from foretouch.cloud.io.pointcloud2 import encode
from foretouch.errors import DatasetError
from foretouch.types import Cloud

_START: Final = 4
_NS: Final = 1_000_000_000
_STAMP_END_NS: Final = 2**31 * _NS  # builtin_interfaces/Time counts seconds in an int32


class StampedHeader(NamedTuple):
    """Stamp [ns] and frame of a message."""

    stamp_ns: int
    frame_id: str


def read_header(data: bytes) -> StampedHeader:
    """Read the header of a message that begins with one, without decoding the rest.

    Raises:
        DatasetError: If the bytes end too early or the frame is no text.
    """
    order = _byte_order(data)
    try:
        seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, _START)
        frame = data[_START + 12 : _START + 12 + length]
        if len(frame) != length:
            raise DatasetError(f"header: frame_id of {length} bytes, {len(frame)} are there")
        return StampedHeader(seconds * _NS + nanoseconds, frame.rstrip(b"\0").decode())
    except (struct.error, UnicodeDecodeError) as err:
        raise DatasetError(f"header: {err}") from err


def with_stamp(data: bytes, stamp_ns: int) -> bytes:
    """Replace the stamp [ns] in the header of a message; all other bytes are kept.

    Raises:
        DatasetError: If the bytes end too early, or ROS cannot represent the stamp.
    """
    changed = bytearray(data)
    try:
        struct.pack_into(f"{_byte_order(data)}iI", changed, _START, *divmod(stamp_ns, _NS))
    except struct.error as err:
        raise DatasetError(f"header: stamp {stamp_ns} ns: {err}") from err
    return bytes(changed)


def header_fields(stamp_ns: int, frame_id: str, name: str) -> SimpleNamespace:
    """The fields of a `std_msgs/Header`.

    Args:
        stamp_ns: [ns] since 1970.
        frame_id: The frame.
        name: Name of the stamp, for the error message.

    Raises:
        DatasetError: If the stamp is before 1970 or after 2038.
    """
    if not 0 <= stamp_ns < _STAMP_END_NS:
        raise DatasetError(f"{name}: {stamp_ns} is before 1970 or after 2038, where the stamps of ROS end")
    seconds, nanoseconds = divmod(int(stamp_ns), _NS)
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def stamp_ns_of(header: Any) -> int:
    """The stamp of a header [ns]."""
    return int(header.stamp.sec) * _NS + int(header.stamp.nanosec)


def cloud_fields(cloud: Cloud, stamp_name: str = "stamp_ns") -> SimpleNamespace:
    """The fields of a `sensor_msgs/PointCloud2` (raises as `header_fields`)."""
    layout, data = encode(cloud)
    return SimpleNamespace(
        header=header_fields(cloud.stamp_ns, cloud.frame_id, stamp_name),
        height=layout.height,
        width=layout.width,
        fields=[
            SimpleNamespace(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count) for f in layout.fields
        ],
        is_bigendian=layout.is_bigendian,
        point_step=layout.point_step,
        row_step=layout.row_step,
        data=np.frombuffer(data, np.uint8),
        is_dense=layout.is_dense,
    )


def _byte_order(data: bytes) -> str:
    if len(data) < _START:
        raise DatasetError(f"header: {len(data)} bytes are no message")
    return "<" if data[1] & 1 else ">"
