# SPDX-License-Identifier: Apache-2.0
"""PointCloud2 bytes: against a reader by `struct`, and by hand."""

import struct
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
from every_case import every_case, every_refusal
from hypothesis import given, settings
from hypothesis import strategies as st

from foretouch.cloud.io.pointcloud2 import DATATYPES, decode, encode
from foretouch.errors import CloudError
from foretouch.types import Cloud

_CODES = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 8: "d"}
_SIZE = {code: int(name[1]) for code, name in DATATYPES.items()}


def field(name: str, offset: int, datatype: int, count: int = 1) -> SimpleNamespace:
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)


XYZ = tuple(field(name, 4 * i, 7) for i, name in enumerate("xyz"))


def read_numbers(layout: SimpleNamespace, data: bytes, names: list[str], code: str = "") -> np.ndarray:
    """A slow second opinion, one number at a time: (height, width, len(names)) float64."""
    fields = [next(field for field in layout.fields if field.name == name) for name in names]
    result = np.empty((layout.height, layout.width, len(names)))
    for row, column, i in np.ndindex(result.shape):
        kind = (">" if layout.is_bigendian else "<") + (code or _CODES[fields[i].datatype])
        start = row * layout.row_step + column * layout.point_step + fields[i].offset
        (result[row, column, i],) = struct.unpack_from(kind, data, start)
    return result


def _layout(**changes) -> SimpleNamespace:
    values = {
        "height": 1,
        "width": 2,
        "fields": XYZ,
        "point_step": 12,
        "row_step": 24,
        "is_bigendian": False,
        **changes,
    }
    return SimpleNamespace(**values)


def with_data(layout: SimpleNamespace, data: Any) -> SimpleNamespace:
    return SimpleNamespace(**vars(layout), data=data)


@st.composite
def layouts(draw: st.DrawFn) -> SimpleNamespace:
    kinds = [(name, draw(st.sampled_from([7, 7, 8])), 1) for name in "xyz"]
    if draw(st.booleans()):
        kinds = [(name, 7, 1) for name in "xyz"]
    colour = draw(st.sampled_from(["none", "rgb", "rgba", "channels"]))
    if colour == "channels":
        kinds += [(name, 2, 1) for name in "rgb"]
    elif colour != "none":
        kinds.append((colour, draw(st.sampled_from([5, 6, 7])), 1))
    for i in range(draw(st.integers(0, 3))):
        kinds.append((f"extra{i}", draw(st.sampled_from(list(DATATYPES))), draw(st.integers(0, 3))))
    kinds = draw(st.permutations(kinds))
    fields, offset = [], 0
    for name, datatype, count in kinds:
        offset += draw(st.sampled_from([0, 0, 0, 1, 4]))
        fields.append(field(name, offset, datatype, count))
        offset += _SIZE[datatype] * count
    fields = draw(st.permutations(fields))
    height, width = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    step = offset + draw(st.integers(0, 5))
    row_step = step * width + draw(st.integers(0, 9))
    sizes = {"height": height, "width": width, "point_step": step, "row_step": row_step}
    return SimpleNamespace(fields=tuple(fields), is_bigendian=draw(st.booleans()), **sizes)


@settings(max_examples=300, deadline=None)
@given(layout=layouts(), seed=st.integers(0, 2**32 - 1))
def test_any_layout_reads_as_by_struct(layout: SimpleNamespace, seed: int) -> None:
    data = np.random.default_rng(seed).integers(0, 256, layout.height * layout.row_step, dtype=np.uint8).tobytes()
    xyz, rgb = decode(with_data(layout, data))
    with np.errstate(over="ignore", invalid="ignore"):
        expected = read_numbers(layout, data, ["x", "y", "z"]).astype(np.float32)
    np.testing.assert_array_equal(xyz, expected.reshape(xyz.shape))
    names = {field.name for field in layout.fields}
    packed = next((name for name in ("rgb", "rgba") if name in names), None)
    if packed is not None:
        number = read_numbers(layout, data, [packed], "I").astype(np.uint32)  # 0x00RRGGBB
        colours = np.concatenate([number >> 16, number >> 8, number], axis=-1) & 255
    elif "r" in names:
        colours = read_numbers(layout, data, ["r", "g", "b"]).astype(np.uint8)
    else:
        assert rgb is None
        return
    assert rgb is not None
    np.testing.assert_array_equal(rgb, colours.reshape(rgb.shape))
    Cloud(xyz, rgb)  # accepted as it is, views included


def test_encode_and_decode_are_inverse(rng: np.random.Generator) -> None:
    def check(shape: tuple[int, ...], with_rgb: bool) -> None:
        xyz = rng.normal(size=(*shape, 3)).astype(np.float32)
        xyz.reshape(-1, 3)[::3] = np.nan
        rgb = rng.integers(0, 256, xyz.shape, dtype=np.uint8) if with_rgb else None
        layout = encode(Cloud(xyz, rgb))
        data = layout.data
        assert (layout.point_step, layout.is_dense) == (16 if with_rgb else 12, xyz.size == 0)
        assert data.dtype == np.uint8
        assert np.shares_memory(data, xyz) == (xyz.size > 0 and not with_rgb)  # not copied
        found_xyz, found_rgb = decode(layout)
        np.testing.assert_array_equal(found_xyz, xyz)
        np.testing.assert_array_equal(found_rgb, rgb)

    every_case(product([(0,), (1,), (7,), (3, 4)], [False, True]), check)
    xyz = rng.normal(size=(6, 8, 3)).astype(np.float32)
    layout = encode(Cloud(xyz[::2, ::-3]))
    assert layout.is_dense
    np.testing.assert_array_equal(decode(layout)[0], xyz[::2, ::-3])
    xyz[4, 4, 1] = np.inf
    assert not encode(Cloud(xyz)).is_dense


def test_layouts_that_do_not_add_up_are_named() -> None:
    def colour(datatype: int) -> tuple[SimpleNamespace, ...]:
        return (*XYZ, field("rgb", 12, datatype))

    cases = [
        ("fields: z is missing; there are: x, y", {"fields": XYZ[:2]}),
        ("fields: x is missing; there are: none", {"fields": ()}),
        ("z: is not one FLOAT32 or FLOAT64", {"fields": (*XYZ[:2], field("z", 8, 6))}),
        ("x: is not one FLOAT32 or FLOAT64", {"fields": (field("x", 0, 7, 0), *XYZ[1:])}),
        ("rgb: ends at byte 16, beyond", {"fields": colour(7), "point_step": 15, "row_step": 30}),
        ("z: ends at byte 16, beyond point_step 12", {"fields": (*XYZ[:2], field("z", 8, 8))}),
        ("z: offset 6 lies within y, which ends at 8", {"fields": (*XYZ[:2], field("z", 6, 7))}),
        ("a: datatype 9 is not one of 1 to 8", {"fields": (*XYZ, field("a", 0, 9))}),
        ("a: offset -1", {"fields": (*XYZ, field("a", -1, 2))}),
        ("fields: x occurs twice", {"fields": (*XYZ, field("x", 8, 7))}),
        ("row_step: 23 is less than width 2 x point_step 12", {"row_step": 23}),
        ("width: -1 is negative", {"width": -1}),
        ("data: 24 bytes are not row_step 24 x height 2 = 48", {"height": 2}),
        ("data: 24 bytes are not row_step 12 x height 1 = 12", {"width": 1, "row_step": 12}),
        ("rgb: is not one FLOAT32", {"fields": colour(2), "point_step": 13, "row_step": 26}, 26),
    ]
    every_refusal(CloudError, cases, lambda changes, size=24: decode(_layout(**changes, data=bytes(size))))
