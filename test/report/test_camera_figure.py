# SPDX-License-Identifier: Apache-2.0
"""What the camera sees: the photograph or a relief, and outlines where labels end."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from scene_builders import scene_cloud

import foretouch as ft
from benchmarks.random_scenes import random_scene
from foretouch.report.camera_figure import draw_camera, draw_scene_image, photograph, pixels_of
from foretouch.types import Cloud


@pytest.fixture(scope="module")
def slit_scene() -> ft.Scene:
    """A scene with rows without depth, as registration to a colour camera leaves them."""
    cloud = scene_cloud(5, width=424)
    xyz = np.array(cloud.xyz)
    xyz[::17] = np.nan
    return ft.segment(Cloud(xyz))


def lines_of(scene: ft.Scene) -> list[np.ndarray]:
    """The corners of all outlines of objects, as columns and rows."""
    axes = Figure().subplots()
    draw_scene_image(axes, scene, None)
    return [line.get_xydata() for line in axes.lines]


def test_outlines_lie_where_labels_end_and_cross_no_object(slit_scene):
    scene, corners = slit_scene, np.concatenate(lines_of(slit_scene))
    assert scene.objects
    assert len(corners) > 100
    inside = scene.labels > 0
    rows, columns = np.indices(inside.shape)
    for object_ in scene.objects:
        own = scene.labels == int(object_.id)
        # Deep inside there is no corner: all around, within a few rows, the object goes on.
        deep = np.ones_like(own)
        for axis in (0, 1):
            for shift in (-4, -3, 3, 4):
                deep &= np.roll(own, shift, axis) | np.roll(own, shift + np.sign(shift), axis)
        apart = np.abs(corners[:, None] - np.stack([columns[deep & own], rows[deep & own]], axis=1)).max(axis=2)
        assert apart.min() >= 1.0
    to_border = [
        np.abs(np.stack(np.nonzero(~inside)[::-1], axis=1) - corner).max(axis=1).min() for corner in corners[::25]
    ]
    assert max(to_border) <= 1.0


def test_colours_are_shown_where_there_are_some_and_else_a_relief():
    frame = random_scene(np.random.default_rng(2), 160, 120, 2).render()
    coloured, grey = frame.cloud(with_rgb=True), frame.cloud()
    np.testing.assert_array_equal(photograph(coloured), frame.rgb)
    relief = photograph(grey)
    assert (relief[..., 0] == relief[..., 1]).all()
    shown = Figure().subplots()
    draw_camera(shown, coloured, {})
    np.testing.assert_array_equal(shown.images[0].get_array(), frame.rgb)
    border = np.abs(np.diff(frame.labels, axis=1)) > 0
    steps = np.abs(np.diff(relief[..., 0].astype(int), axis=1))
    assert steps[border].mean() > 4.0 * steps[~border].mean()  # one sees where objects end
    holes = replace(grey, xyz=np.full_like(grey.xyz, np.nan))
    assert not photograph(holes).any()


def test_points_are_drawn_where_the_camera_sees_them():
    cloud = scene_cloud(3)
    rows, columns = (part[::97] for part in np.nonzero(np.isfinite(cloud.xyz[..., 2])))
    places = pixels_of(cloud, cloud.xyz[rows, columns].astype(np.float64))
    np.testing.assert_allclose(places, np.stack([columns, rows], axis=1), atol=0.05)
