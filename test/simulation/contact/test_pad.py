# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import ContactError
from foretouch.simulation.contact import (
    PadConfig,
    cell_centres,
    contact_frame,
    gap_field,
    pad_depth,
    pad_direction,
    pad_window,
)
from foretouch.tactile import electrode_positions

PAD = PadConfig()


def test_core_passes_through_the_electrodes():
    axes = PAD.skin_axes - PAD.layer_m
    positions = electrode_positions()
    inside = (1 - np.linalg.norm(positions / axes, axis=1)) * np.linalg.norm(positions, axis=1)
    assert np.abs(inside[:20]).max() < 3e-5
    assert 0.0 < inside[20:].min() < inside[20:].max() < 4e-4  # the flat in the middle


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.6, 0.0), (-0.5, 1.0), (0.3, -1.2)])
def test_frame_lies_on_the_skin_with_its_normal(angles):
    direction = pad_direction(*angles)
    frame = contact_frame(PAD, 3.0 * direction)
    assert_allclose(np.linalg.norm(frame.origin / PAD.skin_axes), 1.0, rtol=1e-12)
    gradient = frame.origin / PAD.skin_axes**2
    assert_allclose(gradient / np.linalg.norm(gradient), direction, atol=1e-12)
    assert_allclose(frame.rotation.T @ frame.rotation, np.eye(3), atol=1e-12)
    assert_allclose(np.linalg.det(frame.rotation), 1.0, rtol=1e-12)


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.6, -0.4)])
def test_depth_puts_the_cells_on_the_skin(angles):
    frame = contact_frame(PAD, pad_direction(*angles))
    x, y = cell_centres(PAD)
    depth = pad_depth(PAD, frame, x, y)
    assert depth.min() >= 0.0
    on_pad = np.isfinite(depth)
    assert on_pad.mean() > 0.98
    points = frame.points(x[on_pad], y[on_pad], depth[on_pad])
    assert_allclose(np.linalg.norm(points / PAD.skin_axes, axis=-1), 1.0, rtol=1e-12)


def test_depth_about_the_middle_is_that_of_the_two_radii_of_curvature():
    frame = contact_frame(PAD, pad_direction(0.0, 0.0))
    a, _, c = PAD.skin_axes
    small = np.array(1e-5)
    assert_allclose(pad_depth(PAD, frame, small, 0 * small), small**2 / (2 * a**2 / c), rtol=1e-5)
    assert_allclose(pad_depth(PAD, frame, 0 * small, small), small**2 / (2 * c), rtol=1e-5)


def test_nothing_lies_beside_the_pad():
    frame = contact_frame(PAD, pad_direction(0.0, 0.0))
    assert math.isinf(pad_depth(PAD, frame, np.array(0.0), np.array(0.02)))


def test_gap_starts_at_first_touch_wherever_the_object_is():
    frame = contact_frame(PAD, pad_direction(0.2, 0.1))
    x, y = cell_centres(PAD)
    depth = pad_depth(PAD, frame, x, y)
    height = np.where(x < 0.002, -50 * x**2, -np.inf)
    gap = gap_field(depth, height)
    assert gap.min() == 0.0
    assert np.isinf(gap[x >= 0.002]).all()
    assert_allclose(gap_field(depth, height - 0.3), gap, atol=1e-15)


def test_object_outside_the_window_is_refused():
    with pytest.raises(ContactError, match="no cell of the window holds both"):
        gap_field(np.zeros((3, 3)), np.full((3, 3), -np.inf))


def test_height_that_is_no_height_is_refused():
    with pytest.raises(ContactError, match="use -inf where there is no surface"):
        gap_field(np.zeros((2, 2)), np.array([[0.0, np.nan], [0.0, 0.0]]))
    with pytest.raises(ContactError, match=r"shape \(3, 3\) is not that of the pad, \(2, 2\)"):
        gap_field(np.zeros((2, 2)), np.zeros((3, 3)))


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)])
def test_nail_side_is_refused(direction):
    with pytest.raises(ContactError, match="points to the nail"):
        contact_frame(PAD, np.array(direction))


def test_direction_without_length_is_refused():
    with pytest.raises(ContactError, match="has no finite length"):
        contact_frame(PAD, np.zeros(3))


def test_window_holds_frame_depth_and_points_that_fit():
    window = pad_window(PAD.replace(window_m=0.03), pad_direction(0.1, 0.9))
    on_pad = np.isfinite(window.depth)
    assert 0 < on_pad.sum() < on_pad.size  # it reaches beside the pad
    assert_allclose(np.linalg.norm(window.points[on_pad] / PAD.skin_axes, axis=-1), 1.0, rtol=1e-12)
    assert np.isnan(window.points[~on_pad]).all()
