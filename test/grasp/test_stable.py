# SPDX-License-Identifier: Apache-2.0
"""The method `stable`: what small changes of the cloud do to its best grasp, and that it is held in a stream."""

from collections.abc import Iterable

import numpy as np
import pytest

from foretouch.cloud.geometry.flying import flying_mask
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, GraspHold, GraspPlan, HeldGrasp, object_axis, plan_grasps
from foretouch.types import Cloud, Float64, Plane

STABLE = GeoGraspConfig(method="stable")
HOLD = 2.0  # default of `grasp_hold`


def contacts(plan: GraspPlan) -> Float64:
    return np.stack([plan.grasps[0].g1, plan.grasps[0].g2])


def best(plan: GraspPlan) -> HeldGrasp:
    return HeldGrasp(plan.grasps[0], plan.axis, plan.outdone)


def turned(xyz: np.ndarray, degrees: float) -> tuple[np.ndarray, Float64]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return (xyz.astype(np.float64) @ turn.T).astype(np.float32), turn


@pytest.fixture
def wedge_cloud(rng: np.random.Generator) -> Cloud:
    """The top of an object that is wider at one end, with 0.5 mm of noise."""
    along, across = np.meshgrid(np.arange(-0.06, 0.06, 0.002), np.arange(-0.04, 0.04, 0.002))
    inside = np.abs(across) < 0.03 + 0.15 * along
    depth = 1.2 + 30.0 * across**2 + rng.normal(0.0, 0.0005, along.shape)
    return Cloud(np.stack([across, along, depth], axis=-1)[inside].astype(np.float32))


def test_order_changes_no_bit_jitter_little_and_a_shift_carries_the_grasp_along(box_cloud, top_view, rng) -> None:
    one, other = (
        plan_grasps(Cloud(xyz), top_view, STABLE.replace(count=5)).grasps
        for xyz in (box_cloud.xyz, rng.permutation(box_cloud.xyz))
    )
    assert len(one) == len(other) == 5
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal([a.g1, a.g2, *a.rotation], [b.g1, b.g2, *b.rotation])
        assert a.score == b.score
    before = plan_grasps(box_cloud, top_view, STABLE)
    for sigma, limit_mm in ((1e-6, 0.2), (1e-4, 5.0)):
        for _ in range(5):
            xyz = box_cloud.xyz + rng.normal(0.0, sigma, box_cloud.xyz.shape)
            after = contacts(plan_grasps(Cloud(xyz.astype(np.float32)), top_view, STABLE))
            assert np.linalg.norm(after - contacts(before), axis=1).max() * 1e3 < limit_mm
    for offset in ([0.25, 0.0, 0.0], [0.0, -0.2, 0.1], [0.0, 0.0, -0.3]):
        far = box_cloud.xyz.mean(axis=0) + np.float32(offset)
        after = plan_grasps(Cloud(np.vstack([box_cloud.xyz, far]).astype(np.float32)), top_view, STABLE)
        assert (before.counts["n_isolated"], after.counts["n_isolated"]) == (0, 1)
        np.testing.assert_allclose(contacts(after), contacts(before), atol=1e-6)
    for shift in ([0.001, 0.0, 0.0], [0.0, 0.0, 0.1], [1.0, 0.0, 0.0]):
        after = contacts(plan_grasps(Cloud((box_cloud.xyz + shift).astype(np.float32)), top_view, STABLE))
        np.testing.assert_allclose(after, contacts(before) + shift, atol=2e-4)


def test_a_turned_object_is_grasped_at_the_same_place_and_held_no_longer(wedge_cloud: Cloud, top_view: Plane) -> None:
    before = plan_grasps(wedge_cloud, top_view, STABLE)
    for degrees in (1.0, 90.0, 180.0, 217.0):
        xyz, turn = turned(wedge_cloud.xyz, degrees)
        after = plan_grasps(Cloud(xyz), top_view, STABLE)
        # The preferred direction has its share.
        np.testing.assert_allclose(contacts(after), contacts(before) @ turn.T, atol=0.003, err_msg=f"{degrees}")
    centre = wedge_cloud.xyz.mean(axis=0)
    clouds = [turned(wedge_cloud.xyz - centre, degrees)[0] + centre for degrees in (0.0, 40.0, 40.0, 40.0)]
    assert sum(moves_mm(clouds, top_view)) > 10.0


def test_the_contacts_face_each_other_across_the_object_also_after_a_slide(box_cloud: Cloud, top_view: Plane) -> None:
    plan = plan_grasps(box_cloud, top_view, STABLE)
    (best,) = plan.grasps
    assert plan.status == "ok"
    assert 0.053 < best.width_m < 0.07  # the points of the box span 58 mm: the contacts are near the outline
    axis, centroid = object_axis(box_cloud, top_view, STABLE)
    np.testing.assert_array_equal([axis, centroid], [plan.axis, plan.centroid])
    assert abs((best.g1 - best.g2) @ axis) < 0.01
    assert abs((best.midpoint - centroid) @ axis) < 0.005
    assert abs(np.linalg.det(best.rotation) - 1.0) < 1e-9
    slid = plan_grasps(box_cloud, top_view, STABLE, slide_m=0.03)
    assert abs((slid.grasps[0].midpoint - slid.centroid) @ slid.axis - 0.03) < 0.01
    assert plan_grasps(box_cloud, top_view, STABLE, rng=np.random.default_rng(3)).slide_m != 0.0


def test_a_held_grasp_is_kept_until_another_is_better_by_the_margin(box_cloud: Cloud, top_view: Plane) -> None:
    new = plan_grasps(box_cloud, top_view, STABLE)
    second = plan_grasps(box_cloud, top_view, STABLE, slide_m=0.01)
    kept = plan_grasps(box_cloud, top_view, STABLE, held=best(second), hold=100.0)
    np.testing.assert_array_equal(contacts(kept), contacts(second))
    assert kept.grasps[0].score < new.grasps[0].score  # on this cloud, not that of its own plan
    held = second
    for outdone in (1, 2):
        held = plan_grasps(box_cloud, top_view, STABLE, held=best(held), hold=0.0)
        np.testing.assert_array_equal(contacts(held), contacts(second))
        assert held.outdone == outdone
    # A single cloud on which another grasp is better does not count.
    assert plan_grasps(box_cloud, top_view, STABLE, held=best(held), hold=100.0).outdone == 0
    left = plan_grasps(box_cloud, top_view, STABLE, held=best(held), hold=0.0)
    np.testing.assert_array_equal(contacts(left), contacts(new))


def test_an_object_is_the_same_within_the_tolerance_of_its_first_cloud(box_cloud: Cloud, top_view: Plane) -> None:
    hold = GraspHold(0.005)
    held = best(plan_grasps(box_cloud, top_view, STABLE))
    hold.remember(box_cloud, held)
    hold.next_cloud()
    assert hold.find(box_cloud) is held
    assert hold.find(Cloud(box_cloud.xyz + np.float32([0.004, 0.0, 0.0]))) is held
    assert hold.find(Cloud(box_cloud.xyz + np.float32([0.006, 0.0, 0.0]))) is None
    assert hold.find(Cloud(box_cloud.xyz[: box_cloud.size // 2])) is None
    xyz = box_cloud.xyz.copy()  # pixels of the table at the outline make no other object
    xyz[:: len(xyz) // 40, 2] += 0.08  # 2.5 % of the points
    assert xyz[:, 2].std() - box_cloud.xyz[:, 2].std() > 0.005
    assert hold.find(Cloud(xyz)) is held
    moved = Cloud(box_cloud.xyz + np.float32([0.003, 0.0, 0.0]))  # small motions do not add up
    hold.remember(moved, held)
    hold.next_cloud()
    assert hold.find(moved).grasp is held.grasp
    assert hold.find(Cloud(moved.xyz + np.float32([0.003, 0.0, 0.0]))) is None
    hold.next_cloud()
    assert hold.find(moved) is None


def moves_mm(clouds: Iterable[np.ndarray], plane: Plane) -> list[float]:
    """How far the best grasp moves from cloud to cloud of a stream, as the `grasp` node holds it [mm]."""
    hold, before, moves = GraspHold(0.005), None, []
    for xyz in clouds:
        cloud = Cloud(xyz.astype(np.float32))
        plan = plan_grasps(cloud, plane, STABLE, held=hold.find(cloud), hold=HOLD)
        hold.remember(cloud, best(plan))
        hold.next_cloud()
        if before is not None:
            moves.append(float(np.linalg.norm(contacts(plan) - before, axis=1).max() * 1e3))
        before = contacts(plan)
    return moves


def test_in_a_still_stream_the_grasp_does_not_move(box_cloud: Cloud, top_view: Plane, rng: np.random.Generator) -> None:
    def noisy(xyz: np.ndarray) -> list[np.ndarray]:  # 1 mm of depth noise
        return [xyz + rng.normal(0.0, [0.0, 0.0, 0.001], xyz.shape) for _ in range(20)]

    assert sum(mm > 5.0 for mm in moves_mm(noisy(box_cloud.xyz), top_view)) <= 1
    x, y = np.meshgrid(np.arange(-0.05, 0.05, 0.002), np.arange(-0.05, 0.05, 0.002))
    inside = np.hypot(x, y) < 0.045
    dome = np.stack([x, y, 1.2 - np.sqrt(np.maximum(0.05**2 - x**2 - y**2, 0.0))], axis=-1)[inside]
    assert max(moves_mm(noisy(dome), top_view)) < 5.0


@pytest.mark.real_data
def test_recorded_objects_hold_still(real_data, top_view: Plane, rng: np.random.Generator) -> None:
    moved = []
    for path in sorted((real_data / "vision2tactile").glob("*/*/cloud-object.pcd"))[::25]:
        xyz = read_cloud(path).xyz.reshape(-1, 3)
        before = contacts(plan_grasps(Cloud(xyz), top_view, STABLE))
        xyz_turned, turn = turned(xyz, 1.0)
        shuffled = xyz[rng.permutation(len(xyz))]
        others = [shuffled, *(xyz + rng.normal(0.0, s, xyz.shape) for s in (1e-6, 1e-4)), xyz_turned]
        after = np.stack([contacts(plan_grasps(Cloud(one.astype(np.float32)), top_view, STABLE)) for one in others])
        after[3] = after[3] @ turn
        moved.append(np.linalg.norm(after - before, axis=2).max(axis=1) * 1e3)
    order, micrometre, tenth, degree = np.transpose(moved)
    assert (order.max(), micrometre.max() < 10.0) == (0.0, True)
    assert ((tenth > 10.0).sum() <= 1, (degree > 10.0).sum() <= 2) == (True, True)


def test_flying_points_do_not_move_the_plan(box_cloud, top_view, rng) -> None:
    xyz = box_cloud.xyz
    some = rng.random(len(xyz)) < 0.05
    flying = np.where(some[:, None], xyz * (1.0 - rng.uniform(0.01, 0.08, (len(xyz), 1))), xyz).astype(np.float32)
    marked = flying_mask(flying, STABLE.flying_share)
    assert np.count_nonzero(marked & some) > 0.85 * np.count_nonzero(some)
    assert np.count_nonzero(marked & ~some) < 0.01 * len(xyz)
    plans = [plan_grasps(Cloud(one), top_view, STABLE) for one in (xyz, flying)]
    assert "n_flying" not in plans[0].counts
    assert plans[1].counts["n_flying"] == np.count_nonzero(marked)
    assert np.linalg.norm(contacts(plans[0]) - contacts(plans[1]), axis=1).max() < 0.01
    assert "n_flying" not in plan_grasps(Cloud(flying), top_view, STABLE.replace(flying_share=1.0)).counts
