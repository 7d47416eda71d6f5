# SPDX-License-Identifier: Apache-2.0
"""Decode and encode a `sensor_msgs/PointCloud2` of rclpy or rosbags, or any object with its fields, without ROS.

The bytes are read through strided NumPy views, so decoding takes the same time for one point and for a million. Only what
no view can express is copied: numbers of the other byte order, float64 coordinates, and x, y, z that are not evenly spaced.
"""

import sys
from collections.abc import Callable, Mapping
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np

from foretouch.errors import CloudError
from foretouch.types import AnyArray, Cloud, Float32, UInt8

# Codes of sensor_msgs/PointField.
DATATYPES: dict[int, str] = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_UINT8, _FLOAT32, _FLOAT64 = 2, 7, 8
_UINT = {2: 4, 4: 6}  # by size [bytes]
_PACKED_COLOUR = (5, 6, 7)  # four bytes, regardless of the declared type
_View = Callable[
    ..., AnyArray
]  # of one number of each point, by type and offset; or of several, by count and stride too


def decode(message: Any) -> tuple[Float32, UInt8 | None]:
    """Return the coordinates and colours of a message.

    Args:
        message: Its `data` are `bytes`, `array.array`, `memoryview` or uint8 array. The result may be a view of them, so
            they must stay unchanged as long as it is used.

    Returns:
        (N, 3), or (H, W, 3) if the height is above 1, float32 [m], and colours of the same shape, uint8, or None. Both
        are read-only, and views where possible. Points without depth keep their NaN or infinity. Colours come from
        `rgb` or `rgba` (blue in the lowest byte, as PCL packs them) or from `r`, `g`, `b` of UINT8; others are ignored.

    Raises:
        CloudError: If the sizes do not match, fields overlap, or x, y or z is missing, or has a wrong datatype.
    """
    fields = _checked_fields(message)
    try:
        data = np.frombuffer(message.data, np.uint8)
    except (TypeError, ValueError, BufferError) as err:
        raise CloudError(f"data: {err}") from err
    height = message.height
    width = message.width
    row_step = message.row_step
    big = bool(message.is_bigendian)
    if data.size != row_step * height:
        expected = f"row_step {row_step} x height {height} = {row_step * height}"
        raise CloudError(f"data: {data.size} bytes are not {expected}")
    shape = (height, width) if height > 1 else (width,)
    if 0 in (height, width):
        shape = (0,)
    strides = (row_step, message.point_step)[2 - len(shape) :]

    def view(dtype: str, offset: int, *last: int) -> AnyArray:
        full = (*shape, *last[:1])
        if 0 in full:
            return np.empty(full, dtype)
        return np.ndarray(full, dtype, data, offset, (*strides, *last[1:]))

    xyz, rgb = _xyz(view, fields, big), _rgb(view, fields, big)
    for result in (xyz, rgb):
        if result is not None:
            result.flags.writeable = False
    return xyz, rgb


def _checked_fields(message: Any) -> dict[str, Any]:
    """Return the fields of a point by name; checks sizes, datatypes, and that fields lie within the point without overlap."""
    for name in ("height", "width", "point_step", "row_step"):
        if getattr(message, name) < 0:
            raise CloudError(f"{name}: {getattr(message, name)} is negative")
    if message.height and message.row_step < message.width * message.point_step:
        row = f"width {message.width} x point_step {message.point_step}"
        raise CloudError(f"row_step: {message.row_step} is less than {row}")
    by_name: dict[str, Any] = {}
    solid = []
    for field in message.fields:
        if field.name in by_name:
            raise CloudError(f"fields: {field.name} occurs twice")
        if field.datatype not in DATATYPES:
            raise CloudError(f"{field.name}: datatype {field.datatype} is not one of 1 to 8")
        if field.offset < 0 or field.count < 0:
            raise CloudError(f"{field.name}: offset {field.offset} or count {field.count} is negative")
        end = field.offset + field.count * int(DATATYPES[field.datatype][1])
        if end > message.point_step:
            raise CloudError(f"{field.name}: ends at byte {end}, beyond point_step {message.point_step}")
        by_name[field.name] = field
        if field.count:
            solid.append((field.offset, end, field.name))
    for (_, end, name), (offset, _, after) in pairwise(sorted(solid)):
        if offset < end:
            raise CloudError(f"{after}: offset {offset} lies within {name}, which ends at {end}")
    return by_name


def _xyz(view: _View, fields: Mapping[str, Any], big: bool) -> Float32:
    for name in "xyz":
        if name not in fields:
            raise CloudError(f"fields: {name} is missing; there are: {', '.join(fields) or 'none'}")
        if fields[name].datatype not in (_FLOAT32, _FLOAT64) or fields[name].count != 1:
            raise CloudError(f"{name}: is not one FLOAT32 or FLOAT64")
    x, y, z = (fields[name] for name in "xyz")
    spacing = y.offset - x.offset
    single = all(axis.datatype == _FLOAT32 for axis in (x, y, z))
    if single and spacing == z.offset - y.offset and big == (sys.byteorder == "big"):
        return view("f4", x.offset, 3, spacing)
    parts = [view((">" if big else "<") + DATATYPES[axis.datatype], axis.offset) for axis in (x, y, z)]
    with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 becomes infinite, and a signalling NaN quiet
        return np.stack([part.astype(np.float32) for part in parts], axis=-1)


def _rgb(view: _View, fields: Mapping[str, Any], big: bool) -> UInt8 | None:
    packed = fields.get("rgb") or fields.get("rgba")
    if packed is not None:
        if packed.datatype not in _PACKED_COLOUR or packed.count != 1:
            raise CloudError(f"{packed.name}: is not one FLOAT32, UINT32 or INT32")
        # In memory: blue, green, red, alpha, or the reverse where big-endian.
        return view("u1", packed.offset + 1, 3, 1) if big else view("u1", packed.offset + 2, 3, -1)
    channels = [fields[name] for name in "rgb" if name in fields]
    plain = [view("u1", channel.offset) for channel in channels if channel.datatype == _UINT8 and channel.count == 1]
    return np.stack(plain, axis=-1) if len(plain) == 3 else None


def encode(cloud: Cloud, **columns: AnyArray) -> SimpleNamespace:
    """Return the fields of a message for a cloud, but for its header.

    Args:
        cloud: Organised or not; a point takes 12 bytes (x, y, z), with colour 16 (and `rgb`,
            packed into a FLOAT32 as PCL and RViz expect).
        columns: Further fields of its N points by name, (N,) uint16 or uint32.

    Returns:
        The fields; `data` are the bytes of the cloud itself where its points have no colour and no other columns.
    """
    shape = cloud.xyz.shape[:-1]
    height, width = shape if cloud.organised else (1, *shape)
    fields = [_field(name, 4 * i, _FLOAT32) for i, name in enumerate("xyz")]
    points: AnyArray = cloud.xyz.astype("<f4", order="C", copy=False)
    if cloud.rgb is not None:
        fields.append(_field("rgb", 12, _FLOAT32))
        points = _with_colour(points, cloud.rgb)
    step = 12 if cloud.rgb is None else 16
    if columns:
        record = np.dtype(
            [("own", "<f4", (step // 4,)), *((name, f"<u{column.itemsize}") for name, column in columns.items())]
        )
        records = np.empty(cloud.size, record)
        records["own"] = points.reshape(-1, points.shape[-1])
        for name, column in columns.items():
            records[name] = column
            fields.append(_field(name, step, _UINT[column.itemsize]))
            step += column.itemsize
        points = records
    return SimpleNamespace(
        height=height,
        width=width,
        fields=fields,
        is_bigendian=False,
        point_step=step,
        row_step=step * width,
        data=points.reshape(-1).view(np.uint8),
        is_dense=bool(np.isfinite(cloud.xyz).all()),
    )


def _field(name: str, offset: int, datatype: int) -> SimpleNamespace:
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=1)


def _with_colour(xyz: Float32, rgb: UInt8) -> Float32:
    points = np.empty((*xyz.shape[:-1], 4), "<f4")
    for i in range(3):  # by column: four times as fast as one assignment of three
        points[..., i] = xyz[..., i]
    packed = rgb[..., 0].astype(np.uint32)
    for channel in (1, 2):
        packed <<= 8
        packed |= rgb[..., channel]
    points.view("<u4")[..., 3] = packed
    return points
