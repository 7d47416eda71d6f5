# SPDX-License-Identifier: Apache-2.0
"""Read the labels of a mask: from an image, an array of NumPy, or a `sensor_msgs/Image`."""

from pathlib import Path
from typing import Any, Final

from foretouch.base.files import require_existing
from foretouch.cloud.io.arrays import array_names, read_array, read_arrays
from foretouch.cloud.io.depth_messages import image_pixels
from foretouch.cloud.io.images import IMAGE_SUFFIXES, read_image
from foretouch.errors import CloudError, FileError, none_of, shown
from foretouch.types import AnyArray

MASK_SUFFIXES: Final = (*IMAGE_SUFFIXES, ".npy", ".npz")
_ENCODINGS: Final = {"mono8": "u1", "8UC1": "u1", "mono16": "u2", "16UC1": "u2"}
_NAMES: Final = ("mask", "label", "labels", "segmap")  # of the array in an .npz file


def read_mask(path: str | Path) -> AnyArray:
    """Read a mask.

    Args:
        path: A PNG or TIFF with one number a pixel (8 or 16 bit grey, palette or black and white), a `.npy` file, or an
            `.npz` file with an array `mask`, `label`, `labels` or `segmap`.

    Returns:
        (H, W) integers or bool; what they are is checked where they are used.

    Raises:
        FileError: If it cannot be read, is damaged or too large, has colours, or holds objects of Python.
    """
    path = require_existing(path)
    suffix = path.suffix.lower()
    if suffix not in MASK_SUFFIXES:
        raise FileError(path, f"suffix: {none_of(suffix, MASK_SUFFIXES)}")
    if suffix in (".npy", ".npz"):
        try:
            return read_array(path) if suffix == ".npy" else _archived(path)
        except FileError as err:
            raise FileError(path, f"cannot be read: {err.rule}", field="mask") from err
    pixels = read_image(path, "mask")
    if pixels.ndim != 2:
        raise FileError(path, "mask: an image with colours; write one label a pixel (8 or 16 bit grey)")
    return pixels


def _archived(path: Path) -> AnyArray:
    """Return the mask in an archive."""
    there = array_names(path)
    name = next((name for name in _NAMES if name in there), None)
    if name is None:
        raise FileError(path, f"holds {shown(', '.join(there)) or 'no array'}, none of {', '.join(_NAMES)}")
    return read_arrays(path, [name], [])[name]


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
