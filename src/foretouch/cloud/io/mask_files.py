# SPDX-License-Identifier: Apache-2.0
"""Read images with a number a pixel, and the labels of a mask: from an image, an array of NumPy, or a `sensor_msgs/Image`."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.cloud.io.depth_messages import image_pixels
from foretouch.errors import CloudError, FileError, described, none_of
from foretouch.files import require_existing, system_errors
from foretouch.types import AnyArray

MASK_SUFFIXES: Final = (".png", ".npy", ".npz", ".tif", ".tiff", ".bmp")
_ENCODINGS: Final = {"mono8": "u1", "8UC1": "u1", "mono16": "u2", "16UC1": "u2"}
_NAMES: Final = ("mask", "label", "labels", "segmap")  # of the array in an .npz file
_LIMIT: Final = 500_000_000  # bytes of an image


def read_mask(path: str | Path) -> AnyArray:
    """Read a mask.

    Args:
        path: An image with one number a pixel (8 or 16 bit grey, palette or black and white), a `.npy` file, or an `.npz`
            file with an array `mask`, `label`, `labels` or `segmap`.

    Returns:
        (H, W) integers or bool; what they are is checked where they are used.

    Raises:
        FileError: If it cannot be read, has colours, or holds objects of Python.
    """
    path = require_existing(path)
    suffix = path.suffix.lower()
    if suffix not in MASK_SUFFIXES:
        raise FileError(path, f"suffix: {none_of(suffix, MASK_SUFFIXES)}")
    if suffix not in (".npy", ".npz"):
        pixels = read_image(path, "mask")
        if pixels.ndim != 2:
            raise FileError(path, "mask: an image with colours; write one label a pixel (8 or 16 bit grey)")
        return pixels
    try:
        with system_errors(path, "cannot be read"):
            loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return loaded
        with loaded:
            names = [name for name in _NAMES if name in loaded.files]
            if not names:
                raise FileError(path, f"holds {', '.join(loaded.files) or 'no array'}, none of {', '.join(_NAMES)}")
            array: AnyArray = loaded[names[0]]
            return array
    except (ValueError, EOFError, OSError) as err:
        raise FileError(path, f"mask: cannot be read: {' '.join(str(err).split())}") from err


def read_image(path: Path, field: str) -> AnyArray:
    """Read the pixels of an image as they are stored.

    Args:
        path: The image.
        field: What it is of, for the error message, such as `depth`.

    Returns:
        (H, W), or with colours (H, W, C).

    Raises:
        FileError: If it cannot be read, or holds several images.
    """
    from PIL import Image, UnidentifiedImageError

    if path.stat().st_size > _LIMIT:
        raise FileError(path, f"has more than {_LIMIT} bytes")
    try:
        with Image.open(path) as image:
            count = int(getattr(image, "n_frames", 1))
            if count > 1:
                raise FileError(path, f"holds {count} images, not one", field=field)
            return np.asarray(image)
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError) as err:
        raise FileError(path, f"{field}: cannot be read: {described(err)}") from err


def decode_mask(message: Any) -> AnyArray:
    """Read a mask from a `sensor_msgs/Image`, of rclpy or of rosbags.

    Args:
        message: Encoding mono8, 8UC1, mono16 or 16UC1.

    Returns:
        (H, W) uint8 or uint16 labels.

    Raises:
        CloudError: If the encoding is another one, or the sizes do not add up.
    """
    if message.encoding not in _ENCODINGS:
        raise CloudError(f"mask: encoding: {none_of(message.encoding, _ENCODINGS)}")
    try:
        pixels = image_pixels(message, _ENCODINGS[message.encoding])
    except CloudError as err:
        raise CloudError(f"mask: {err}") from err
    return pixels.astype(pixels.dtype.newbyteorder("="))
