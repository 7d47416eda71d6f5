# SPDX-License-Identifier: Apache-2.0
"""Read the labels of a mask: from a label image, an array of NumPy, or a `sensor_msgs/Image`."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import CloudError, FileError, none_of
from foretouch.files import require_existing, system_errors
from foretouch.types import AnyArray

MASK_SUFFIXES: Final = (".png", ".npy", ".npz", ".tif", ".tiff", ".bmp")
_ENCODINGS: Final = {"mono8": np.uint8, "8UC1": np.uint8, "mono16": np.uint16, "16UC1": np.uint16}
_NAMES: Final = ("mask", "label", "labels", "segmap")  # of the array in an .npz file
_MODES: Final = ("1", "L", "P", "I", "I;16", "I;16B", "I;16L", "I;16N")  # of Pillow: one number a pixel


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
        return _image(path)
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
    dtype = np.dtype(_ENCODINGS[message.encoding]).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(memoryview(message.data), np.uint8)
    if step < width * dtype.itemsize or data.size != height * step:
        raise CloudError(
            f"mask: {data.size} bytes with step {step} are not {height} rows of {width} pixels of {dtype.itemsize} bytes"
        )
    rows = np.ascontiguousarray(data.reshape(height, step)[:, : width * dtype.itemsize]).view(dtype)
    return rows.astype(dtype.newbyteorder("="))


def _image(path: Path) -> AnyArray:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            if image.mode not in _MODES:
                raise FileError(
                    path, f"mask: an image of mode {image.mode} has colours; write one label a pixel (8 or 16 bit grey)"
                )
            return np.asarray(image)
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as err:
        raise FileError(path, f"mask: cannot be read: {' '.join(str(err).split())}") from err
