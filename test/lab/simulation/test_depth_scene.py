# SPDX-License-Identifier: Apache-2.0
"""Rendered scenes against geometry worked out by hand, and random ones against their promises."""

import numpy as np
import pytest
from every_case import every_case

from foretouch.errors import ConfigError
from foretouch_lab.simulation import Box, CameraView, Cylinder, DepthScene, Sphere, depth_scene, random_scene
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT, TABLE
from foretouch_lab.simulation.solids import footprint_m


def _top(*objects: Box | Cylinder | Sphere, distance_m: float = 1.0) -> DepthScene:
    return DepthScene(CameraView.towards_table(424, 240, distance_m, 0.0), objects)


def test_a_box_has_the_depth_and_area_of_its_lid_and_above_the_horizon_is_nothing() -> None:
    box = Box(position=np.array([0.0, 0.0, 0.1]), size=np.array([0.2, 0.1, 0.2]))
    image = _top(box).render()
    seen = image.labels == FIRST_OBJECT
    assert np.unique(image.depth_mm[seen]).tolist() == [800]  # 1 m less its height
    focal = image.K[0, 0]
    assert seen.sum() == pytest.approx(0.2 * 0.1 * (focal / 0.8) ** 2, rel=0.03)
    assert np.unique(image.depth_mm[image.labels == TABLE]).tolist() == [1000]
    image = DepthScene(CameraView.towards_table(424, 240, 1.0, 1.35), ()).render()
    outside = image.labels == 0
    assert (image.depth_mm[outside] > 0).any()
    assert (image.depth_mm[0] == 0).all()
    assert np.isnan(image.cloud().xyz[0]).all()


def test_pixels_lie_on_the_stated_plane_and_on_the_ball() -> None:
    ball = Sphere(position=np.array([0.05, -0.03, 0.07]), radius=0.07)
    for tilt in (0.0, 0.5, 0.9):
        view = CameraView.towards_table(424, 240, 0.9, tilt)
        scene = DepthScene(view, (ball,))
        image, (depth, labels) = scene.render(), scene.cast()
        points = image.cloud().xyz[image.labels == TABLE].astype(np.float64)
        heights = points @ image.plane[:3] + image.plane[3]
        assert image.plane[3] > 0.0  # the camera stands above the table
        # Rounding to a millimetre moves a point by half of one along its ray.
        assert np.abs(heights).max() <= 0.0005 * np.linalg.norm(points / points[:, 2:], axis=1).max()
        hits = view.eye + view.directions() * depth[..., None]
        distance = np.linalg.norm(hits[labels == FIRST_OBJECT] - ball.position, axis=1)
        assert len(distance) > 1000
        np.testing.assert_allclose(distance, 0.07, atol=1e-12)


def test_the_nearer_object_hides_the_farther() -> None:
    low = Box(position=np.array([0.0, 0.0, 0.05]), size=np.array([0.2, 0.2, 0.1]))
    high = Box(position=np.array([0.0, 0.0, 0.2]), size=np.array([0.1, 0.1, 0.1]))
    for order in ((low, high), (high, low)):
        scene = _top(*order)
        labels = scene.cast()[1]
        assert labels[120, 212] == FIRST_OBJECT + order.index(high)
        assert (labels == FIRST_OBJECT + order.index(low)).any()


def test_random_objects_stand_on_the_table_apart_and_inside_the_image() -> None:
    def check(view: str, seed: int) -> None:
        scene = random_scene(np.random.default_rng(seed), 424, 240, 3, view=view)  # type: ignore[arg-type]
        labels = scene.cast()[1]
        for label, solid in enumerate(scene.objects, FIRST_OBJECT):
            rows, columns = np.nonzero(labels == label)
            assert len(rows) > 100, "too small to segment"
            assert 0 < rows.min() <= rows.max() < 239
            assert 0 < columns.min() <= columns.max() < 423
            assert solid.corners()[:, 2].min() == pytest.approx(0.0, abs=1e-12)
        for i, one in enumerate(scene.objects):
            for other in scene.objects[:i]:
                gap = np.linalg.norm((one.position - other.position)[:2]) - footprint_m(one) - footprint_m(other)
                assert gap > 0.03

    every_case([(view, seed) for view in ("oblique", "top") for seed in range(12)], check)


def test_effects_come_back_with_the_seed_and_leave_the_truth_alone() -> None:
    scene = random_scene(np.random.default_rng(5), 212, 120)
    exact = scene.render()
    noisy, again = (scene.render(np.random.default_rng(6), noise_m=0.002, flying_pixels=True) for _ in range(2))
    for one, other in zip(scene.objects, random_scene(np.random.default_rng(5), 212, 120).objects, strict=True):
        assert np.array_equal(one.position, other.position)
    assert np.array_equal(noisy.depth_mm, again.depth_mm)
    assert not np.array_equal(exact.depth_mm, noisy.depth_mm)
    for truth in ("labels", "plane", "rgb"):
        assert np.array_equal(getattr(exact, truth), getattr(noisy, truth))


def test_bad_arguments_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="rng: is None"):
        _top().render(flying_pixels=True)
    monkeypatch.setattr(depth_scene, "_ROUNDS", 2)
    with pytest.raises(ConfigError, match="n_objects: 60 find no place in a view of 212x120"):
        random_scene(np.random.default_rng(0), 212, 120, 60)
