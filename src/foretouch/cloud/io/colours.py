# SPDX-License-Identifier: Apache-2.0
"""Read the colours of a depth image's pixels: from a PNG, a JPEG, an array of NumPy, or an image message.

Messages are those of rclpy or rosbags, or any objects with their fields:

- `sensor_msgs/Image`: rgb8, bgr8, rgba8 and bgra8, with or without padded rows; alpha is left out.
- `sensor_msgs/CompressedImage` of image_transport's `compressed`: JPEG or PNG, by its content.
"""

import math
from collections import Counter
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.base.files import require_existing
from foretouch.cloud.io.arrays import read_array
from foretouch.cloud.io.depth_messages import image_pixels
from foretouch.cloud.io.images import decode_image, read_image
from foretouch.errors import CloudError, FileError, none_of, shown
from foretouch.types import AnyArray, UInt8

COLOUR_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".npy")
COLOUR_ENCODINGS: Final = {
    "rgb8": ("(3,)u1", slice(None)),
    "bgr8": ("(3,)u1", slice(None, None, -1)),
    "rgba8": ("(4,)u1", slice(3)),
    "bgra8": ("(4,)u1", slice(2, None, -1)),
}
"""Encodings of colour images, with the type of a pixel, and where red, green and blue are in it."""

TOLERANCE_S: Final = 0.02
"""Largest difference between the stamps of a depth image and its colours, by default: half a period at 25 Hz [s]."""

_FORMATS: Final = ("PNG", "JPEG")
_OPAQUE: Final = 255
_KEPT: Final = 16  # latest colour images: half a second at 30 Hz


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


def decode_colours(message: Any) -> UInt8:
    """Decode a `sensor_msgs/Image` or a `sensor_msgs/CompressedImage`.

    Returns:
        (H, W, 3) uint8, red, green, blue. Of an `Image` it is a view of the message, which must stay unchanged as long as it is
        used.

    Raises:
        CloudError: If it has no 8-bit colours, or is damaged. The message names the field and the rule.
    """
    if hasattr(message, "encoding"):
        if message.encoding not in COLOUR_ENCODINGS:
            raise CloudError(f"encoding: {none_of(message.encoding, COLOUR_ENCODINGS)}")
        pixel, order = COLOUR_ENCODINGS[message.encoding]
        return image_pixels(message, pixel)[..., order]
    if "compressedDepth" in message.format:
        raise CloudError(f"format: {shown(message.format)!r} is a depth image")
    try:
        return as_colours(decode_image(bytes(message.data), _FORMATS))
    except CloudError as err:
        raise CloudError(f"data: {err}") from err


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


class ColourImages:
    """The latest colour images, which of them belongs to a depth image by their stamps, and what became of them.

    It is the one of the same stamp; else the nearest one within the tolerance, once a later one has come.

    Args:
        tolerance_s: Largest difference of the stamps [s].

    Attributes:
        counts: Depth images by what became of their colours: `paired`, `unpaired` or `refused`.
        fault: Why a depth image was last without colours.
    """

    def __init__(self, tolerance_s: float = TOLERANCE_S) -> None:
        self.tolerance_s = tolerance_s
        self.counts: Counter[str] = Counter()
        self.fault = ""
        self._images: dict[int, Any] = {}  # by stamp [ns], which rises

    def add(self, stamp: int, image: Any) -> None:
        """Add a colour image with its stamp [ns]; those before are forgotten where it goes back, as at the start of a replay."""
        if any(other > stamp for other in self._images):
            self._images.clear()
        self._images[stamp] = image
        while len(self._images) > _KEPT:
            del self._images[next(iter(self._images))]

    def is_final(self, stamp: int) -> bool:
        """Return whether no later image can belong to a depth image with a stamp [ns]."""
        return any(other >= stamp for other in self._images)

    def match(self, stamp: int) -> Any:
        """Return the image that belongs to a depth image with a stamp [ns]; None, which is counted, if there is none."""
        nearest = min(self._images, key=lambda other: abs(other - stamp), default=None)
        away_s = math.inf if nearest is None else abs(nearest - stamp) * 1e-9
        if nearest is not None and away_s <= self.tolerance_s:
            return self._images[nearest]
        self.counts["unpaired"] += 1
        self.fault = f"no image is within {self.tolerance_s:g} s of the depth image: the nearest is {away_s:.3g} s away"
        return None

    def decode(self, message: Any, frame_id: str, shape: tuple[int, ...]) -> UInt8 | None:
        """Decode a colour image as the colours of a depth image; None, which is counted, if it is damaged, or not of its frame and size.

        Args:
            message: As `decode_colours`.
            frame_id: Of the depth image.
            shape: Its rows and columns.

        Returns:
            (H, W, 3) uint8, contiguous.
        """
        try:
            colours = colours_of(message, frame_id, shape)
        except CloudError as err:
            self.refuse(str(err))
            return None
        self.counts["paired"] += 1
        return colours

    def refuse(self, fault: str) -> None:
        """Count an image that cannot be used for a depth image."""
        self.counts["refused"] += 1
        self.fault = fault

    @property
    def remark(self) -> str:
        """How many depth images have no colours, and why the last has none; "" if all have."""
        without = self.counts["unpaired"] + self.counts["refused"]
        return f"{without} of {self.counts.total()} depth images have no colours: {self.fault}" if without else ""


def colours_of(message: Any, frame_id: str, shape: tuple[int, ...]) -> UInt8:
    """Decode a colour image as `ColourImages.decode`; a `CloudError` names what is wrong, with both frames or sizes."""
    own = message.header.frame_id
    if own and own != frame_id:
        cure = "align one with the other in the driver, such as by align_depth"
        raise CloudError(f"header.frame_id: {shown(own)!r} is not that of the depth image, {shown(frame_id)!r}: {cure}")
    colours = decode_colours(message)
    require_size(colours, tuple(shape), "the depth image")
    return np.ascontiguousarray(colours)
