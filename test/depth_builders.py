# SPDX-License-Identifier: Apache-2.0
"""Messages of depth cameras as drivers and image_transport write them, written here a second time in plain Python."""

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

FRAME = "camera_depth_optical_frame"
STAMP_NS = 1_700_000_000_123_456_789


def header(frame_id: str = FRAME, stamp_ns: int = STAMP_NS) -> SimpleNamespace:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame_id)


def image(depth: npt.NDArray[Any], encoding: str, *, big: bool = False, padding: int = 0, **changes: Any) -> Any:
    """A `sensor_msgs/Image`, each row with some bytes behind it."""
    rows = depth.astype(depth.dtype.newbyteorder(">" if big else "<"))
    data = b"".join(row.tobytes() + b"\xa5" * padding for row in rows)
    step = depth.shape[1] * depth.itemsize + padding
    fields = {"header": header(), "height": depth.shape[0], "width": depth.shape[1], "encoding": encoding}
    return SimpleNamespace(**{**fields, "is_bigendian": int(big), "step": step, "data": data, **changes})


def info(**changes: Any) -> Any:
    """A `sensor_msgs/CameraInfo` of 848x480."""
    k = np.array([616.0, 0.0, 423.5, 0.0, 615.0, 239.5, 0.0, 0.0, 1.0])
    p = np.array([610.0, 0.0, 420.0, 0.0, 0.0, 611.0, 241.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    roi = SimpleNamespace(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    fields = {"header": header(), "height": 480, "width": 848, "distortion_model": "plumb_bob", "d": np.zeros(5)}
    return SimpleNamespace(
        **{**fields, "k": k, "r": np.eye(3).ravel(), "p": p, "binning_x": 0, "binning_y": 0, "roi": roi, **changes}
    )


def compressed(data: bytes, form: str = "16UC1; compressedDepth png", a: float = 0.0, b: float = 0.0) -> Any:
    """A `sensor_msgs/CompressedImage` of compressedDepth."""
    return SimpleNamespace(header=header(), format=form, data=struct.pack("<i2f", 0, a, b) + data)


def png(depth: npt.NDArray[np.uint16], bits: int = 16, colour: int = 0, size: tuple[int, int] | None = None) -> bytes:
    """A PNG without filters, by its specification; `size` (width, height) is what it claims."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    width, height = size or depth.shape[::-1]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in depth)
    head = struct.pack(">2I5B", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def rvl(depth: npt.NDArray[np.uint16]) -> bytes:
    """RVL by the text of its paper: runs of zeros and of others in turn, differences zigzag, three bits a nibble."""
    nibbles: list[int] = []

    def number(value: int) -> None:
        while value > 7:
            nibbles.append(8 + value % 8)
            value //= 8
        nibbles.append(value)

    flat, at, before = [int(one) for one in depth.ravel()], 0, 0
    while at < len(flat):
        zeros = next((k for k, one in enumerate(flat[at:]) if one), len(flat) - at)
        at += zeros
        others = next((k for k, one in enumerate(flat[at:]) if not one), len(flat) - at)
        number(zeros)
        number(others)
        for value in flat[at : at + others]:
            difference = value - before
            number(2 * difference if difference >= 0 else -2 * difference - 1)
            before = value
        at += others
    nibbles += [0] * (-len(nibbles) % 8)
    words = [int("".join(f"{nibble:x}" for nibble in nibbles[k : k + 8]), 16) for k in range(0, len(nibbles), 8)]
    return struct.pack("<2I", depth.shape[1], depth.shape[0]) + b"".join(struct.pack("<I", word) for word in words)


def write_bag(
    path: Path,
    messages: Iterable[tuple[str, int, Any]],
    *,
    ros1: bool = False,
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    """A recording of messages: topic, time of the recorder [ns], and fields, whose names say the type."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    opened = Ros1Writer(path) if ros1 else Ros2Writer(path, version=9, storage_plugin=plugin)
    if not ros1 and mode != CompressionMode.NONE:
        opened.set_compression(mode, CompressionFormat.ZSTD)
    with opened as writer:
        topics: dict[str, Any] = {}
        for topic, time_ns, fields in messages:
            name = (
                "Image"
                if hasattr(fields, "encoding")
                else "CompressedImage"
                if hasattr(fields, "format")
                else "CameraInfo"
            )
            kind, named = f"sensor_msgs/msg/{name}", dict(vars(fields))
            if "data" in named:
                named["data"] = np.frombuffer(named["data"], np.uint8)
            if ros1:
                named = {key.upper() if key in "dkrp" else key: value for key, value in named.items()}
                named["header"] = SimpleNamespace(seq=0, **vars(fields.header))
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            write = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(topics[topic], time_ns, write(SimpleNamespace(**named), kind))
    return path
