# SPDX-License-Identifier: Apache-2.0
"""Colours beside a depth image reach its cloud as they are in the file; what is none is refused with file, field and both sizes."""

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from numpy.testing import assert_array_equal
from PIL import Image

import foretouch as ft
from foretouch.cloud.io.depth_files import DepthCamera
from foretouch.dataset.source import open_source
from foretouch.errors import FileError, ForetouchError
from foretouch.types import UInt8

K = (60.0, 61.0, 31.5, 23.5)
CAMERA = DepthCamera(intrinsics=K)


@pytest.fixture
def depth(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A depth image of 48 rows and 64 columns."""
    Image.fromarray(rng.integers(500, 1500, (48, 64)).astype(np.uint16)).save(tmp_path / "a-depth.png")
    return tmp_path / "a-depth.png"


@pytest.fixture
def photograph() -> UInt8:
    """(48, 64, 3): smooth, so that JPEG keeps it nearly."""
    rows, columns = np.mgrid[:48, :64]
    return np.stack([rows * 5, columns * 4, (rows + columns) * 2], axis=-1).astype(np.uint8)


def saved(array: Any, kind: str) -> bytes:
    content = io.BytesIO()
    Image.fromarray(array).save(content, kind)
    return content.getvalue()


def test_colours_of_a_file_are_those_of_the_pixels(tmp_path: Path, depth: Path, photograph: UInt8) -> None:
    alone = ft.read_cloud(depth, CAMERA)
    np.save(tmp_path / "c.npy", photograph)
    (tmp_path / "c.png").write_bytes(saved(photograph, "PNG"))
    (tmp_path / "c.jpg").write_bytes(saved(photograph, "JPEG"))
    opaque = np.dstack([photograph, np.full((48, 64), 255, np.uint8)])
    (tmp_path / "rgba.png").write_bytes(saved(opaque, "PNG"))

    def check(name: str, differs_by: int) -> None:
        cloud = ft.read_cloud(depth, CAMERA, color=tmp_path / name)
        assert_array_equal(cloud.xyz, alone.xyz)
        assert cloud.rgb is not None
        assert cloud.rgb.dtype == np.uint8
        assert np.abs(cloud.rgb.astype(int) - photograph).max() <= differs_by

    assert alone.rgb is None
    every_case([("c.npy", 0), ("c.png", 0), ("rgba.png", 0), ("c.jpg", 12)], check)


def test_an_archive_and_a_folder_bring_their_colours(tmp_path: Path, depth: Path, photograph: UInt8) -> None:
    mm = np.asarray(Image.open(depth))
    for name in ("color", "rgb"):  # contact_graspnet calls them rgb
        np.savez(
            tmp_path / "scene.npz", depth=mm, K=[[60.0, 0, 31.5], [0, 61.0, 23.5], [0, 0, 1]], **{name: photograph}
        )
        assert_array_equal(ft.read_cloud(tmp_path / "scene.npz").rgb, photograph)
    folder = tmp_path / "folder"
    folder.mkdir()
    for name, beside in (("a-depth.png", "a-color.png"), ("depth_2.png", "rgb_2.jpg"), ("c-depth.png", "c-other.jpg")):
        (folder / name).write_bytes(depth.read_bytes())
        (folder / beside).write_bytes(saved(photograph, "PNG" if beside.endswith("png") else "JPEG"))
    source = open_source(folder, camera=CAMERA)
    found = {Path(item.name).name: item.cloud.rgb for item in source}
    assert found.keys() == {"a-depth.png", "depth_2.png", "c-depth.png"}
    assert_array_equal(found["a-depth.png"], photograph)
    assert found["depth_2.png"] is not None
    assert found["c-depth.png"] is None
    assert source.notes == (f"{folder}: left out: c-other.jpg; a depth image in a folder is NAME-depth or depth-NAME",)
    with pytest.raises(
        FileError, match=r"folder: is a folder, whose colours are NAME-color\.png .*: leave out --color"
    ):
        open_source(folder, camera=DepthCamera(intrinsics=K, color="x.png"))


def png_of_16_bits(width: int, height: int) -> bytes:
    """A PNG of 16 bits a colour by its specification, which Pillow reads as 8."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">2I5B", width, height, 16, 2, 0, 0, 0)
    rows = zlib.compress(bytes(height * (6 * width + 1)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def test_what_are_no_colours_of_the_image_is_refused_in_one_line(
    tmp_path: Path, depth: Path, photograph: UInt8
) -> None:
    def check(name: str, content: bytes, rule: str) -> None:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match=rf"{name}: color: {rule}") as caught:
            ft.read_cloud(depth, CAMERA, color=tmp_path / name)
        assert "\n" not in str(caught.value)

    jpeg = saved(photograph, "JPEG")
    transparent = np.dstack([photograph, np.full((48, 64), 254, np.uint8)])
    every_case(
        {
            "another size": ("c.png", saved(photograph[:40], "PNG"), r"64x40 pixels are not those of the depth image .*a-depth\.png, 64x48: align it"),
            "16 bits": ("c.png", png_of_16_bits(64, 48), "cannot be read: has 16 bits a colour"),
            "grey": ("c.png", saved(photograph[..., 0], "PNG"), r"shape \(48, 64\) is not \(H, W, 3\): grey or a palette"),
            "grey JPEG": ("c.jpg", saved(photograph[..., 0], "JPEG"), r"shape \(48, 64\) is not"),
            "palette": ("c.png", saved(photograph[..., 0] > 0, "PNG"), r"shape \(48, 64\) is not"),
            "a depth image": ("c.png", depth.read_bytes(), "is of one uint16 a pixel, as a depth image is"),
            "truncated": ("c.jpg", jpeg[: len(jpeg) // 2], "cannot be read: is truncated or damaged"),
            "truncated in its header": ("c.jpg", jpeg[:20], "cannot be read: is truncated or damaged"),
            "transparent": ("c.png", saved(transparent, "PNG"), "has a fourth channel .* that is not 255 everywhere"),
            "CMYK": ("c.jpg", cmyk(), "has a fourth channel"),
            "GIF": ("c.png", saved(photograph[..., 0], "GIF"), "cannot be read: is neither PNG nor JPEG"),
            "a suffix": ("c.gif", jpeg, r"suffix: '\.gif' is not one of \.png, \.jpg, \.jpeg, \.npy"),
            "floats": ("c.npy", npy(photograph / 255.0), "float64 is not uint8: write 8 bits a colour"),
        },
        check,
    )  # fmt: skip
    with pytest.raises(FileError, match=r"absent\.png: does not exist"):
        ft.read_cloud(depth, CAMERA, color=tmp_path / "absent.png")
    np.savez(tmp_path / "scene.npz", depth=np.ones((48, 64)), K=[60, 60, 32, 24], color=photograph[:40])
    with pytest.raises(FileError, match=r"scene\.npz: color: 64x40 pixels are not those of `depth`, 64x48"):
        ft.read_cloud(tmp_path / "scene.npz")


def npy(array: Any) -> bytes:
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


def cmyk() -> bytes:
    content = io.BytesIO()
    Image.new("CMYK", (64, 48), (9, 9, 9, 9)).save(content, "JPEG")
    return content.getvalue()


def test_colours_without_a_depth_image_are_refused(tmp_path: Path, depth: Path, photograph: UInt8) -> None:
    (tmp_path / "c.png").write_bytes(saved(photograph, "PNG"))
    with pytest.raises(FileError, match=r"c\.png: depth: shape \(48, 64, 3\) of a colour image is not \(H, W\)"):
        ft.read_cloud(tmp_path / "c.png", CAMERA)
    ft.write_cloud(tmp_path / "points.npz", ft.Cloud(np.zeros((5, 3))))
    with pytest.raises(FileError, match=r"points\.npz: holds points: leave out --color, which is for depth images"):
        ft.read_cloud(tmp_path / "points.npz", color=tmp_path / "c.png")
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "a-color.png").write_bytes(saved(photograph, "PNG"))
    with pytest.raises(ForetouchError, match="holds no clouds"):
        open_source(alone)
