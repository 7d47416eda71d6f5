# SPDX-License-Identifier: Apache-2.0
"""The `std_msgs/Header` at the start of a serialised message, read and replaced without decoding the rest.

CDR as ROS 2 uses it: four bytes of encapsulation, whose second tells the byte order, then the
fields: int32 seconds, uint32 nanoseconds, uint32 length of the frame with its final zero, the frame.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from foretouch.errors import DatasetError

__all__ = ["StampedHeader", "read_header", "with_stamp"]

_START = 4


class StampedHeader(NamedTuple):
    """Stamp [ns] and frame of a message."""

    stamp_ns: int
    frame_id: str


def read_header(data: bytes) -> StampedHeader:
    """The header of a message that begins with one.

    Raises:
        DatasetError: If the bytes end too early or the frame is no text.
    """
    order = _byte_order(data)
    try:
        seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, _START)
        frame = data[_START + 12 : _START + 12 + length]
        if len(frame) != length:
            raise DatasetError(f"header: frame_id of {length} bytes, {len(frame)} are there")
        return StampedHeader(seconds * 1_000_000_000 + nanoseconds, frame.rstrip(b"\0").decode())
    except (struct.error, UnicodeDecodeError) as err:
        raise DatasetError(f"header: {err}") from err


def with_stamp(data: bytes, stamp_ns: int) -> bytes:
    """The message with another stamp [ns] in its header; all other bytes are kept.

    Raises:
        DatasetError: If the bytes end too early, or ROS cannot hold the stamp.
    """
    changed = bytearray(data)
    try:
        struct.pack_into(f"{_byte_order(data)}iI", changed, _START, *divmod(stamp_ns, 1_000_000_000))
    except struct.error as err:
        raise DatasetError(f"header: stamp {stamp_ns} ns: {err}") from err
    return bytes(changed)


def _byte_order(data: bytes) -> str:
    if len(data) < _START:
        raise DatasetError(f"header: {len(data)} bytes are no message")
    return "<" if data[1] & 1 else ">"
