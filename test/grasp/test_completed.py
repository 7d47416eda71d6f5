# SPDX-License-Identifier: Apache-2.0
"""The method `completed`: grasps through the middle of the whole solid, of which the camera sees one side."""

import numpy as np
import pytest
from every_case import every_case
from seen_solids import Camera, Solid, about_vertical, ball, box, can

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, GraspPlan, HandConfig, Obstacles, completed, object_axis, plan_grasps
from foretouch.grasp.reach import check_reach
from foretouch.types import Cloud, Float64, Plane
from foretouch.types.scene import Object

CONFIG = GeoGraspConfig()
SOLIDS = {"can": can(0.033, 0.12), "low can": can(0.04, 0.05), "ball": ball(0.035), "low box": box(0.06, 0.09, 0.05)}
SOLIDS["upright box"] = box(0.05, 0.08, 0.15)
FRICTION_DEG = 38.7  # of a coefficient of 0.8


def contacts(plan: GraspPlan, number: int = 0) -> Float64:
    return np.stack([plan.grasps[number].g1, plan.grasps[number].g2])


def plan_of(solid: Solid, camera: Camera, yaw: float = 0.0, **settings) -> tuple[GraspPlan, Float64]:
    """The plan, and its first grasp in the solid's own frame, whose z is the vertical through its middle."""
    plan = plan_grasps(camera.see(solid, yaw=yaw), camera.table(), CONFIG, **settings)
    assert plan.status == "ok", plan.reason
    return plan, camera.to_world(contacts(plan)) @ about_vertical(yaw)


def gap_mm(one: Float64, other: Float64) -> float:
    """Distance of the contacts that are farther apart, whichever comes first [mm]."""
    return 1e3 * min(np.linalg.norm(one - pair, axis=1).max() for pair in (other, other[::-1]))


def test_the_best_grasp_goes_through_the_middle_of_the_whole_solid() -> None:
    """Compared with where its line enters and leaves the true solid, also on the side that the camera does not see."""
    errors: list[float] = []

    def check(solid: Solid, elevation_deg: float, yaw: float) -> None:
        plan, found = plan_of(solid, Camera(elevation_deg), yaw)
        assert CONFIG.method == "completed"
        across = (found[1] - found[0]) / np.linalg.norm(found[1] - found[0])
        assert abs(across[2]) < 1e-6  # horizontal
        middle = found.mean(axis=0)
        assert abs(np.cross([*middle[:2], 0.0], across)[2]) < 0.012
        assert abs(middle[2] - solid.height_m / 2.0) < 0.012
        true = solid.contacts(middle, across)
        wrong = np.linalg.norm(found - true, axis=1)
        errors.extend(wrong)
        assert wrong.max() < 0.009
        width, whole = plan.grasps[0].width_m, np.linalg.norm(true[1] - true[0])
        assert -0.012 < width - whole < 0.003
        for at, outwards in zip(true, (-across, across), strict=True):
            slope = np.degrees(np.arccos(np.clip(solid.normal(at) @ outwards, -1.0, 1.0)))
            assert slope < FRICTION_DEG  # two fingers that close there do not slide off

    cases = {
        f"{name}, {elevation} deg, turned by {yaw}": (solid, elevation, yaw)
        for name, solid in SOLIDS.items()
        for elevation in (50.0, 60.0, 90.0)
        for yaw in ((0.0, 0.4, 1.0) if "box" in name else (0.0,))
    }
    every_case(cases, check)
    assert np.mean(errors) < 0.004


def test_a_turn_about_the_vertical_carries_the_grasp_along() -> None:
    """Seen from above, by a turn of the solid; obliquely, by a turn of the image, which is one of the camera."""
    above, solid = Camera(90.0), box(0.05, 0.11, 0.04)
    before = plan_of(solid, above)[1]
    for degrees in (15.0, 90.0, 180.0, 217.0):
        assert gap_mm(plan_of(solid, above, np.radians(degrees))[1], before) < 8.0, degrees
    oblique = Camera(55.0)
    cloud, table = oblique.see(solid, yaw=0.3), oblique.table()
    first = contacts(plan_grasps(cloud, table, CONFIG))
    for degrees in (5.0, 90.0, 180.0):
        roll = about_vertical(np.radians(degrees))  # about the optical axis
        turned = Cloud((cloud.xyz @ roll.T).astype(np.float32))
        after = contacts(plan_grasps(turned, Plane(roll @ table.normal, table.offset), CONFIG))
        assert gap_mm(after @ roll, first) < 10.0, degrees


def test_neither_the_order_nor_points_without_depth_change_a_bit(rng: np.random.Generator) -> None:
    camera = Camera(50.0)
    image = camera.see(SOLIDS["upright box"], yaw=0.5)
    flat = image.xyz.reshape(-1, 3)
    listed = flat[np.isfinite(flat).all(axis=1)]
    damaged = np.concatenate([listed, np.float32([[np.nan, 0.0, 1.0], [0.0, np.inf, 1.0]])])
    orders = (Cloud(listed), Cloud(rng.permutation(listed)), Cloud(rng.permutation(damaged)), image)
    plans = [plan_grasps(cloud, camera.table(), CONFIG.replace(count=5)) for cloud in orders]
    assert [plan.counts["n_dropped"] for plan in plans] == [0, 0, 2, len(flat) - len(listed)]
    for plan in plans[1:]:
        assert len(plan.grasps) == len(plans[0].grasps) == 5
        for a, b in zip(plan.grasps, plans[0].grasps, strict=True):
            np.testing.assert_array_equal([a.g1, a.g2, *a.rotation], [b.g1, b.g2, *b.rotation])
            assert a.score == b.score


def test_grasps_come_best_first_differ_and_have_the_pose_of_the_hand() -> None:
    plan, _ = plan_of(SOLIDS["can"], Camera(50.0))
    many = plan_grasps(Camera(50.0).see(SOLIDS["can"]), Camera(50.0).table(), CONFIG.replace(count=30))
    np.testing.assert_array_equal(contacts(plan), contacts(many))
    assert 5 < len(many.grasps) <= 30
    scores = [grasp.score for grasp in many.grasps]
    assert scores == sorted(scores, reverse=True)
    assert np.isfinite(scores).all()
    for k, one in enumerate(many.grasps):
        for other in many.grasps[:k]:
            assert max(np.linalg.norm(one.g1 - other.g1), np.linalg.norm(one.g2 - other.g2)) >= 0.01 - 1e-9
        along = (one.g1 - one.g2) / one.width_m
        np.testing.assert_allclose(one.rotation[:, 2], along, atol=1e-9)
        np.testing.assert_allclose(one.rotation.T @ one.rotation, np.eye(3), atol=1e-9)
        assert abs(one.rotation[:, 0] @ plan.axis) < 1e-9
    axis, centroid = object_axis(Camera(50.0).see(SOLIDS["can"]), Camera(50.0).table(), CONFIG)
    assert abs(axis @ plan.axis) > 0.99
    assert np.linalg.norm(centroid - plan.centroid) < 0.003
    np.testing.assert_array_equal(plan.initial_points, contacts(plan))


def filters(plan: GraspPlan) -> dict[str, int]:
    return {name: plan.counts[name] for name in ("n_too_wide", "n_too_thin", "n_too_flat", "n_blocked", "n_free")}


def test_a_hand_that_does_not_open_so_far_has_no_grasp() -> None:
    camera, wide = Camera(55.0), box(0.12, 0.15, 0.08)
    cloud = camera.see(wide, yaw=0.2)
    plan = plan_grasps(cloud, camera.table(), CONFIG)
    assert (plan.status, len(plan.grasps)) == ("no_grasp", 0)
    assert "of" in plan.reason and "grasps can be executed" in plan.reason  # noqa: PT018
    assert f"{plan.counts['n_too_wide']} are wider than hand.opening_m 0.1" in plan.reason
    assert sum(filters(plan).values()) == plan.counts["n_lines"] > 0
    assert plan.counts["n_free"] == 0
    opened = plan_grasps(cloud, camera.table(), CONFIG.replace(count=50), hand=HandConfig(opening_m=0.14))
    assert opened.status == "ok"
    assert max(grasp.width_m for grasp in opened.grasps) <= 0.14
    assert sum(filters(opened).values()) == opened.counts["n_lines"]


def test_what_is_too_flat_for_a_fingertip_has_no_grasp() -> None:
    camera, plate = Camera(60.0), box(0.05, 0.08, 0.004)
    cloud = camera.see(plate)
    plan = plan_grasps(cloud, camera.table(), CONFIG)
    assert plan.status == "no_grasp"
    assert "too low for a fingertip that keeps hand.clearance_m from the table" in plan.reason
    assert plan.counts["n_too_flat"] == plan.counts["n_lines"]
    small = HandConfig(tip_radius_m=0.003, clearance_m=0.0)
    assert plan_grasps(cloud, camera.table(), CONFIG, hand=small).status == "ok"


def wall(camera: Camera, middle: Float64, across: Float64, distance_m: float) -> Float64:
    """(N, 3) float32 [m], camera frame: a wall across a line at a distance from its middle, 60 mm wide, 120 mm high."""
    beside = np.cross([0.0, 0.0, 1.0], across)
    u, v = np.meshgrid(np.linspace(-0.03, 0.03, 25), np.linspace(0.0, 0.12, 30))
    at = np.array([*middle[:2], 0.0]) + distance_m * across
    points = at + u.reshape(-1, 1) * beside + v.reshape(-1, 1) * [0.0, 0.0, 1.0]
    return camera.to_camera(points).astype(np.float32)


def test_what_stands_in_the_way_of_a_finger_blocks_a_grasp() -> None:
    camera, target = Camera(55.0), SOLIDS["can"]
    cloud, table = camera.see(target), camera.table()
    free = plan_grasps(cloud, table, CONFIG)
    found = camera.to_world(contacts(free))
    across = (found[1] - found[0]) / np.linalg.norm(found[1] - found[0])
    own = cloud.take(np.isfinite(cloud.xyz[..., 0])).xyz
    seen = {1: own, 7: wall(camera, found.mean(axis=0), across, 0.045)}

    def around(objects: dict[int, Float64]) -> Obstacles:
        return Obstacles.of(list(objects.items())).without(Object.of("1", cloud, table))

    plan = plan_grasps(cloud, table, CONFIG, obstacles=around(seen))
    assert plan.status == "ok"
    assert plan.counts["n_blocked"] > 0
    other = camera.to_world(contacts(plan))
    turned = (other[1] - other[0]) / np.linalg.norm(other[1] - other[0])
    assert abs(turned @ across) < 0.95  # another line
    far = around({1: own, 7: wall(camera, found.mean(axis=0), across, 0.2)})  # beyond the way in
    np.testing.assert_array_equal(contacts(plan_grasps(cloud, table, CONFIG, obstacles=far)), contacts(free))
    longer = HandConfig(approach_m=0.2)
    assert plan_grasps(cloud, table, CONFIG, obstacles=far, hand=longer).counts["n_blocked"] > 0
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    ring = {
        k + 2: wall(camera, np.array([0.0, 0.0, 0.06]), np.array([np.cos(a), np.sin(a), 0.0]), 0.05)
        for k, a in enumerate(angles)
    }
    none = plan_grasps(cloud, table, CONFIG, obstacles=around({1: own, **ring}))
    assert (none.status, none.counts["n_free"]) == ("no_grasp", 0)
    assert none.counts["n_blocked"] > 0.5 * none.counts["n_lines"]
    named = none.reason.split("blocked by object ")[1].split(";")[0]
    assert {int(one) for one in named.split(", ")} <= set(ring)


def test_a_slide_moves_the_grasp_along_the_axis(box_cloud: Cloud, top_view: Plane) -> None:
    still = plan_grasps(box_cloud, top_view, CONFIG)
    assert abs(still.axis[1]) > 0.99
    for slide_m in (-0.03, 0.02):
        slid = plan_grasps(box_cloud, top_view, CONFIG, slide_m=slide_m)
        assert slid.slide_m == slide_m
        moved = (slid.grasps[0].midpoint - still.grasps[0].midpoint) @ still.axis
        assert moved == pytest.approx(slide_m, abs=0.012)
        np.testing.assert_array_equal(slid.axis, still.axis)
    drawn = [plan_grasps(box_cloud, top_view, CONFIG, rng=np.random.default_rng(seed)).slide_m for seed in (3, 3, 4)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert max(map(abs, drawn)) < 0.8 * 0.07
    for beyond_m in (0.1, 0.5, 1e6):  # lines along the object may still reach it
        beyond = plan_grasps(box_cloud, top_view, CONFIG, slide_m=beyond_m)
        assert beyond.reason
        for grasp in beyond.grasps:
            check_reach(grasp, box_cloud.xyz, 0.1, 0.03)


def test_a_cloud_in_the_objects_own_frame_is_admitted_by_the_setting_that_the_refusal_names() -> None:
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (6000, 3))
    face = np.abs(points).argmax(axis=1)
    points[np.arange(6000), face] = np.sign(points[np.arange(6000), face])
    model = Cloud((points * [0.025, 0.04, 0.06]).astype(np.float32))  # all sides, around the origin
    table = Plane.from_coefficients([0.0, 0.0, 1.0, 0.06])
    refused = plan_grasps(model, Plane.from_coefficients([0.0, 0.0, 1.0, -0.1]), CONFIG)
    assert refused.status == "no_grasp"
    assert "for a cloud in the object's own frame set limits.min_range_m=0" in refused.reason
    plan = plan_grasps(model, table, CONFIG, limits=ObjectLimits(min_range_m=0.0))
    assert plan.status == "ok"
    assert plan.counts["n_completed"] == 0  # nothing is unseen
    assert np.abs(plan.grasps[0].midpoint).max() < 0.012
    assert plan.grasps[0].width_m == pytest.approx(0.05, abs=0.008)
    assert abs(plan.grasps[0].rotation[0, 2]) > 0.97


@pytest.mark.real_data
def test_recorded_objects_hold_still(real_data, top_view: Plane, rng: np.random.Generator) -> None:
    moved = []
    for path in sorted((real_data / "vision2tactile").glob("*/*/cloud-object.pcd"))[::25]:
        xyz = read_cloud(path).xyz.reshape(-1, 3)
        before = plan_grasps(Cloud(xyz), top_view, CONFIG)
        others = [xyz[rng.permutation(len(xyz))], *(xyz + rng.normal(0.0, s, xyz.shape) for s in (1e-6, 1e-4))]
        plans = [plan_grasps(Cloud(other.astype(np.float32)), top_view, CONFIG) for other in others]
        assert {plan.status for plan in plans} == {before.status}
        if before.grasps:
            moved.append([gap_mm(contacts(plan), contacts(before)) for plan in plans])
    order, micrometre, tenth = np.transpose(moved)
    assert len(moved) >= 12
    assert (order.max(), micrometre.max() < 10.0) == (0.0, True)
    assert (tenth > 10.0).sum() <= 1


def test_bad_lines_keep_their_order() -> None:
    """Costs are bounded for the neighbours of a line, but two of them are never the same."""
    costs = np.linspace(0.0, 1000.0, 500)
    bounded = completed._bounded(costs)
    assert (np.diff(bounded) > 0.0).all()
    assert bounded.max() < 5.0
    np.testing.assert_array_equal(bounded[costs < 4.0], costs[costs < 4.0])
