# SPDX-License-Identifier: Apache-2.0
"""Takes the next message of a subscription: a cloud as its bytes, while others use the interpreter.

rclpy holds the interpreter's lock while it takes a message, and copies a cloud three times: 2.1 ms at 848x480, in which
no other cloud is computed. rcl's own function, called through ctypes, copies it twice and without the lock, in 1.4 ms. It also
gives the publisher of a message, which some versions of rclpy do not; for other messages than clouds it costs 0.01 ms more.
"""

import ctypes
import struct
from typing import Any, Final

import numpy as np
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2

from foretouch.types import UInt8

_NONE: Final = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
_NO_SEQUENCE: Final = 2**64 - 1  # RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED


class _Allocator(ctypes.Structure):
    """`rcutils_allocator_t`: four functions and their state."""

    _fields_ = (("all", ctypes.c_void_p * 5),)


class _Array(ctypes.Structure):
    """`rcutils_uint8_array_t`."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


_Info = ctypes.c_uint64 * 16
"""`rmw_message_info_t`: times of sending and reception, numbers of sending and reception, a pointer, and the publisher's id."""

_rcl, _rcutils = (ctypes.CDLL(f"lib{name}.so") for name in ("rcl", "rcutils"))
_rcutils.rcutils_get_default_allocator.restype = _Allocator
_rcl.rcl_take_serialized_message.argtypes = [ctypes.c_void_p] * 4


class _Bytes:
    """Bytes that rcl allocates, freed with the last array that shows them."""

    def __init__(self) -> None:
        self.array = _Array(allocator=_rcutils.rcutils_get_default_allocator())

    @property
    def __array_interface__(self) -> dict[str, Any]:
        return {"version": 3, "shape": (self.array.length,), "typestr": "|u1", "data": (self.array.buffer, True)}

    def __del__(self) -> None:
        _rcutils.rcutils_uint8_array_fini(ctypes.byref(self.array))


def take(subscription: "Subscription[Any]") -> tuple[Any, Any] | None:
    """The next message, bytes if it is `raw`, and what is known of it; None where there is none, or its bytes are damaged.

    What is known has keys that rclpy gives since 9.1, the publisher among them. The `data` of a cloud are a read-only array. Damaged bytes show as a gap in the numbers of the publisher, as with rclpy.

    Raises:
        RuntimeError: Or another of rclpy, if the message cannot be taken.
        InvalidHandle: If the subscription was destroyed.
    """
    handle = subscription.handle
    with handle:
        content, info = _Bytes(), _Info()
        status = _rcl.rcl_take_serialized_message(handle.pointer, ctypes.byref(content.array), ctypes.byref(info), None)
    if status == _NONE:
        return None
    if status:
        _rcutils.rcutils_reset_error()
        raise RuntimeError(f"{subscription.topic_name}: a message cannot be taken: rcl's error {status}")
    message = np.asarray(content).tobytes() if subscription.raw else _read(np.asarray(content), subscription.msg_type)
    return None if message is None else (message, _known(info))


def _known(info: "ctypes.Array[ctypes.c_uint64]") -> dict[str, Any]:
    """What rclpy 9.1 passes beside a message, but for the number of receptions."""
    sent, received, sequence, *_ = info
    return {
        "source_timestamp": sent,
        "received_timestamp": received,
        "publication_sequence_number": None if sequence == _NO_SEQUENCE else sequence,
        "publisher_gid": {"data": bytes(info)[40:56]},
    }


def _read(content: UInt8, kind: Any) -> Any:
    """A serialised message, the points of a cloud staying where they are; None if its bytes are damaged."""
    try:
        if kind is not PointCloud2:
            return deserialize_message(content.tobytes(), kind)
        start, length = _points_at(content)
        rest = content[start + length :]
        message = deserialize_message(content[: start - 4].tobytes() + bytes(4) + rest.tobytes(), PointCloud2)
    except (struct.error, IndexError, RuntimeError):
        return None
    message._data = content[start : start + length]  # noqa: SLF001  its setter copies, byte by byte
    return message


def _points_at(content: UInt8) -> tuple[int, int]:
    """Where the points of a serialised cloud begin, and their number of bytes; a `struct.error` beyond its end."""
    form, at = struct.Struct("<I" if content[1] & 1 else ">I"), 12  # after encapsulation and stamp

    def number(after: int = 0) -> int:
        """The aligned number that comes next, after so many bytes."""
        nonlocal at
        at += after
        at += -at % 4
        (value,) = form.unpack_from(content.data, at)
        at += 4
        return int(value)

    length = number()  # of frame_id
    number(length), number()  # height, width
    for _ in range(number()):
        number(number()), number(1)  # name and offset, datatype and count
    number(1), number()  # is_bigendian and point_step, row_step
    return at + 4, number()
