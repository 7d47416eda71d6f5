# SPDX-License-Identifier: Apache-2.0
"""What a stereo camera adds to exact depth: noise, flying pixels, the shadow beside an object."""

import numpy as np

from foretouch.types import Bool, Float64

D415_BASELINE_M = 0.055  # distance of the imagers
FLYING_SHARE = 0.5  # of the pixels of a depth edge that lie between both sides
HOLE_SHARE = 0.01  # of the pixels that lie in random spots without depth
GRAZING_DEG = 80.0  # angle between ray and surface normal beyond which there is no depth
_MATCHING_WINDOW_PX = 9  # side of the block that stereo matching compares
_EDGE_M = 0.02  # a 3x3 window that spans more than this holds a depth edge


def add_stereo_noise(depth: Float64, noise_m: float, rng: np.random.Generator) -> Float64:
    """Noise that grows with the square of the depth and is correlated over the matching window.

    A constant sub-pixel error s of the disparity gives sigma_z = s·z² / (f·B).

    Args:
        depth: (H, W) float64 [m], inf where there is none.
        noise_m: Standard deviation at a depth of 1 m [m].
        rng: Of the noise.

    Returns:
        (H, W) float64 [m].
    """
    from scipy.ndimage import uniform_filter

    # The mean of k x k independent values has 1/k of their deviation; wrapping keeps it so at the border.
    noise = _MATCHING_WINDOW_PX * uniform_filter(rng.standard_normal(depth.shape), _MATCHING_WINDOW_PX, mode="wrap")
    finite = np.isfinite(depth)
    return np.where(finite, depth + noise_m * np.where(finite, depth, 0.0) ** 2 * noise, np.inf)


def add_flying_pixels(depth: Float64, rng: np.random.Generator) -> Float64:
    """Pixels on a depth edge take a depth between the nearest and the farthest of their 3x3 window.

    Args:
        depth: (H, W) float64 [m], inf where there is none.
        rng: Of the mixing weights.

    Returns:
        (H, W) float64 [m].
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    finite = np.isfinite(depth)
    near = minimum_filter(depth, 3, mode="nearest")
    far = maximum_filter(np.where(finite, depth, -np.inf), 3, mode="nearest")
    edge = finite & (far - near > _EDGE_M)
    weight = rng.random(depth.shape)
    result = depth.copy()
    result[edge] = (weight * far)[edge] + ((1.0 - weight) * near)[edge]
    return result


def stereo_shadow(depth: Float64, focal_px: float, baseline_m: float = D415_BASELINE_M) -> Bool:
    """Pixels that the second imager, to the right of the first, cannot see.

    A pixel at column u of the depth (H, W) [m] is seen there at u - f·B/z. It is hidden if a pixel to its right, hence
    of something nearer, is seen at the same place or farther left.
    """
    seen_at = np.arange(depth.shape[1]) - focal_px * baseline_m / depth
    leftmost = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth.shape, np.bool_)
    hidden[:, :-1] = leftmost[:, 1:] < seen_at[:, :-1]
    return hidden
