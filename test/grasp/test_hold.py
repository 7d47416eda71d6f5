# SPDX-License-Identifier: Apache-2.0
"""The best grasp of an object is held from cloud to cloud of a stream."""

from collections.abc import Iterable

import numpy as np
from seen_solids import Camera, ball, box, can

from foretouch.grasp import GeoGraspConfig, GraspHold, GraspPlan, HandConfig, HeldGrasp, plan_grasps
from foretouch.types import Cloud, Float64, Plane

CONFIG = GeoGraspConfig()
HOLD = 2.0  # default of `grasp_hold`


def contacts(plan: GraspPlan) -> Float64:
    return np.stack([plan.grasps[0].g1, plan.grasps[0].g2])


def best(plan: GraspPlan) -> HeldGrasp:
    return plan.grasps[0], plan.outdone


def test_a_held_grasp_is_kept_until_another_is_better_by_the_margin(box_cloud: Cloud, top_view: Plane) -> None:
    new = plan_grasps(box_cloud, top_view, CONFIG)
    second = plan_grasps(box_cloud, top_view, CONFIG, slide_m=0.01)
    kept = plan_grasps(box_cloud, top_view, CONFIG, held=best(second), hold=100.0)
    np.testing.assert_array_equal(contacts(kept), contacts(second))
    assert kept.grasps[0].score < new.grasps[0].score  # on this cloud, not that of its own plan
    held = second
    for outdone in (1, 2):
        held = plan_grasps(box_cloud, top_view, CONFIG, held=best(held), hold=0.0)
        np.testing.assert_array_equal(contacts(held), contacts(second))
        assert held.outdone == outdone
    # A single cloud on which another grasp is better does not count.
    assert plan_grasps(box_cloud, top_view, CONFIG, held=best(held), hold=100.0).outdone == 0
    left = plan_grasps(box_cloud, top_view, CONFIG, held=best(held), hold=0.0)
    np.testing.assert_array_equal(contacts(left), contacts(new))


def test_a_held_grasp_takes_the_place_of_its_twin_and_no_better_grasp_is_lost() -> None:
    """Whichever of the planned grasps was held, the answer has it first and once, then the others best first, five in all."""
    camera, config = Camera(55.0), CONFIG.replace(count=5)
    cloud, table = camera.see(box(0.05, 0.08, 0.1), yaw=0.3), camera.table()
    new = plan_grasps(cloud, table, config.replace(count=6)).grasps
    for k in range(5):
        kept = plan_grasps(cloud, table, config, held=(new[k], 0), hold=1000.0).grasps
        both = np.maximum(*(np.linalg.norm(ends - ends[k], axis=1) for ends in (new.g1, new.g2)))
        others = np.flatnonzero(both >= 0.01)
        np.testing.assert_array_equal(kept.g1, np.vstack([new.g1[k], new.g1[others][:4]]))
        np.testing.assert_array_equal(kept.score[1:], new.score[others][:4])
        assert len(kept) == 5 or len(others) < 4


def test_an_object_is_the_same_within_the_tolerance_of_its_first_cloud(box_cloud: Cloud, top_view: Plane) -> None:
    hold = GraspHold(0.005)
    held = best(plan_grasps(box_cloud, top_view, CONFIG))
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
    assert hold.find(moved)[0] is held[0]
    assert hold.find(Cloud(moved.xyz + np.float32([0.003, 0.0, 0.0]))) is None
    hold.next_cloud()
    assert hold.find(moved) is None


def moves_mm(clouds: Iterable[np.ndarray], plane: Plane) -> list[float]:
    """How far the best grasp moves from cloud to cloud of a stream, as the `grasp` node holds it [mm]."""
    hold, before, moves = GraspHold(0.005), None, []
    for xyz in clouds:
        cloud = Cloud(xyz.astype(np.float32))
        plan = plan_grasps(cloud, plane, CONFIG, held=hold.find(cloud), hold=HOLD)
        hold.remember(cloud, best(plan))
        hold.next_cloud()
        if before is not None:
            moves.append(float(np.linalg.norm(contacts(plan) - before, axis=1).max() * 1e3))
        before = contacts(plan)
    return moves


def test_in_a_still_stream_the_grasp_does_not_move(rng: np.random.Generator) -> None:
    camera = Camera(55.0)

    def noisy(cloud: Cloud) -> list[np.ndarray]:  # a millimetre of depth noise
        xyz = cloud.xyz.reshape(-1, 3)
        xyz = xyz[np.isfinite(xyz).all(axis=1)]
        return [xyz * (1.0 + rng.normal(0.0, 0.001, (len(xyz), 1))) for _ in range(12)]

    for solid in (box(0.05, 0.08, 0.15), can(0.033, 0.12), ball(0.035)):
        assert max(moves_mm(noisy(camera.see(solid, yaw=0.3)), camera.table())) < 5.0


def test_a_held_grasp_that_the_hand_cannot_execute_any_more_is_left() -> None:
    """Its line has no score, and no other is executable: no grasp is published."""
    camera = Camera(55.0)
    cloud = camera.see(box(0.05, 0.08, 0.05))
    plan = plan_grasps(cloud, camera.table(), CONFIG)
    high = HandConfig(clearance_m=0.1)
    none = plan_grasps(cloud, camera.table(), CONFIG, held=best(plan), hold=100.0, hand=high)
    assert (none.status, len(none.grasps)) == ("no_grasp", 0)
