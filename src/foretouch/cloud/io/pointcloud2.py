# SPDX-License-Identifier: Apache-2.0
"""Decode and encode the bytes of a `sensor_msgs/PointCloud2`, without ROS.

`PointCloud2Layout` describes the layout of the message; its bytes are read through strided NumPy views, so decoding
takes the same time for one point and for a million. Only what no view can express is copied: numbers of the other byte
order, float64 coordinates, and x, y, z that are not evenly spaced.
"""

from __future__ import annotations

import array
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from foretouch.errors import CloudError
from foretouch.types import AnyArray, Cloud, Float32, UInt8

# Codes of sensor_msgs/PointField.
DATATYPES: dict[int, str] = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_NAMES = {1: "INT8", 2: "UINT8", 3: "INT16", 4: "UINT16", 5: "INT32", 6: "UINT32", 7: "FLOAT32", 8: "FLOAT64"}
_UINT8, _FLOAT32, _FLOAT64 = 2, 7, 8
_UINT = {2: 4, 4: 6}  # by size [bytes]
_PACKED_COLOUR = (5, 6, 7)  # four bytes, regardless of the declared type


@dataclass(frozen=True)
class PointField:
    """One field of a point, as `sensor_msgs/PointField`."""

    name: str  # for example "x" or "rgb"
    offset: int  # offset from the start of the point [bytes]
    datatype: int  # key of `DATATYPES`
    count: int = 1  # number of elements


@dataclass(frozen=True, kw_only=True)
class PointCloud2Layout:
    """Layout of the bytes of a message; the fields are those of `sensor_msgs/PointCloud2`.

    Raises:
        CloudError: With the field and the rule it breaks.
    """

    height: int  # rows; 1 for an unorganised cloud
    width: int  # points per row
    fields: tuple[PointField, ...]  # fields of a point
    point_step: int  # size of a point [bytes]
    row_step: int  # size of a row [bytes]
    is_bigendian: bool = False  # byte order of the numbers
    is_dense: bool = False  # whether the sender declares all points finite; ignored

    def __post_init__(self) -> None:
        for name in ("height", "width", "point_step", "row_step"):
            if getattr(self, name) < 0:
                raise CloudError(f"{name}: {getattr(self, name)} is negative")
        if self.height and self.row_step < self.width * self.point_step:
            raise CloudError(
                f"row_step: {self.row_step} is less than width {self.width} x point_step {self.point_step}"
            )
        _check_fields(self.fields, self.point_step)

    @property
    def _shape(self) -> tuple[int, ...]:
        """(N,), or (H, W) if there are several rows; (0,) if there is no point."""
        if self.height * self.width == 0:
            return (0,)
        return (self.height, self.width) if self.height > 1 else (self.width,)

    def _field(self, name: str) -> PointField | None:
        return next((field for field in self.fields if field.name == name), None)

    def _view(self, data: UInt8, dtype: str, offset: int, last: tuple[int, int] | None = None) -> AnyArray:
        """One number of each point, or `last` = (count, stride in bytes) of them, without a copy."""
        shape = self._shape
        strides = (self.row_step, self.point_step)[2 - len(shape) :]
        if last is not None:
            shape, strides = (*shape, last[0]), (*strides, last[1])
        if 0 in shape:
            return np.empty(shape, dtype)
        return np.ndarray(shape, dtype, buffer=data, offset=offset, strides=strides)

    def _xyz(self, data: UInt8) -> Float32:
        fields = []
        for name in "xyz":
            field = self._field(name)
            if field is None:
                known = ", ".join(f.name for f in self.fields) or "none"
                raise CloudError(f"fields: {name} is missing; there are: {known}")
            if field.datatype not in (_FLOAT32, _FLOAT64):
                raise CloudError(f"{name}: datatype {_NAMES[field.datatype]} is neither FLOAT32 nor FLOAT64")
            if field.count != 1:
                raise CloudError(f"{name}: count {field.count} is not 1")
            fields.append(field)
        x, y, z = fields
        native = self.is_bigendian == (sys.byteorder == "big")
        spacing = y.offset - x.offset
        if native and spacing == z.offset - y.offset and all(f.datatype == _FLOAT32 for f in fields):
            return self._view(data, "f4", x.offset, (3, spacing))
        xyz = np.empty((*self._shape, 3), np.float32)
        # Beyond float32 becomes infinite, and a signalling NaN quiet: no point.
        with np.errstate(over="ignore", invalid="ignore"):
            for i, field in enumerate(fields):
                order = ">" if self.is_bigendian else "<"
                xyz[..., i] = self._view(data, order + DATATYPES[field.datatype], field.offset)
        return xyz

    def _rgb(self, data: UInt8) -> UInt8 | None:
        packed = self._field("rgb") or self._field("rgba")
        if packed is not None:
            if packed.datatype not in _PACKED_COLOUR or packed.count != 1:
                what = f"{packed.count} x {_NAMES[packed.datatype]}"
                raise CloudError(f"{packed.name}: {what} is not one FLOAT32, UINT32 or INT32")
            # In memory: blue, green, red, alpha, or the reverse where big-endian.
            first, step = (packed.offset + 1, 1) if self.is_bigendian else (packed.offset + 2, -1)
            return self._view(data, "u1", first, (3, step))
        channels = [self._field(name) for name in "rgb"]
        offsets = [one.offset for one in channels if one is not None and one.datatype == _UINT8 and one.count == 1]
        return np.stack([self._view(data, "u1", offset) for offset in offsets], axis=-1) if len(offsets) == 3 else None


def decode(
    layout: PointCloud2Layout, data: bytes | bytearray | memoryview | array.array[int] | UInt8
) -> tuple[Float32, UInt8 | None]:
    """Coordinates and colours of a message.

    Args:
        layout: Layout of the message.
        data: Its bytes: `bytes`, `array.array`, `memoryview` or uint8 array. The result may be a view of them, so
            they must stay unchanged as long as it is used.

    Returns:
        (N, 3), or (H, W, 3) if the height is above 1, float32 [m], and colours of the same shape, uint8, or None. Both
        are read-only, and views where possible. Points without depth keep their NaN or infinity. Colours come from
        `rgb` or `rgba` (blue in the lowest byte, as PCL packs them) or from `r`, `g`, `b` of UINT8; others are ignored.

    Raises:
        CloudError: If the sizes do not match, x, y or z is missing, or has a wrong datatype.
    """
    try:
        bytes_ = np.frombuffer(data, np.uint8)
    except (TypeError, ValueError, BufferError) as err:
        raise CloudError(f"data: {err}") from err
    expected = layout.row_step * layout.height
    if bytes_.size != expected:
        raise CloudError(
            f"data: {bytes_.size} bytes are not row_step {layout.row_step} x height {layout.height} = {expected}"
        )
    xyz = layout._xyz(bytes_)  # noqa: SLF001  of this module
    rgb = layout._rgb(bytes_)  # noqa: SLF001
    for result in (xyz, rgb):
        if result is not None:
            result.flags.writeable = False
    return xyz, rgb


def encode(cloud: Cloud, **columns: AnyArray) -> tuple[PointCloud2Layout, UInt8]:
    """Layout and bytes of a message for a cloud.

    Args:
        cloud: Organised or not; a point takes 12 bytes (x, y, z), with colour 16 (and `rgb`,
            packed into a FLOAT32 as PCL and RViz expect).
        columns: Further fields of its N points by name, (N,) uint16 or uint32.

    Returns:
        Layout, and the bytes: those of the cloud itself where its points have no colour and no other columns.
    """
    shape = cloud.xyz.shape[:-1]
    height, width = shape if cloud.organised else (1, *shape)
    fields = [PointField(name, 4 * i, _FLOAT32) for i, name in enumerate("xyz")]
    points: AnyArray = cloud.xyz.astype("<f4", order="C", copy=False)
    if cloud.rgb is not None:
        fields.append(PointField("rgb", 12, _FLOAT32))
        points = _with_colour(points, cloud.rgb)
    step = 12 if cloud.rgb is None else 16
    if columns:
        record = np.dtype(
            [("own", "<f4", (step // 4,)), *((name, f"<u{one.itemsize}") for name, one in columns.items())]
        )
        records = np.empty(cloud.size, record)
        records["own"] = points.reshape(-1, points.shape[-1])
        for name, one in columns.items():
            records[name] = one
            fields.append(PointField(name, step, _UINT[one.itemsize]))
            step += one.itemsize
        points = records
    data = points.reshape(-1).view(np.uint8)
    layout = PointCloud2Layout(
        height=height,
        width=width,
        fields=tuple(fields),
        point_step=step,
        row_step=step * width,
        is_dense=bool(np.isfinite(cloud.xyz).all()),
    )
    return layout, data


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


def _check_fields(fields: Sequence[PointField], point_step: int) -> None:
    """Check datatypes, unique names, and that fields lie within the point without overlap."""
    seen: set[str] = set()
    solid = []
    for field in fields:
        if field.name in seen:
            raise CloudError(f"fields: {field.name} occurs twice")
        seen.add(field.name)
        if field.datatype not in DATATYPES:
            raise CloudError(f"{field.name}: datatype {field.datatype} is not one of 1 to 8")
        if field.offset < 0 or field.count < 0:
            raise CloudError(f"{field.name}: offset {field.offset} or count {field.count} is negative")
        end = field.offset + field.count * int(DATATYPES[field.datatype][1])
        if end > point_step:
            raise CloudError(f"{field.name}: ends at byte {end}, beyond point_step {point_step}")
        if field.count:
            solid.append((field.offset, end, field.name))
    for (_, end, name), (offset, _, after) in pairwise(sorted(solid)):
        if offset < end:
            raise CloudError(f"{after}: offset {offset} lies within {name}, which ends at {end}")
