# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import ContactError
from foretouch.tactile import BIOTAC_SP
from foretouch_lab.simulation.contact.pad import PadConfig, contact_frame, gap_field, pad_direction, pad_window

PAD = PadConfig()


def test_core_passes_through_the_electrodes():
    axes = PAD.skin_axes - PAD.layer_m
    positions = BIOTAC_SP.layout.positions
    inside = (1 - np.linalg.norm(positions / axes, axis=1)) * np.linalg.norm(positions, axis=1)
    assert np.abs(inside[:20]).max() < 3e-5
    assert 0.0 < inside[20:].min() < inside[20:].max() < 4e-4  # the flat in the middle


def test_window_holds_frame_depth_and_points_that_fit():
    for config, angles in ((PAD, (0.6, -0.4)), (PAD.replace(window_m=0.03), (0.1, 0.9))):
        window = pad_window(config, pad_direction(*angles))
        on_pad = np.isfinite(window.depth)
        assert 0 < on_pad.sum() < on_pad.size  # it reaches beside the pad
        assert window.depth.min() >= 0.0
        assert_allclose(np.linalg.norm(window.points[on_pad] / PAD.skin_axes, axis=-1), 1.0, rtol=1e-12)
        assert np.isnan(window.points[~on_pad]).all()


def test_gap_starts_at_first_touch_wherever_the_object_is_and_what_is_no_surface_is_refused():
    window = pad_window(PAD, pad_direction(0.2, 0.1))
    height = np.where(window.x < 0.002, -50 * window.x**2, -np.inf)
    gap = gap_field(window.depth, height)
    assert gap.min() == 0.0
    assert np.isinf(gap[window.x >= 0.002]).all()
    assert_allclose(gap_field(window.depth, height - 0.3), gap, atol=1e-15)
    with pytest.raises(ContactError, match="no cell of the window holds both"):
        gap_field(np.zeros((2, 2)), np.full((2, 2), -np.inf))
    for direction in (np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])):
        with pytest.raises(ContactError, match="points to the nail"):
            contact_frame(PAD, direction)
