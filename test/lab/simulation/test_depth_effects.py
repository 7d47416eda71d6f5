# SPDX-License-Identifier: Apache-2.0
"""Noise by its statistics, shadows and flying pixels by hand-made images."""

import numpy as np
import pytest

from foretouch_lab.simulation.depth_scene import add_flying_pixels, add_stereo_noise, stereo_shadow


def _step(near: float = 0.5, far: float = 1.0) -> np.ndarray:
    """40 columns far, 40 near, 40 far."""
    depth = np.full((30, 120), far)
    depth[:, 40:80] = near
    return depth


def test_noise_grows_with_the_square_of_the_depth_and_is_correlated_over_the_window(rng) -> None:
    for distance in (0.5, 1.0, 2.0):
        noise = add_stereo_noise(np.full((300, 400), distance), 0.002, rng) - distance
        assert noise.std() == pytest.approx(0.002 * distance**2, rel=0.05)
        assert abs(noise.mean()) < 0.1 * noise.std()
    partial = np.where(np.arange(30)[:, None] < 10, np.inf, _step())
    assert np.array_equal(np.isinf(add_stereo_noise(partial, 0.001, rng)), np.isinf(partial))
    noise = add_stereo_noise(np.ones((400, 400)), 0.001, rng) - 1.0
    for lag, expected in ((1, 8 / 9), (4, 5 / 9), (9, 0.0)):  # of a mean over 9 columns
        measured = np.corrcoef(noise[:, :-lag].ravel(), noise[:, lag:].ravel())[0, 1]
        assert measured == pytest.approx(expected, abs=0.05)


def test_flying_pixels_lie_between_both_sides_and_only_at_edges(rng: np.random.Generator) -> None:
    depth = _step()
    flying = add_flying_pixels(depth, rng)
    changed = flying != depth
    assert set(np.flatnonzero(changed.any(axis=0))) == {39, 40, 79, 80}
    assert (flying >= 0.5).all()
    assert (flying <= 1.0).all()
    assert flying[:, 39].std() > 0.1  # each pixel its own mixture
    slope = np.tile(np.linspace(0.5, 1.0, 120), (30, 1))
    assert np.array_equal(add_flying_pixels(slope, rng), slope)


def test_the_shadow_lies_left_of_the_near_thing_and_is_as_wide_as_the_disparities_differ() -> None:
    # f·B = 10 px·m: disparity 10 at 1 m, 20 at 0.5 m, so 10 columns left of column 40 are hidden.
    hidden = stereo_shadow(_step(), focal_px=200.0, baseline_m=0.05)
    assert set(np.flatnonzero(hidden.all(axis=0))) == set(range(31, 40))
    assert not np.delete(hidden, range(30, 40), axis=1).any()
    for flat in (np.full((4, 50), 0.8), np.full((4, 50), np.inf)):
        assert not stereo_shadow(flat, focal_px=600.0).any()
