# SPDX-License-Identifier: Apache-2.0
"""Images: PNG and TIFF alone, whatever they are called, and no more memory than their file justifies."""

import io
import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth_builders import compressed
from every_case import every_case, every_refusal
from PIL import Image

from foretouch.cloud.io.depth_messages import decode_depth
from foretouch.cloud.io.images import decode_image, read_image
from foretouch.cloud.io.mask_files import read_mask
from foretouch.errors import CloudError, FileError


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(width: int, height: int, *, before: bytes = b"", after: bytes = b"", rows: int | None = None) -> bytes:
    """A PNG of 16-bit zeros, with chunks before its header and behind its data."""
    head = struct.pack(">2I5B", width, height, 16, 0, 0, 0, 0)
    data = zlib.compress(bytes((height if rows is None else rows) * (2 * width + 1)))
    return b"\x89PNG\r\n\x1a\n" + before + chunk(b"IHDR", head) + chunk(b"IDAT", data) + after + chunk(b"IEND", b"")


def saved(array: Any, kind: str, **options: Any) -> bytes:
    content = io.BytesIO()
    Image.fromarray(array).save(content, kind, **options)
    return content.getvalue()


def tiff(width: int, height: int, tile: int = 0) -> bytes:
    """A TIFF of 8 bits in grey by its specification, without compression, with 100 bytes of pixels."""
    entries = {256: width, 257: height, 258: 8, 259: 1, 262: 1, 277: 1}
    size, end = 2 + 12 * (len(entries) + (4 if tile else 3)) + 4, 8
    entries |= {322: tile, 323: tile, 324: end + size, 325: 100} if tile else {273: end + size, 278: height, 279: 100}
    fields = b"".join(struct.pack("<2H2I", tag, 4, 1, value) for tag, value in sorted(entries.items()))
    return struct.pack("<2sHI", b"II", 42, end) + struct.pack("<H", len(entries)) + fields + bytes(4) + bytes(100)


def test_the_content_decides_and_no_other_format_is_tried(tmp_path: Path) -> None:
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4)
    for kind, name in (("PNG", "a.png"), ("TIFF", "b.tif"), ("TIFF", "c.png"), ("PNG", "d.tiff")):
        (tmp_path / name).write_bytes(saved(depth, kind))
        np.testing.assert_array_equal(read_image(tmp_path / name, "depth"), depth)
    grey = np.zeros((3, 4), np.uint8)
    left = tmp_path / "left"
    eps = f"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n({left}) (w) file closefile\n".encode()

    def check(content: bytes) -> None:
        for name in ("depth.png", "depth.tif"):
            (tmp_path / name).write_bytes(content)
            for read in (lambda path: read_image(path, "depth"), read_mask):
                with pytest.raises(FileError, match=rf"{name}: \w+: cannot be read: is neither PNG nor TIFF"):
                    read(tmp_path / name)
        assert not left.exists()

    every_case({"EPS": eps, **{kind: saved(grey, kind) for kind in ("BMP", "GIF", "JPEG", "WEBP", "PPM")}}, check)


SMALL = png(64, 48)
FAKE = chunk(b"tEXt", struct.pack(">2I5B", 64, 48, 16, 0, 0, 0, 0) + b"\0")


def test_a_size_is_checked_by_what_the_decoder_reads_before_anything_is_unpacked(tmp_path: Path) -> None:
    cases = {
        "13000x13000": (png(13_000, 13_000, rows=1), "size: 13000x13000 is not between"),
        "a text that looks like a header": (
            png(20_000, 20_000, before=FAKE, rows=1),
            "begins with its header|20000x20000",
        ),
        "two headers": (SMALL[:33] + png(20_000, 20_000, rows=1)[8:], "20000x20000|damaged"),
        "an empty profile behind the data": (png(64, 48, after=chunk(b"iCCP", b"")), "PNG is truncated or damaged: "),
        "an empty text behind the data": (png(64, 48, after=chunk(b"zTXt", b"a\0\0")), "damaged"),
    }

    def check(content: bytes, rule: str) -> None:
        tracemalloc.start()
        with pytest.raises(CloudError, match=rule) as caught:
            decode_depth(compressed(content))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 30_000_000
        assert "\n" not in str(caught.value)

    every_case(list(cases.values())[:4], check)
    assert decode_depth(compressed(SMALL)).shape == (48, 64)
    (tmp_path / "bomb.tif").write_bytes(tiff(30_000, 20_000))
    with pytest.raises(FileError, match="size: 30000x20000 is not between one pixel and 16777216"):
        read_image(tmp_path / "bomb.tif", "depth")
    many = saved(np.zeros((16, 16), np.uint8), "TIFF", save_all=True, append_images=[Image.new("L", (16, 16))])
    every_refusal(
        CloudError,
        [
            ("several images", many),
            ("size: 20000x20000", tiff(16, 16, tile=20_000)),
            ("truncated or damaged", tiff(16, 16)[:40]),
            ("truncated", SMALL[:60]),
        ],
        decode_image,
    )
