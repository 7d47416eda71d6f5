# SPDX-License-Identifier: Apache-2.0
"""Read the colours of a depth image's pixels: from a PNG, a JPEG, or an array of NumPy."""

from pathlib import Path
from typing import Final

import numpy as np

from foretouch.cloud.io.arrays import read_array
from foretouch.cloud.io.images import decode_image, read_image
from foretouch.errors import CloudError, FileError, none_of
from foretouch.files import require_existing
from foretouch.types import AnyArray, UInt8

COLOUR_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".npy")
_FORMATS: Final = ("PNG", "JPEG")
_OPAQUE: Final = 255


def read_colours(path: str | Path, shape: tuple[int, int], depth: str | Path) -> UInt8:
    """Read the colours of the pixels of a depth image.

    Args:
        path: A PNG or JPEG with 8 bits a colour, by its content, or a `.npy` file with (H, W, 3) uint8.
        shape: Rows and columns of the depth image.
        depth: The file of the depth image, for the error message.

    Returns:
        (H, W, 3) uint8, red, green, blue.

    Raises:
        FileError: If it cannot be read, is damaged, grey, of 16 bits, partly transparent, or of another size.
    """
    path = require_existing(path)
    suffix = path.suffix.lower()
    if suffix not in COLOUR_SUFFIXES:
        raise FileError(path, f"suffix: {none_of(suffix, COLOUR_SUFFIXES)}", field="color")
    try:
        colours = as_colours(read_array(path) if suffix == ".npy" else read_image(path, "color", _FORMATS))
        require_size(colours, shape, f"the depth image {depth}")
    except CloudError as err:
        raise FileError(path, str(err), field="color") from err
    return colours


def decode_colours(content: bytes) -> UInt8:
    """Decode the colours (H, W, 3) uint8 in a PNG or a JPEG; a `CloudError` if it is damaged or not of 8-bit colours."""
    return as_colours(decode_image(content, _FORMATS))


def as_colours(pixels: AnyArray) -> UInt8:
    """Return an image as colours (H, W, 3) uint8, without an alpha channel that is opaque; a `CloudError` if it has none."""
    if pixels.ndim == 2 and pixels.dtype.itemsize > 1:
        raise CloudError(f"is of one {pixels.dtype} a pixel, as a depth image is: give the colours that belong to it")
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise CloudError(f"shape {pixels.shape} is not (H, W, 3): grey or a palette; write it as RGB")
    if pixels.dtype != np.uint8:
        raise CloudError(f"{pixels.dtype} is not uint8: write 8 bits a colour")
    if pixels.shape[2] == 4 and (pixels[..., 3] != _OPAQUE).any():
        raise CloudError("has a fourth channel (transparency, or CMYK) that is not 255 everywhere: write it as RGB")
    return pixels[..., :3]


def require_size(colours: UInt8, shape: tuple[int, ...], of: str) -> None:
    """Refuse colours of another size than the depth image that they are of, by a `CloudError` with both sizes."""
    if colours.shape[:2] != shape:
        (height, width), (rows, columns) = colours.shape[:2], shape
        cure = "align it with the depth, as `rs.align` and `align_depth` do, so that each pixel of one is that of the other"
        raise CloudError(f"{width}x{height} pixels are not those of {of}, {columns}x{rows}: {cure}")
