# SPDX-License-Identifier: Apache-2.0
"""The outline of objects in the image: flying pixels off, feet on.

Flying pixels lie in the air between an object and what is behind it, since the camera mixed both. They are
recognised by having few neighbours at their own depth. Those next to solid pixels of the object are its
outline: they keep its label, but their depth is of neither surface, hence they are not solid.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.cloud.image_window import ImageWindow
from foretouch.types import Float32

__all__ = ["trim_outline"]

Bool = npt.NDArray[np.bool_]
Int32 = npt.NDArray[np.int32]
Index = npt.NDArray[np.intp]

_FOOT = 1 / 3  # of the cut: from this height a pixel beside an object may be its foot
_SUPPORT = 4  # of eight neighbours at a pixel's own depth: a straight edge has 5, a flying pixel about 2
_STRAIGHT = 3  # of four directions in which a steep face goes on as it came


def trim_outline(labels: Int32, window: ImageWindow) -> Bool:
    """Take flying pixels from the labels and give them their feet, in place; tell which pixels are solid."""
    z = _bordered(window.z, np.nan)
    flying = _flying(labels, window, z)
    solid = labels > 0
    solid.reshape(-1)[flying] = False
    trusted = _bordered(labels * solid, 0)
    own = labels.take(flying)
    outline = np.zeros(len(flying), np.bool_)
    for neighbour in _neighbours(trusted, flying):
        outline |= neighbour == own
    labels.reshape(-1)[flying[~outline]] = 0
    feet, claimed = _feet(solid, window, z, trusted)
    labels.reshape(-1)[feet] = claimed
    solid.reshape(-1)[feet] = True
    return solid


def _flying(labels: Int32, window: ImageWindow, z: Float32) -> Index:
    """Labelled pixels, as flat indices, that lie in the air between two surfaces; `z` has a border of NaN."""
    # A cheap superset first: pixels beside any step that could be too much at the least depth.
    limit = window.near(np.fmin.reduce(window.z, axis=None, keepdims=True)).item()
    suspect = np.zeros(labels.shape, np.bool_)
    for image, mask in ((window.z, suspect), (window.z.T, suspect.T)):
        step = image[1:] - image[:-1]
        jump = np.abs(step, out=step) > limit
        mask[:-1] |= jump
        mask[1:] |= jump
    suspect &= labels > 0
    pixels = np.flatnonzero(suspect)
    own = window.z.take(pixels)
    near = window.near(own)
    steps = np.stack(list(_neighbours(z, pixels)))
    steps -= own
    support = np.count_nonzero(np.abs(steps) <= near, axis=0)
    # A steep face goes on as it came: opposite neighbours differ by the same step.
    straight = np.count_nonzero(np.abs(steps[:4] + steps[:3:-1]) <= near, axis=0)
    flying: Index = pixels[(support < _SUPPORT) & (straight < _STRAIGHT)]
    return flying


def _feet(solid: Bool, window: ImageWindow, z: Float32, trusted: Int32) -> tuple[Index, Int32]:
    """Low pixels that touch an object and lie at its depth: its foot is below the cut.

    Returns:
        Flat indices and the labels that claim them; `z` and `trusted` have a border of one pixel.
    """
    beside = solid.copy()
    beside[1:] |= solid[:-1]
    beside[:-1] |= solid[1:]
    wide = beside.copy()
    wide[:, 1:] |= beside[:, :-1]
    wide[:, :-1] |= beside[:, 1:]
    wide &= ~window.above
    pixels = np.flatnonzero(wide)
    own, height = window.z.take(pixels), window.height.take(pixels)
    cut = window.cut.at(own)
    low = (height > cut * np.float32(_FOOT)) & (height <= cut)
    pixels, own = pixels[low], own[low]
    near = window.near(own)
    claimed = np.zeros(len(pixels), np.int32)
    for owner, depth in zip(_neighbours(trusted, pixels), _neighbours(z, pixels), strict=True):
        claimed = np.where((owner > 0) & (np.abs(depth - own) <= near), owner, claimed)
    good = claimed > 0
    return pixels[good], claimed[good]


def _bordered(image: npt.NDArray[Any], value: float) -> npt.NDArray[Any]:
    """The image with a border of one pixel; np.pad takes ten times as long."""
    padded = np.full((image.shape[0] + 2, image.shape[1] + 2), value, image.dtype)
    padded[1:-1, 1:-1] = image
    return padded


def _neighbours(padded: npt.NDArray[Any], pixels: Index) -> Iterator[npt.NDArray[Any]]:
    """The eight neighbours of some pixels (n,), row by row; (n,) at a time.

    Args:
        padded: (h + 2, w + 2), the image with a border.
        pixels: Flat indices into the image without the border.
    """
    width = padded.shape[1]
    centre = pixels + 2 * (pixels // (width - 2)) + width + 1
    for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
        yield padded.take(centre + step)
