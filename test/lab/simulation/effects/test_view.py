# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from every_case import every_case
from scipy.spatial import cKDTree
from sim_builders import CAN, run, scene

from benchmarks.random_scenes import DepthScene, Primitive
from foretouch.errors import SimulationError
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT, GRAZING_DEG, HOLE_SHARE, TABLE
from foretouch_lab.simulation.effects.view import _free_path, normals_of
from foretouch_lab.simulation.solids import Body
from foretouch_lab.simulation.world import World

STILL = {"x_m": [0, 0], "y_m": [0, 0], "yaw_deg": [0, 0]}
FLAT = {"name": "box", "shape": "box", "size_m": [0.12, 0.16, 0.05], "pose": STILL}
BALL = {"name": "ball", "shape": "ball", "size_m": [0.1, 0.1, 0.1]}


def test_depth_and_labels_are_those_of_the_solid() -> None:
    config = scene(FLAT, camera={"tilt_deg": 30})
    state = run(config, "render")
    body, view = state.bodies[0], World.of(config).view
    depth, labels = DepthScene(view, (Primitive("box", body.size, body.position, body.rotation),)).cast()
    same = labels[state.window] == state.labels
    assert same.mean() > 0.99  # edges are rounded
    off = np.abs(state.exact_depth - depth[state.window])[same & (state.labels > 0)]
    assert np.percentile(off, 95) < 1e-5
    assert set(np.unique(state.labels)) == {TABLE, FIRST_OBJECT}


def test_stereo_hides_the_far_side_of_a_tall_object_and_flying_pixels_hang_before_it() -> None:
    config = scene(FLAT, camera={"noise": {"sub_pixel": 0.08}})
    focal = World.of(config).view.matrix[0, 0]
    states = [run(config, "cloud", slot=slot) for slot in range(12)]
    spread = [np.mean(((one.depth - one.exact_depth) / one.exact_depth**2) ** 2) for one in states]
    assert np.sqrt(np.mean(spread)) == pytest.approx(0.08 / (focal * 0.055), rel=0.1)  # the noise
    tall = FLAT | {"size_m": [0.1, 0.1, 0.2]}
    plain = run(scene(tall), "cloud")
    state = run(scene(tall, camera={"stereo": {}}), "cloud")
    hidden = np.isfinite(state.exact_depth) & ~np.isfinite(state.depth)
    assert hidden.sum() > 50
    assert (state.labels[hidden] == TABLE).all()
    middle = np.nonzero(state.labels == FIRST_OBJECT)[1].mean()
    assert np.nonzero(hidden)[1].max() < middle  # the other imager is to the right
    flying = run(scene(tall, camera={"flying_pixels": {}}), "cloud").depth
    moved = np.abs(flying - plain.depth) > 1e-6
    assert 50 < moved.sum() < 0.1 * moved.size
    assert (flying[moved] > plain.depth.min()).all()
    assert (flying[moved] < plain.depth.max() + 1e-9).all()


def test_holes_have_their_share_and_steep_faces_none_left() -> None:
    flat = run(scene(FLAT, camera={"holes": {}}), "cloud")
    away = flat.labels == TABLE  # which no face turns away
    assert np.mean(~np.isfinite(flat.depth[away])) == pytest.approx(HOLE_SHARE, abs=0.004)
    state = run(scene(BALL, camera={"holes": {}}), "cloud")
    on_ball, up = state.labels == FIRST_OBJECT, normals_of(state)[..., 2]
    seen = on_ball & np.isfinite(state.depth)
    assert up[seen].min() > np.cos(np.radians(GRAZING_DEG + 6.0))  # up to the slant of the ray
    steep = on_ball & (up < np.cos(np.radians(GRAZING_DEG + 4.0)))
    assert steep.any()
    assert not np.isfinite(state.depth[steep]).any()


def test_clutter_hides_a_part_and_is_no_part_of_the_cloud_and_may_touch() -> None:
    config = scene(FLAT, clutter={"count": 6, "distance_m": [0.13, 0.25]}, camera={"tilt_deg": 45})
    smaller = 0
    for slot in range(5):
        with_clutter = run(config, "cloud", slot=slot)
        whole = run(scene(FLAT, camera={"tilt_deg": 45}), "cloud", slot=slot)
        smaller += int((with_clutter.labels == FIRST_OBJECT).sum() < (whole.labels == FIRST_OBJECT).sum())
        assert with_clutter.cloud.size == (with_clutter.labels == FIRST_OBJECT).sum()
        assert len(with_clutter.bodies) == 7
    assert smaller >= 1
    balls = [Body("ball", 0, np.full(3, 0.06), np.array([x, y, 0.03]), np.eye(3)) for x, y in ((0.0, 0.0), (0.3, 0.02))]
    way = np.array([1.0, 0.0, 0.0])
    assert _free_path(*balls, way) == pytest.approx(0.3 - np.sqrt(0.06**2 - 0.02**2), abs=2e-4)  # centres 6 cm apart
    assert _free_path(*balls, -way) == np.inf
    for slot in range(4):
        bodies = run(scene(FLAT, clutter={"count": 4, "touching": {}}), "clutter", slot=slot).bodies
        surfaces = [body.position + (body.mesh.vertices * body.size) @ body.rotation.T for body in bodies]
        for k, surface in enumerate(surfaces[1:], 1):
            distance, _ = cKDTree(np.concatenate(surfaces[:k])).query(surface)
            assert distance.min() < 5e-3  # between vertices, which are up to 8 mm apart on a box
            assert surface[:, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_the_cloud_lies_on_the_object_and_colours_are_darker_where_it_turns_away() -> None:
    config = scene(BALL, camera={"tilt_deg": 20})
    state, world = run(config, "cloud"), World.of(config)
    points = world.view.to_world(state.cloud.xyz.astype(np.float64))
    np.testing.assert_allclose(np.linalg.norm(points - state.bodies[0].position, axis=1), 0.05, atol=5e-5)
    rows, columns = np.divmod(state.pixels, world.view.width)
    local = world.view.to_camera(points) @ world.view.matrix.T
    np.testing.assert_allclose(local[:, :2] / local[:, 2:], np.column_stack([columns, rows]), atol=1e-3)
    rgb = run(scene(CAN | {"colour": [200, 100, 0]}), "colour").cloud.rgb
    assert rgb[:, 0].max() > 190
    assert rgb[:, 0].min() < 0.8 * rgb[:, 0].max()
    assert (rgb[:, 2] == 0).all()


def test_a_view_that_cannot_be_made_is_a_named_failure() -> None:
    tiny = {"name": "pea", "shape": "ball", "size_m": [0.01, 0.01, 0.01]}
    with pytest.raises(SimulationError, match=r"pea: \d+ points in view, fewer than 100") as caught:
        run(scene(tiny))
    assert caught.value.reason == "too_few_points"
    with pytest.raises(SimulationError, match=r"finds no place in 100 tries") as caught:
        run(scene(clutter={"count": 20, "distance_m": [0.1, 0.11]}))
    assert caught.value.reason == "no_place"


def test_objects_stand_on_the_table_within_their_ranges_and_random_shapes_take_turns() -> None:
    def check(rest: str, slot: int) -> None:
        pose = {"rest": rest, "x_m": [0.01, 0.02], "y_m": [-0.05, 0.05]}
        body = run(scene(CAN | {"pose": pose, "size_spread": 0.1}), "object", slot=slot).bodies[0]
        assert body.lowest() == pytest.approx(0.0, abs=1e-9)
        assert 0.01 <= body.position[0] <= 0.02
        assert np.abs(body.size / (0.07, 0.07, 0.1) - 1.0).max() <= 0.1
        np.testing.assert_allclose(body.rotation @ body.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(body.rotation) == pytest.approx(1.0)
        up = abs(body.rotation[2, 2])
        assert (rest == "any") or up == pytest.approx(1.0 if rest == "upright" else 0.0, abs=1e-9)

    every_case([(rest, slot) for rest in ("upright", "side", "any") for slot in range(12)], check)
    config = scene({"name": "thing", "shape": "random", "variants": 3, "size_m": [0.08, 0.08, 0.08]}, CAN)
    variants = [run(config, "object", slot=slot).bodies[0].variant for slot in range(8)]
    assert variants == [0, 0, 1, 0, 2, 0, 0, 0]
