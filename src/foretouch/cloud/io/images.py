# SPDX-License-Identifier: Apache-2.0
"""Decode PNG, TIFF and JPEG, each by its own decoder, after the size that the decoder has read was checked.

No other format is tried. Pillow's own `Image.open` tries all that it knows, and starts Ghostscript for EPS.
"""

import io
import warnings
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.base.files import read_bytes
from foretouch.errors import CloudError, FileError, described
from foretouch.types import AnyArray

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

IMAGE_SUFFIXES: Final = (".png", ".tif", ".tiff")

LARGEST_IMAGE: Final = 4096 * 4096
"""Largest number of pixels of an image."""

_BEGINNINGS: Final = {
    "PNG": (b"\x89PNG\r\n\x1a\n",),
    "TIFF": (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    "JPEG": (b"\xff\xd8\xff",),
}
_BITS: Final = 24  # offset in a PNG of the bits of a channel
_TILE: Final = (322, 323)  # tags of TIFF: columns and rows of a tile, which may be larger than the image
_LIMIT: Final = 300_000_000  # bytes of a file: an image of four 32-bit channels that is not compressed


def read_image(path: str | Path, field: str, formats: Collection[str] = ("PNG", "TIFF")) -> AnyArray:
    """Read the pixels of an image as they are stored.

    Args:
        path: The image; its content decides of which format it is.
        field: What it is of, for the error message, such as `depth`.
        formats: That are read: some of PNG, TIFF and JPEG.

    Returns:
        (H, W), or with colours (H, W, C).

    Raises:
        FileError: If it is no regular file, of another format, too large, damaged, or holds several images.
    """
    content = read_bytes(path, _LIMIT)
    try:
        with warnings.catch_warnings(action="ignore"):  # Pillow warns of what it refuses next
            return decode_image(content, formats)
    except CloudError as err:
        raise FileError(path, f"cannot be read: {err}", field=field) from err


def decode_image(content: bytes, formats: Collection[str] = ("PNG", "TIFF")) -> AnyArray:
    """Decode an image of one of some formats.

    Returns:
        (H, W), or with colours (H, W, C), as stored.

    Raises:
        CloudError: If it is of none of them, is damaged or truncated, has more pixels than `LARGEST_IMAGE`, has 16 bits
            a colour, or holds several images.
    """
    try:
        with _opened(content, formats) as image:
            _check_memory(image)
            if _has_another(image):
                raise CloudError("holds several images, not one")
            return np.asarray(image)
    except CloudError:
        raise
    except Exception as err:  # the decoders raise errors of many kinds on damaged bytes
        raise CloudError(f"is truncated or damaged: {described(err)}") from err


def check_size(height: int, width: int) -> None:
    """Refuse an image without a pixel, or with more than `LARGEST_IMAGE`, by a `CloudError`."""
    if not (height > 0 and width > 0 and height * width <= LARGEST_IMAGE):
        raise CloudError(f"size: {width}x{height} is not between one pixel and {LARGEST_IMAGE}")


def _opened(content: bytes, formats: Collection[str]) -> "ImageFile":
    """Return an image of which nothing but the header is decoded."""
    kind = next((kind for kind in formats if content.startswith(_BEGINNINGS[kind])), "")
    if kind == "PNG":
        from PIL.PngImagePlugin import PngImageFile

        png = PngImageFile(io.BytesIO(content))
        if content[_BITS] == 16 and png.mode.startswith(("RGB", "LA")):
            raise CloudError("has 16 bits a colour, of which the decoder would keep 8: write 8 bits a colour")
        return png
    if kind == "TIFF":
        from PIL.TiffImagePlugin import TiffImageFile

        return TiffImageFile(io.BytesIO(content))
    if kind == "JPEG":
        from PIL.JpegImagePlugin import JpegImageFile

        return JpegImageFile(io.BytesIO(content))
    raise CloudError(f"is neither {' nor '.join(formats)}")


def _check_memory(image: "ImageFile") -> None:
    check_size(image.height, image.width)
    tags: Any = getattr(image, "tag_v2", {})  # of TIFF
    columns, rows = (tags.get(tag, 1) for tag in _TILE)
    check_size(rows, columns)


def _has_another(image: "ImageFile") -> bool:
    """Return whether a second image follows; to count them all takes time that a file chooses."""
    try:
        image.seek(1)
    except EOFError:
        return False
    return True
