# SPDX-License-Identifier: Apache-2.0
"""Pixels without depth beside an object: of glass they may belong to it, and the shadow of a lens does not."""

from dataclasses import replace

import numpy as np
from every_case import every_case

import foretouch as ft
from foretouch.grasp.messages import decode_grasp
from foretouch.grasp.unseen import BESIDE_UNSEEN, DepthAround
from foretouch.types import Float32

F, WIDTH, HEIGHT = 300.0, 320, 240
BOTTLE_M, TOP_M, TABLE_M = 0.035, 0.8, 0.9
_U, _V = np.meshgrid((np.arange(WIDTH) - 159.5) / F, (np.arange(HEIGHT) - 119.5) / F)


def bottle() -> Float32:
    """(240, 320) depth [m] of an upright bottle 70 mm across and 100 mm high, seen from straight above, with noise."""
    depth = np.full(_U.shape, TABLE_M)
    for level in np.linspace(TABLE_M, TOP_M, 80):
        depth = np.where((_U * level) ** 2 + (_V * level) ** 2 < BOTTLE_M**2, np.minimum(depth, level), depth)
    return (depth + np.random.default_rng(0).normal(0, 0.0004, depth.shape)).astype(np.float32)


def half_of_glass() -> Float32:
    depth = bottle()
    depth[(np.hypot(_U, _V) * TOP_M < 0.04) & (_U > 0)] = 0
    return depth


def with_shadow(depth: Float32, baseline_m: float) -> Float32:
    """Without the pixels of the background that a second lens, so far to the left, does not see."""
    disparity = F * baseline_m / depth
    at = np.rint(np.arange(WIDTH) - disparity).astype(int) + WIDTH
    nearest = np.zeros((HEIGHT, 2 * WIDTH))
    rows = np.arange(HEIGHT)[:, None]
    np.maximum.at(nearest, (rows, at), disparity)
    return np.where(nearest[rows, at] > disparity + 1.0, np.float32(0), depth)


def plan_of(depth: Float32, **settings: object) -> ft.Grasps:
    config = ft.PipelineConfig.from_mapping(settings)
    (target,) = ft.segment(ft.Cloud.from_depth(depth, (F, F, 159.5, 119.5))).objects
    return ft.Pipeline(config).plan(target).grasps


def test_no_finger_is_planned_into_the_half_of_a_bottle_that_has_no_depth() -> None:
    """Lines into the unseen half are scored lower and flagged; another one, of which both ends are seen, is taken."""
    whole, half = plan_of(bottle()), plan_of(half_of_glass())
    assert 0.055 < whole.width_m[0] < 0.075
    assert half.width_m[0] > 0.045
    assert np.hypot(*half.g1[0, :2]) > 0.025
    assert np.hypot(*half.g2[0, :2]) > 0.025
    assert half.score[0] < whole.score[0]
    assert not any(BESIDE_UNSEEN in flags for flags in (*whole.flags, *half.flags))
    across = ft.Grasps.of([ft.Grasp(np.array([-0.03, 0.0, 0.85]), np.array([-0.002, 0.0, 0.85]))])
    (target,) = ft.segment(ft.Cloud.from_depth(half_of_glass(), (F, F, 159.5, 119.5))).objects
    around = DepthAround.of(target)
    assert around is not None
    assert 0.005 < around.beside(across.g1, across.g2)[0] < 0.04


def test_grasps_that_end_beside_unseen_pixels_all_the_same_are_flagged_wherever_they_are_told() -> None:
    """In columns, rows, JSON, messages and predictions."""
    cloud = ft.Cloud.from_depth(bottle(), (F, F, 159.5, 119.5))
    (target,) = ft.segment(cloud).objects
    depth, ring = bottle(), np.hypot(_U, _V) * TOP_M
    depth[(ring > 0.034) & (ring < 0.075)] = 0  # nothing is seen around it
    target = replace(target, image=ft.Cloud.from_depth(depth, (F, F, 159.5, 119.5)))
    grasps = ft.Pipeline(ft.PipelineConfig.from_mapping({"grasp.count": 3})).plan(target).grasps
    assert len(grasps) > 1
    assert grasps.flags.tolist() == len(grasps) * [(BESIDE_UNSEEN,)]
    assert grasps[0].flags == (BESIDE_UNSEEN,)
    assert grasps.to_dict()["grasps"][0]["flags"] == [BESIDE_UNSEEN]
    assert all(BESIDE_UNSEEN in flags for flags in ft.load_model().predict(target, grasps).flags)
    seen = ft.Pipeline().plan(replace(target, image=None)).grasps  # of points alone nothing is known
    assert seen.flags.tolist() == [()]
    assert seen.score[0] > grasps.score[0] + 2.0


def test_the_shadow_of_a_stereo_camera_beside_an_object_is_no_part_of_it() -> None:
    """Of baselines of 50 to 100 mm, on either side: the same grasp as without, without a flag."""
    plain = plan_of(bottle())

    def check(baseline_m: float, mirrored: bool) -> None:
        depth = with_shadow(bottle()[:, ::-1], baseline_m)[:, ::-1] if mirrored else with_shadow(bottle(), baseline_m)
        assert np.count_nonzero(depth == 0) > 40
        found = plan_of(np.ascontiguousarray(depth))
        assert found.flags.tolist() == [()]
        np.testing.assert_allclose(found.width_m, plain.width_m, atol=0.004)

    every_case([(baseline, side) for baseline in (0.05, 0.1) for side in (False, True)], check)


def test_geograsp_as_published_does_not_look_at_it() -> None:
    original = {"grasp.method": "original"}
    (target,) = ft.segment(ft.Cloud.from_depth(half_of_glass(), (F, F, 159.5, 119.5))).objects
    pipeline = ft.Pipeline(ft.PipelineConfig.from_mapping(original))
    one, other = pipeline.plan(target).grasps, pipeline.plan(replace(target, image=None)).grasps
    np.testing.assert_array_equal(one.pose, other.pose)
    np.testing.assert_array_equal(one.score, other.score)


def test_organised_points_are_looked_at_as_depth_images_are() -> None:
    """The projection follows from the points and their pixels."""
    cloud = ft.Cloud.from_depth(half_of_glass(), (F, F, 159.5, 119.5))
    (target,) = ft.segment(cloud).objects
    (same,) = ft.segment(ft.Cloud(cloud.xyz)).objects
    one, other = DepthAround.of(target), DepthAround.of(same)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(one.camera, [[F, 159.5], [F, 119.5]], rtol=1e-4)
    rng = np.random.default_rng(1)
    ends = rng.normal([[0.0, 0.0, 0.85]], [[0.04, 0.04, 0.02]], (50, 3))
    outwards = rng.normal(size=(50, 3))
    outwards /= np.linalg.norm(outwards, axis=1)[:, None]
    np.testing.assert_allclose(one.beyond_m(ends, outwards), other.beyond_m(ends, outwards), atol=1e-5)
    assert one.beyond_m(ends, outwards).max() > 0.01


def test_a_message_without_flags_is_of_an_older_version() -> None:
    from types import SimpleNamespace

    point = SimpleNamespace(x=0.03, y=0.0, z=0.9)
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
    fields = {"g1": point, "g2": SimpleNamespace(x=-0.03, y=0.0, z=0.9), "rotation": np.eye(3)[:, [1, 2, 0]].ravel()}
    fields |= {"pose": SimpleNamespace(orientation=turn), "score": 1.0, "id": "a", "object_id": "1"}
    assert decode_grasp(SimpleNamespace(**fields)).flags == ()
    assert decode_grasp(SimpleNamespace(**fields, flags=[BESIDE_UNSEEN])).flags == (BESIDE_UNSEEN,)
