# SPDX-License-Identifier: Apache-2.0
"""How long does it take to decode and encode a PointCloud2 of 407 040 points? See README.md."""

from __future__ import annotations

import statistics
import struct
import time
from collections.abc import Callable

import numpy as np

from foretouch.cloud.io.pointcloud2 import PointCloud2Layout, PointField, decode, encode
from foretouch.types import Cloud

HEIGHT, WIDTH = 480, 848
FLOAT32, FLOAT64 = 7, 8


def layouts() -> dict[str, PointCloud2Layout]:
    """Common layouts."""
    f32 = [PointField(name, 4 * i, FLOAT32) for i, name in enumerate("xyz")]
    f64 = [PointField(name, 8 * i, FLOAT64) for i, name in enumerate("xyz")]
    rgb = PointField("rgb", 16, FLOAT32)
    return {
        "xyz, 12 bytes": _layout(f32, 12),
        "xyz and rgb, 32 bytes (PCL)": _layout([*f32, rgb], 32),
        "z, y, x, rows padded": _layout([PointField(f.name, 8 - f.offset, FLOAT32) for f in f32], 16, padding=64),
        "xyz, float64": _layout(f64, 24),
        "xyz and rgb, big-endian": _layout([*f32, rgb], 20, big=True),
    }


def _layout(fields: list[PointField], step: int, *, padding: int = 0, big: bool = False) -> PointCloud2Layout:
    return PointCloud2Layout(
        height=HEIGHT,
        width=WIDTH,
        fields=tuple(fields),
        point_step=step,
        row_step=step * WIDTH + padding,
        is_bigendian=big,
    )


def fill(layout: PointCloud2Layout, rng: np.random.Generator) -> bytes:
    """Bytes with coordinates of about a metre and random colours."""
    data = np.zeros((HEIGHT, layout.row_step), np.uint8)
    points = data[:, : WIDTH * layout.point_step].reshape(HEIGHT, WIDTH, layout.point_step)
    order = ">" if layout.is_bigendian else "<"
    for field in layout.fields:
        kind = {FLOAT32: "f4", FLOAT64: "f8"}[field.datatype]
        if field.name == "rgb":
            values = rng.integers(0, 1 << 24, (HEIGHT, WIDTH)).astype(order + "u4")
        else:
            values = rng.normal(size=(HEIGHT, WIDTH)).astype(order + kind)
        points[..., field.offset : field.end] = values[..., None].view(np.uint8)
    return data.tobytes()


def by_struct(layout: PointCloud2Layout, data: bytes, stride: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Every `stride`-th row and column, number by number."""
    order = ">" if layout.is_bigendian else "<"
    fields = {field.name: field for field in layout.fields}
    xyz, rgb = [], []
    for row in range(0, HEIGHT, stride):
        for column in range(0, WIDTH, stride):
            start = row * layout.row_step + column * layout.point_step
            for name in "xyz":
                code = "f" if fields[name].datatype == FLOAT32 else "d"
                xyz.append(struct.unpack_from(order + code, data, start + fields[name].offset)[0])
            if "rgb" in fields:
                (packed,) = struct.unpack_from(order + "I", data, start + fields["rgb"].offset)
                rgb.append((packed >> 16 & 255, packed >> 8 & 255, packed & 255))
    return np.array(xyz, np.float32).reshape(-1, 3), np.array(rgb, np.uint8) if rgb else None


def cpu_ms(function: Callable[[], object], repeats: int) -> float:
    """Median CPU time of a call [ms]."""
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        function()
        times.append((time.thread_time() - start) * 1e3)
    return statistics.median(times)


def main() -> None:
    """Print the tables."""
    rng = np.random.default_rng(0)
    stride = 4
    rows = []
    for name, layout in layouts().items():
        data = fill(layout, rng)
        found_xyz, found_rgb = decode(layout, data)
        xyz, rgb = by_struct(layout, data, stride)
        same = np.array_equal(found_xyz[::stride, ::stride].reshape(-1, 3), xyz)
        if rgb is not None and found_rgb is not None:
            same &= np.array_equal(found_rgb[::stride, ::stride].reshape(-1, 3), rgb)
        view = np.shares_memory(found_xyz, np.frombuffer(data, np.uint8))
        rows.append((name, same, view, cpu_ms(lambda layout=layout, data=data: decode(layout, data), 51)))
    print(f"{'decode, 848x480':<30}{'as by struct':>14}{'view':>7}{'CPU ms':>9}")
    for name, same, view, ms in rows:
        print(f"{name:<30}{'equal' if same else 'DIFFERENT':>14}{'yes' if view else 'no':>7}{ms:>9.4f}")
    xyz = rng.normal(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    rgb = rng.integers(0, 256, xyz.shape, dtype=np.uint8)
    print(f"\n{'encode, 848x480':<30}{'read back':>14}{'':>7}{'CPU ms':>9}")
    for name, cloud in (("xyz, 12 bytes", Cloud(xyz)), ("xyz and rgb, 16 bytes", Cloud(xyz, rgb))):
        found_xyz, found_rgb = decode(*encode(cloud))
        same = np.array_equal(found_xyz, xyz) and (cloud.rgb is None or np.array_equal(found_rgb, rgb))
        ms = cpu_ms(lambda cloud=cloud: encode(cloud), 21)
        print(f"{name:<30}{'equal' if same else 'DIFFERENT':>14}{'':>7}{ms:>9.4f}")


if __name__ == "__main__":
    main()
