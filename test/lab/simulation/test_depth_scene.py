# SPDX-License-Identifier: Apache-2.0
"""Rays, rendered scenes and the faults of a stereo camera against geometry worked out by hand and another ray caster."""

import numpy as np
import pytest
from every_case import every_case

from benchmarks import random_scenes
from benchmarks.random_scenes import DepthScene, Primitive, random_scene
from foretouch.camera.device import ensure_libusb
from foretouch.errors import ConfigError
from foretouch_lab.simulation.depth_scene import (
    FIRST_OBJECT,
    TABLE,
    CameraView,
    add_flying_pixels,
    add_stereo_noise,
    stereo_shadow,
)
from foretouch_lab.simulation.solids import Body, footprint_m

POSITION = np.array([0.1, -0.2, 0.3])
EYE = np.array([0.2, 0.1, 1.5])
UP = np.array([0.0, 0.0, 1.0])
_QUARTER = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z along x


@pytest.fixture
def turn(rng):
    q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def rays(rng, count=4000):
    """Of any length, towards the solids."""
    return (POSITION + rng.uniform(-0.08, 0.08, (count, 3)) - EYE) * rng.uniform(0.3, 3.0, (count, 1))


def test_rays_meet_solids_where_a_hand_calculation_says_from_any_origin():
    ball = Primitive("ball", np.full(3, 0.2), UP)
    t = ball.cast(np.zeros(3), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.5], [0.0, 0.2, 1.0], [0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(t, [0.9, 1.8, np.inf, np.inf], rtol=1e-15)
    can = Primitive("cylinder", np.array([0.1, 0.1, 0.2]), UP)
    lying = Primitive("cylinder", can.size, UP, _QUARTER)
    t = lying.cast(np.zeros(3), np.array([[0.0, 0.0, 1.0], [0.09, 0.0, 1.0], [0.12, 0.0, 1.0]]))
    np.testing.assert_allclose(t, [0.95, 0.95, np.inf], rtol=1e-12)
    for direction in ([0.0, 0.0, 1.0], [1e-17, 0.0, 1.0]):  # parallel to the axis only the cap counts
        hits = [float(can.cast(np.array([x, 0.0, 0.0]), np.array(direction))) for x in (0.04, 0.06)]
        np.testing.assert_allclose(hits, [0.9, np.inf], rtol=1e-12)
    box = Primitive("box", np.full(3, 0.2), UP)
    for x, expected in ((0.0, 0.9), (0.1, 0.9), (0.1000001, np.inf)):  # along a face: in or out, never NaN
        assert float(box.cast(np.array([x, 0.0, 0.0]), UP)) == pytest.approx(expected)


def test_hits_agree_with_open3d(turn, rng):
    ensure_libusb()
    o3d = pytest.importorskip("open3d", reason="Open3D is not installed: pip install foretouch[open3d]")
    make = o3d.geometry.TriangleMesh
    cases = {
        "box": (make.create_box(0.1, 0.06, 0.12).translate((-0.05, -0.03, -0.06)), 1e-5, (0.1, 0.06, 0.12)),
        "cylinder": (make.create_cylinder(0.04, 0.11, resolution=400, split=1), 1e-3, (0.08, 0.08, 0.11)),
        "ball": (make.create_sphere(0.05, resolution=200), 1e-3, (0.1, 0.1, 0.1)),
    }
    directions = rays(rng, 20_000)

    def check(name, mesh, tolerance, size):
        mesh.rotate(turn, (0.0, 0.0, 0.0)).translate(POSITION)
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
        both_ends = np.hstack([np.broadcast_to(EYE, directions.shape), directions]).astype(np.float32)
        theirs = scene.cast_rays(o3d.core.Tensor(both_ends))["t_hit"].numpy()
        ours = Primitive(name, np.array(size), POSITION, turn).cast(EYE, directions)
        both = np.isfinite(ours) & np.isfinite(theirs)
        assert both.sum() > 2000
        assert (np.isfinite(ours) != np.isfinite(theirs)).mean() < 3e-3  # silhouettes: facets against the true curve
        error = np.abs(ours[both] - theirs[both]) * np.linalg.norm(directions[both], axis=1)
        assert np.quantile(error, 0.99) < tolerance  # grazing rays stretch a facet's sagitta

    every_case([(name, *case) for name, case in cases.items()], check)


def test_a_stretched_ball_is_an_ellipsoid_with_its_gradient_as_normals_and_bodies_stand_on_their_lowest_point(
    turn, rng
):
    size = np.array([0.06, 0.1, 0.14])
    body, directions = Body("ball", 0, size, POSITION, turn), rays(rng)
    hits = body.cast(EYE, directions)
    seen = np.isfinite(hits.t)
    local = (EYE + hits.t[seen, None] * directions[seen] - POSITION) @ turn
    np.testing.assert_allclose(((local / (size / 2)) ** 2).sum(axis=1), 1.0, atol=3e-3)
    gradient = (local / size**2) @ turn.T
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    normals = body.world_normals(hits.normal[seen])
    assert np.einsum("ij,ij->i", normals, gradient).min() > np.cos(0.05)  # a facet turns by 0.04 rad
    angle = 0.4
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(angle), -np.sin(angle)], [0.0, np.sin(angle), np.cos(angle)]])
    can = Body("can", 0, np.array([0.08, 0.08, 0.1]), np.array([0.0, 0.0, 0.5]), tilt)
    exact = 0.5 - 0.05 * np.cos(angle) - 0.04 * np.sin(angle)
    assert can.lowest() == pytest.approx(exact, abs=2e-3)  # the rim is bevelled


def test_a_box_has_the_depth_and_area_of_its_lid_and_above_the_horizon_is_nothing() -> None:
    box = Primitive("box", np.array([0.2, 0.1, 0.2]), 0.1 * UP)
    image = DepthScene(CameraView.towards_table(424, 240, 1.0, 0.0), (box,)).render()
    seen = image.labels == FIRST_OBJECT
    assert np.unique(image.depth_mm[seen]).tolist() == [800]  # 1 m less its height
    assert seen.sum() == pytest.approx(0.2 * 0.1 * (image.K[0, 0] / 0.8) ** 2, rel=0.03)
    assert np.unique(image.depth_mm[image.labels == TABLE]).tolist() == [1000]
    image = DepthScene(CameraView.towards_table(424, 240, 1.0, 1.35), ()).render()
    assert (image.depth_mm[image.labels == 0] > 0).any()
    assert np.isnan(image.cloud().xyz[0]).all()


def test_pixels_lie_on_the_stated_plane_and_on_the_ball_and_the_nearer_object_hides_the_farther() -> None:
    ball = Primitive("ball", np.full(3, 0.14), np.array([0.05, -0.03, 0.07]))
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
    low, high = (Primitive("box", np.array([a, a, 0.1]), z * UP) for a, z in ((0.2, 0.05), (0.1, 0.2)))
    for order in ((low, high), (high, low)):
        labels = DepthScene(CameraView.towards_table(424, 240, 1.0, 0.0), order).cast()[1]
        assert labels[120, 212] == FIRST_OBJECT + order.index(high)
        assert (labels == FIRST_OBJECT + order.index(low)).any()


def test_random_objects_stand_on_the_table_apart_and_inside_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    def check(view: str, seed: int) -> None:
        scene = random_scene(np.random.default_rng(seed), 424, 240, 3, view=view)  # type: ignore[arg-type]
        labels = scene.cast()[1]
        for label, solid in enumerate(scene.objects, FIRST_OBJECT):
            rows, columns = np.nonzero(labels == label)
            assert len(rows) > 100, "too small to segment"
            assert 0 < rows.min() <= rows.max() < 239
            assert 0 < columns.min() <= columns.max() < 423
            assert solid.corners()[:, 2].min() == pytest.approx(0.0, abs=1e-12)
        for i, object_ in enumerate(scene.objects):
            for other in scene.objects[:i]:
                gap = (
                    np.linalg.norm((object_.position - other.position)[:2]) - footprint_m(object_) - footprint_m(other)
                )
                assert gap > 0.03

    every_case([(view, seed) for view in ("oblique", "top") for seed in range(12)], check)
    scene = random_scene(np.random.default_rng(5), 212, 120)
    exact = scene.render()
    noisy, again = (scene.render(np.random.default_rng(6), noise_m=0.002, flying_pixels=True) for _ in range(2))
    assert np.array_equal(noisy.depth_mm, again.depth_mm)
    assert not np.array_equal(exact.depth_mm, noisy.depth_mm)
    assert all(np.array_equal(getattr(exact, truth), getattr(noisy, truth)) for truth in ("labels", "plane", "rgb"))
    monkeypatch.setattr(random_scenes, "_ROUNDS", 2)
    with pytest.raises(ConfigError, match="n_objects: 60 find no place in a view of 212x120"):
        random_scene(np.random.default_rng(0), 212, 120, 60)


def _step(near: float = 0.5, far: float = 1.0) -> np.ndarray:
    """40 columns far, 40 near, 40 far."""
    depth = np.full((30, 120), far)
    depth[:, 40:80] = near
    return depth


def test_noise_grows_with_the_square_of_the_depth_and_is_correlated_over_the_window(rng) -> None:
    for distance in (0.5, 2.0):
        noise = add_stereo_noise(np.full((300, 400), distance), 0.002, rng) - distance
        assert noise.std() == pytest.approx(0.002 * distance**2, rel=0.05)
        assert abs(noise.mean()) < 0.1 * noise.std()
    partial = np.where(np.arange(30)[:, None] < 10, np.inf, _step())
    assert np.array_equal(np.isinf(add_stereo_noise(partial, 0.001, rng)), np.isinf(partial))
    noise = add_stereo_noise(np.ones((400, 400)), 0.001, rng) - 1.0
    for lag, expected in ((1, 8 / 9), (4, 5 / 9), (9, 0.0)):  # of a mean over 9 columns
        measured = np.corrcoef(noise[:, :-lag].ravel(), noise[:, lag:].ravel())[0, 1]
        assert measured == pytest.approx(expected, abs=0.05)


def test_flying_pixels_lie_between_both_sides_and_the_shadow_left_of_the_near_thing(rng: np.random.Generator) -> None:
    flying = add_flying_pixels(_step(), rng)
    assert set(np.flatnonzero((flying != _step()).any(axis=0))) == {39, 40, 79, 80}
    assert 0.5 <= flying.min() <= flying.max() <= 1.0
    assert flying[:, 39].std() > 0.1  # each pixel its own mixture
    slope = np.tile(np.linspace(0.5, 1.0, 120), (30, 1))
    assert np.array_equal(add_flying_pixels(slope, rng), slope)
    # f·B = 10 px·m: disparity 10 at 1 m, 20 at 0.5 m, so 10 columns left of column 40 are hidden.
    hidden = stereo_shadow(_step(), focal_px=200.0, baseline_m=0.05)
    assert set(np.flatnonzero(hidden.all(axis=0))) == set(range(31, 40))
    assert not np.delete(hidden, range(30, 40), axis=1).any()
