# SPDX-License-Identifier: Apache-2.0
"""`benchmarks/grasp_physics` closes, lifts and shakes three solids of which one can work out by hand what holds."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra physics")
pytest.importorskip("trimesh", reason="needs the extra physics")

import trimesh

from benchmarks.grasp_physics import bench
from benchmarks.grasp_physics.bodies import Planned, take
from benchmarks.grasp_physics.camera import see
from benchmarks.grasp_physics.objects import GAP_M, Item, huddle, placed, read_items
from benchmarks.grasp_physics.simulation import BESIDE, HANGS, HELD, INSIDE, LIFT, OUT, SHAKE, Grip, held
from benchmarks.grasp_physics.surface import best_grasp
from foretouch.errors import FileError
from foretouch.pipeline import Pipeline

SOLIDS = {
    "box": Item("box", (trimesh.creation.box((0.06, 0.10, 0.12)),), 0.2),
    "cylinder": Item("cylinder", (trimesh.creation.cylinder(0.03, 0.12, sections=64),), 0.2),
    "sphere": Item("sphere", (trimesh.creation.icosphere(3, 0.035),), 0.1),
}
HALF = {"box": 0.03, "cylinder": 0.03, "sphere": 0.035}  # of the width along x


def stood(name: str):
    item = SOLIDS[name]
    return item, placed(item, np.eye(4), np.zeros(2))


def across(name: str, y: float = 0.0, z: float | None = None, tilt_m: float = 0.0):
    """Contacts of a line along x at (y, z), one of them higher by `tilt_m`."""
    level = stood(name)[1][2, 3] if z is None else z
    ends = np.array([[-HALF[name], y, level - tilt_m / 2.0], [HALF[name], y, level + tilt_m / 2.0]])
    return ends[0], ends[1]


@pytest.mark.parametrize("name", SOLIDS)
def test_a_grasp_through_the_middle_holds_and_needs_friction(name: str) -> None:
    item, pose = stood(name)
    grasp = across(name)
    assert held(item, pose, *grasp) == (True, True, HELD)
    assert held(item, pose, *grasp[::-1], tip_radius_m=0.0125) == (True, True, HELD)
    assert held(item, pose, *grasp, friction=0.01)[::2] == (False, LIFT)


@pytest.mark.parametrize("name", SOLIDS)
def test_twice_the_friction_of_both_tips_must_carry_the_weight(name: str) -> None:
    """2 μ F carries m g: with 5 N and friction 0.8 a weight of 8 N, less than a kilogram."""
    item, pose = stood(name)
    for mass_kg, carried in ((0.4, True), (1.2, False)):
        other = Item(name, item.parts, mass_kg)
        assert held(other, pose, *across(name)).held == carried, mass_kg


def test_a_grasp_beside_the_middle_slips_off_what_is_round() -> None:
    """At 0.8 of the radius the surface is 53° steep, more than the friction angle of 39°."""
    for name in ("cylinder", "sphere"):
        item, pose = stood(name)
        y = 0.8 * HALF[name]
        found = held(item, pose, *across(name, y))
        assert not found.held, name
        assert found.reason in {OUT, LIFT, SHAKE}


def test_a_bar_that_is_held_at_its_end_swings_down_to_the_table() -> None:
    """Its centre is 70 mm beside the line, its end 150 mm, and it is lifted by 100 mm."""
    bar = Item("bar", (trimesh.creation.box((0.04, 0.20, 0.04)),), 0.2)
    pose = placed(bar, np.eye(4), np.zeros(2))
    for y, reason in ((0.0, HELD), (0.07, HANGS)):
        grasp = np.array([-0.02, y, 0.02]), np.array([0.02, y, 0.02])
        assert held(bar, pose, *grasp).reason == reason


def test_a_grasp_that_misses_names_its_reason() -> None:
    item, pose = stood("box")
    for grasp, reason in (
        (across("box", y=0.07), BESIDE),
        (across("box", z=0.16), BESIDE),
        ((np.zeros(3), np.zeros(3)), BESIDE),
        ((np.array([0.03, 0.0, 0.06]), np.array([0.05, 0.0, 0.06])), INSIDE),
    ):
        assert held(item, pose, *grasp) == (False, False, reason)


def test_what_holds_may_be_too_wide_or_through_the_table() -> None:
    item, pose = stood("box")
    low = across("box", z=0.004)
    assert held(item, pose, *low)[:2] == (True, False)
    assert held(item, pose, *low).reason == "held, through the table"
    assert held(item, pose, *across("box"), opening_m=0.05).reason == "held, too wide"


@pytest.mark.parametrize("name", SOLIDS)
def test_the_best_grasp_on_the_true_surface_holds_and_fits_the_hand(name: str) -> None:
    item, pose = stood(name)
    assert held(item, pose, *best_grasp(item, pose, 0.008, 0.8)).strict
    larger = Item(name, tuple(part.copy().apply_scale(2.0) for part in item.parts), item.mass_kg)
    assert best_grasp(larger, placed(larger, np.eye(4), np.zeros(2)), 0.008, 0.8) is None


def test_an_image_of_the_box_leads_to_a_grasp_that_holds() -> None:
    item = SOLIDS["box"]
    for view in ("oblique", "above"):
        seen = see(item, 0, view)
        (target,) = Pipeline().segment(seen.cloud).targets
        low, high = seen.camera.to_world(target.cloud.xyz.astype(np.float64)).max(axis=0)[2], item.at(seen.pose)
        assert low == pytest.approx(high.bounds[1, 2], abs=0.006)
        contacts = bench.propose("simple rule", Pipeline(), target)
        assert contacts is not None
        assert held(item, seen.pose, *seen.camera.to_world(contacts)).strict


def test_rows_of_an_object_are_those_of_all_methods_and_are_counted_by_object(tmp_path) -> None:
    every = list(bench.rows_of(SOLIDS["sphere"], 1, conditions=((8.0, 0.8), (8.0, 0.01))))
    rows = bench.select(every, view="above")
    assert [(row["method"], row["friction"]) for row in rows] == [
        (name, friction) for name in bench.METHODS for friction in (0.8, 0.01)
    ]
    assert [row["held"] for row in rows if row["method"] == bench.RULE] == [True, False]
    assert len(bench.tables(rows)) == 4
    by_method = {line["first grasp"]: line for line in bench.by_method(bench.select(rows, friction=0.8))}
    assert [by_method[name]["above: of the best"] for name in (bench.RULE, bench.BEST)] == ["1.00", "1.00"]
    cases = list(bench.pictured(every, [SOLIDS["sphere"]]))
    assert len(cases) == len({row["reason"] for row in bench.select(every, friction=0.8)})
    bench.draw(cases, tmp_path / "grasps.png")
    assert (tmp_path / "grasps.png").stat().st_size > 5_000


def test_a_folder_of_objects_is_read_or_refused_by_name(tmp_path) -> None:
    with pytest.raises(FileError, match="holds no folder"):
        read_items(tmp_path)
    folder = tmp_path / "Brick"
    folder.mkdir()
    (folder / "collision_vhacd.obj").write_text(trimesh.exchange.obj.export_obj(SOLIDS["box"].mesh))
    (folder / "model.urdf").write_text('<robot><link><inertial><mass value=".25"/></inertial></link></robot>')
    (item,) = read_items(tmp_path)
    assert (item.name, item.mass_kg, len(item.parts)) == ("Brick", 0.25, 1)
    np.testing.assert_allclose(item.mesh.extents, (0.06, 0.10, 0.12))


@pytest.mark.slow
def test_three_objects_stand_close_together_and_apart() -> None:
    for number in range(4):
        stand = huddle(list(SOLIDS.values()), number)
        assert {item.name for item, _ in stand} == set(SOLIDS)
        feet = [item.footprint(pose) for item, pose in stand]
        gaps = [
            float(np.linalg.norm(a[:, None] - b[None], axis=2).min()) for k, a in enumerate(feet) for b in feet[k + 1 :]
        ]
        assert min(gaps) > GAP_M[0] - 0.003
        assert sorted(gaps)[1] < GAP_M[1] + 0.001  # both neighbours are near to another one
        for item, pose in stand:
            assert item.at(pose).bounds[0, 2] == pytest.approx(0.0, abs=1e-9)


def test_neighbours_that_a_grasp_carries_along_or_that_are_in_its_way_are_counted() -> None:
    """A box beside the grasped one stays; one on top of it rises with it; one where a tip or a jaw comes from is in the way."""
    item, pose = stood("box")
    other = Item("other", (trimesh.creation.box((0.03, 0.03, 0.04)),), 0.05)

    def at(x: float, y: float, z: float):
        where = placed(other, np.eye(4), np.array([x, y]))
        where[2, 3] += z
        return other, where

    frame = np.eye(4)  # jaws from above, along x, 40 mm below the top
    frame[:3, :3], frame[:3, 3] = np.stack([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]], axis=1), [0.0, 0.0, 0.085]
    for where, moved, inside, obstacle in (
        ((0.0, 0.1, 0.0), 0, False, ""),
        ((0.0, 0.0, 0.12), 1, False, "palm or arm meets a neighbour"),
        ((0.055, 0.0, 0.0), 0, True, ""),
        ((0.055, 0.0, 0.05), 0, True, "finger meets a neighbour"),
    ):
        grip = Grip(item, 0.008, 0.8, [at(*where)])
        verdict = grip.close(pose, *across("box", z=0.06 if where[2] == 0.0 else 0.07))
        assert (verdict.reason == INSIDE) == (inside and where[2] > 0.0), where
        if verdict.reason != INSIDE:
            assert (verdict.held, grip.moved()) == (True, moved), where
        taken = take(item, pose, Planned(frame, 0.06), "franka_hand", neighbours=(at(*where),))
        assert taken.reason == (obstacle or HELD), where
        assert taken.moved == 0
