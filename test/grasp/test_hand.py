# SPDX-License-Identifier: Apache-2.0
"""Descriptions of hands, and grasps that hands with a palm can take."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from every_case import every_case
from scipy.spatial.transform import Rotation
from seen_solids import Camera, box

from foretouch.config import load_yaml
from foretouch.errors import ConfigError
from foretouch.grasp import GeoGraspConfig, HandConfig, Obstacles, plan_grasps
from foretouch.grasp.frame import PREFERRED
from foretouch.grasp.geograsp import GraspPlan
from foretouch.grasp.hand import Hand, HandDescription, hand_files, load_hand
from foretouch.tactile.description import load_sensor
from foretouch.types import Float64, Grasps
from foretouch.types.grasps import TILTS

CONFIG = GeoGraspConfig()
LOW, TALL = box(0.06, 0.09, 0.05), box(0.05, 0.08, 0.15)
HANDS = ("shadow_thumb_middle", "franka_hand", "robotiq_2f85", "robotiq_2f140", "allegro_index_thumb")


def test_hands_of_the_package() -> None:
    assert set(hand_files()) == {*HANDS, "two_tips"}

    def check(name: str) -> None:
        hand = load_hand(name)
        assert hand.config.name == name
        at = hand.at(0.05)
        np.testing.assert_allclose(at.tool[:3, :3] @ at.tool[:3, :3].T, np.eye(3), atol=1e-12)
        assert len(at.posture) == len(hand.config.joints)
        assert hand.limits_depth == (name != "two_tips")
        edges = np.linalg.norm(at.corners[:, [4, 2, 1]] - at.corners[:, :1], axis=2)
        stated = [[box.size for box in (*hand.config.boxes, *posture.boxes)] for posture in hand.config.postures]
        sizes = np.reshape(stated, (len(stated), -1)).T
        expected = [np.interp(0.05, hand.widths, row) for row in sizes]
        np.testing.assert_allclose(edges, np.reshape(expected, (-1, 3)), atol=0.006)

    every_case(list(hand_files()), check)


def test_jaws_open_by_the_width_and_palms_stay() -> None:
    jaw = load_hand("franka_hand")
    narrow, wide = jaw.at(0.02).corners, jaw.at(0.06).corners
    sides = {"finger": -0.02, "palm": 0.0, "thumb": 0.02}
    for part, one, other in zip(jaw.parts, narrow, wide, strict=True):
        np.testing.assert_allclose(other - one, np.broadcast_to([sides[part], 0.0, 0.0], (8, 3)), atol=1e-12)
    inner = {name: one[:, 0] for name, one in zip(jaw.names, wide, strict=True)}
    assert inner["left"].max() == pytest.approx(-0.03)
    assert inner["right"].min() == pytest.approx(0.03)


def _moved(xyz: tuple[float, ...], rpy: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Float64:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
    return pose


def _turned(axis: tuple[float, float, float], angle: float) -> Float64:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(np.multiply(axis, angle)).as_matrix()
    return pose


def test_postures_of_the_shadow_hand_are_those_of_its_urdf() -> None:
    """The joints of the vendor's URDF (sr_description, right hand) put the distal links where the boxes are."""
    hand = load_hand("shadow_thumb_middle")
    for width in (0.005, 0.025, 0.045, 0.065, 0.085, 0.105):
        at = hand.at(width)
        joint = dict(zip((one.name[3:] for one in hand.config.joints), at.posture.tolist(), strict=True))
        finger = _moved((0.011, 0.0, 0.099)) @ _turned((0, -1, 0), joint["MFJ4"]) @ _turned((1, 0, 0), joint["MFJ3"])
        finger = finger @ _moved((0.0, 0.0, 0.045)) @ _turned((1, 0, 0), joint["MFJ2"])
        finger = finger @ _moved((0.0, 0.0, 0.025)) @ _turned((1, 0, 0), joint["MFJ1"])
        thumb = _moved((0.034, -0.00858, 0.029), (-np.pi / 4.0, 0.0, -np.pi / 2.0)) @ _turned((0, 0, -1), joint["THJ5"])
        thumb = thumb @ _turned((0, 1, 0), joint["THJ4"]) @ _moved((0.0, 0.0, 0.038))
        thumb = thumb @ _turned((0, 1, 0), joint["THJ3"]) @ _turned((1, 0, 0), joint["THJ2"])
        thumb = thumb @ _moved((0.0, 0.0, 0.032)) @ _turned((1, 0, 0), joint["THJ1"])
        for name, link, middle_m in (("middle_distal", finger, 0.012), ("thumb_distal", thumb, 0.013)):
            expected = (at.tool @ link @ [0.0, 0.0, middle_m, 1.0])[:3]
            box = at.corners[hand.names.index(name)].mean(axis=0)
            np.testing.assert_allclose(box, expected, atol=0.001)


def test_contacts_of_the_robotiq_move_as_its_urdf_says() -> None:
    """Fingers on arcs (robotiq_description): the ends of the pads are 149.3 mm from the base when open, and 162.8 mm when closed."""
    hand = load_hand("robotiq_2f85")
    for angle in np.linspace(0.0, 0.8, 9).tolist():
        arm = np.array([0.03152616 + 0.00563134, -0.00376347 + 0.04718515])
        c, s = np.cos(angle), np.sin(angle)
        tip = np.array([0.03060114 + c * arm[0] - s * arm[1], 0.05490452 + s * arm[0] + c * arm[1]])
        width, end = 2.0 * (tip[0] - 0.0253), tip[1] + 0.051
        assert hand.at(max(width, 0.0)).tool[2, 3] == pytest.approx(hand.config.tip_radius_m - end, abs=0.001)


def test_postures_of_the_allegro_hand_are_those_of_its_urdf() -> None:
    """allegro_hand_description_right.urdf (simlabrobotics; wonik_allegro of MuJoCo Menagerie has the same): balls of 12 mm at both tips touch at the contacts."""
    hand = load_hand("allegro_index_thumb")
    for width in (0.005, 0.02, 0.035, 0.06, 0.085, 0.1):
        at = hand.at(width)
        joint = dict(zip((one.name for one in hand.config.joints), at.posture.tolist(), strict=True))
        index = _moved((0.0, 0.0435, -0.001542), (-0.08726646255, 0.0, 0.0)) @ _turned((0, 0, 1), joint["joint_0.0"])
        thumb = _moved((-0.0182, 0.019333, -0.045987), (0.0, -1.65806278845, -1.5707963259))
        thumb = thumb @ _turned((-1, 0, 0), joint["joint_12.0"]) @ _moved((-0.027, 0.005, 0.0399))
        thumb = thumb @ _turned((0, 0, 1), joint["joint_13.0"])
        for name, height_m in (("joint_1.0", 0.0164), ("joint_2.0", 0.054), ("joint_3.0", 0.0384)):
            index = index @ _moved((0.0, 0.0, height_m)) @ _turned((0, 1, 0), joint[name])
        for name, height_m in (("joint_14.0", 0.0177), ("joint_15.0", 0.0514)):
            thumb = thumb @ _moved((0.0, 0.0, height_m)) @ _turned((0, 1, 0), joint[name])
        for link, side, finger, height_m in ((index, -1.0, "index", 0.0267), (thumb, 1.0, "thumb", 0.0423)):
            ball = (at.tool @ link @ [0.0, 0.0, height_m, 1.0])[:3]
            np.testing.assert_allclose(ball, [side * (width / 2.0 + 0.012), 0.0, 0.0], atol=0.0005)
            middle = (at.tool @ link @ [0.0, 0.0, height_m / 2.0, 1.0])[:3]  # of the distal link, 19.6 x 27.5 mm
            corners = at.corners[hand.names.index(f"{finger}_distal")]
            np.testing.assert_allclose(corners.mean(axis=0), middle, atol=0.001)
            edges = np.linalg.norm(corners[[4, 2, 1]] - corners[0], axis=1)
            np.testing.assert_allclose(edges, [0.0196, 0.0275, height_m], atol=0.0005)


def test_the_fingers_of_the_wide_robotiq_move_as_its_urdf_says() -> None:
    """robotiq_description of PickNikRobotics/ros2_robotiq_gripper (BSD-3-Clause): the joints put pads, 27 x 65 x 7.5 mm, and bars where the boxes are."""
    hand = load_hand("robotiq_2f140")
    for angle in np.linspace(0.0, 0.695, 9).tolist():
        knuckle = _moved((0.0, -0.030601, 0.054905), (np.pi / 2.0 + 0.725, 0.0, 0.0)) @ _turned((-1, 0, 0), angle)
        outer = knuckle @ _moved((0.0, 0.01821998610742, 0.0260018192872234))
        inner = outer @ _moved((0.0, 0.0817554015893473, -0.0282203446692936), (-0.725, 0.0, 0.0))
        pad = inner @ _turned((1, 0, 0), angle) @ _moved((0.0, 0.0457554015893473, -0.0272203446692936))
        bar = _moved((0.0, -0.0127, 0.06142), (np.pi / 2.0 + 0.725, 0.0, 0.0)) @ _turned((-1, 0, 0), angle)
        width = -2.0 * (pad[1, 3] + 0.0075 / 2.0)
        at = hand.at(width)
        assert at.tool[2, 3] == pytest.approx(hand.config.tip_radius_m - (pad[2, 3] + 0.065 / 2.0), abs=0.001)
        half = np.array([0.027, 0.065, 0.0075]) / 2.0  # of the pad, across, along and thick
        for name, link, ends in (
            ("left_tip", pad, np.stack([-half, half])),
            ("left_inner_knuckle", bar, np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]])),  # between both of its joints
            ("left_outer_finger", outer, np.array([[0.0, 0.0, 0.0], [0.0, 0.0817554, -0.0282203]])),
        ):
            points = ends @ link[:3, :3].T + link[:3, 3]
            in_grasp = points @ at.tool[:3, :3].T + at.tool[:3, 3]
            low, high = (end(at.corners[hand.names.index(name)], axis=0) for end in (np.min, np.max))
            assert ((in_grasp > low - 0.001) & (in_grasp < high + 0.001)).all(), (angle, name)
    assert 2.0 * 0.0680 - 0.0075 - hand.config.opening_m == pytest.approx(0.004, abs=0.001)  # 2 mm on either side


def test_clearance_over_a_block() -> None:
    """A block that reaches 20 mm up from the line: 46 mm less 20 mm are left from above; a post behind it blocks the palm that tilts that way."""
    jaw = load_hand("franka_hand")
    axis = np.linspace(-0.02, 0.02, 9)
    block = np.stack(np.meshgrid(axis, axis, np.linspace(-0.02, 0.02, 9)), axis=-1).reshape(-1, 3)
    found, behind = jaw.clearance(0.04, block, np.empty((0, 3)), 0.3)
    assert found[0, 0] == pytest.approx(0.026, abs=1e-9)
    assert behind[0] == pytest.approx(0.02)
    np.testing.assert_allclose(found[0], found[1])  # jaws are the same on both sides
    post = np.stack([np.zeros(50), np.full(50, 0.06), np.linspace(-0.05, 0.3, 50)], axis=1)
    beside, _ = jaw.clearance(0.04, block, post, 0.3)
    tilt = int(np.argmax(TILTS))
    assert found[0, tilt] > 0.02
    assert beside[0, tilt] < 0.0
    assert beside[0, 0] == found[0, 0]
    ceiling = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 81), np.linspace(-0.2, 0.2, 81), [0.03]), axis=-1).reshape(
        -1, 3
    )
    assert (jaw.clearance(0.04, block, ceiling, 0.3)[0] < 0.0).all()
    assert (jaw.clearance(0.04, block, post[:0], 0.001)[0][:, np.abs(TILTS) > 1.0] < 0.0).all()  # the table


def test_a_tall_box_is_taken_from_above_near_its_top() -> None:
    """Lines at half of the height are deeper than any of these hands."""
    camera, solid = Camera(50.0), TALL
    cloud, table = camera.see(solid), camera.table()
    two = plan_grasps(cloud, table, CONFIG, hand=HandConfig()).grasps[0]

    def height(z: Float64) -> float:
        return float(camera.to_world(z[None])[0, 2])

    def check(name: str) -> None:
        plan = plan_grasps(cloud, table, CONFIG.replace(count=3), hand=HandConfig(name=name))
        hand = load_hand(name)
        for grasp in plan.grasps:
            way = grasp.way
            assert way is not None
            assert abs(way.approach @ (grasp.g2 - grasp.g1)) < 1e-9
            assert np.linalg.norm(way.approach) == pytest.approx(1.0)
            assert way.approaches.shape == (2, len(TILTS))
            at = hand.at(grasp.width_m)
            assert way.depth_m <= max(at.depth_m, hand.depths[1].max()) + 0.002
            pose = way.pose_of_hand @ np.linalg.inv(at.tool)  # the frame of the grasp
            np.testing.assert_allclose(pose[:3, 3], grasp.midpoint, atol=1e-9)
            np.testing.assert_allclose(pose[:3, 2], way.approach, atol=1e-9)
            thumb = grasp.g1 if way.thumb_at == "g1" else grasp.g2
            np.testing.assert_allclose(pose[:3, 0], (thumb - grasp.midpoint) / (grasp.width_m / 2.0), atol=1e-9)
            assert len(way.posture) == len(way.joints) == len(hand.config.joints)
        first = plan.grasps[0]
        assert first.way is not None
        assert height(first.midpoint) > height(two.midpoint) + 0.01
        both = Grasps.of([first, two])
        np.testing.assert_array_equal(both.pose_of_hand[0], first.way.pose_of_hand)
        np.testing.assert_array_equal(both.approach[0], first.way.approach)

    every_case(["franka_hand"], check)
    every_case(["robotiq_2f85"], check)


def test_a_gripper_is_not_sent_to_what_it_cannot_hold_between_its_jaws() -> None:
    """A box of 80 mm, which looks narrower: a Franka Hand opens so far that it would meet it, and other hands open farther."""
    camera, solid = Camera(50.0), box(0.08, 0.12, 0.05)
    cloud, table = camera.see(solid), camera.table()

    def plan(name: str) -> GraspPlan:
        return plan_grasps(cloud, table, CONFIG, hand=HandConfig(name=name))

    jaws = plan("franka_hand")
    assert jaws.status == "no_grasp"
    assert jaws.counts["n_too_wide"] > 0
    assert [load_hand(name).is_jaw for name in ("franka_hand", "robotiq_2f140", "shadow_thumb_middle", "two_tips")] == [
        *(True, True, False, False)
    ]
    for name in ("robotiq_2f140", "shadow_thumb_middle"):
        (grasp,) = plan(name).grasps
        assert grasp.width_m == pytest.approx(0.08, abs=0.006)


def test_the_thumb_takes_the_contact_that_is_asked_for() -> None:
    """Whichever hand it is; without a wish, two fingertips have the thumb at g1, too, as the pictures show."""
    cloud, table = Camera(50.0).see(LOW), Camera(50.0).table()
    way = plan_grasps(cloud, table, CONFIG).grasps[0].way
    assert way is not None
    assert way.thumb_at == "g1"

    def check(name: str, described: str) -> None:
        hand = HandConfig(name=described, thumb_at=name)
        plan = plan_grasps(cloud, table, CONFIG, hand=hand)
        grasp = plan.grasps[0]
        assert grasp.way is not None
        assert grasp.way.thumb_at == "g1"  # where touch models expect the sensor's first finger
        assert ((grasp.g2 - grasp.g1) @ PREFERRED > 0.0) == (name == "g1")  # left in the image, or right
        np.testing.assert_allclose(grasp.way.pose_of_hand @ np.linalg.inv(load_hand(hand.name).at(grasp.width_m).tool)
                                   @ [grasp.width_m / 2.0, 0.0, 0.0, 1.0], [*grasp.g1, 1.0], atol=1e-9)  # fmt: skip

    every_case([(side, described) for side in ("g1", "g2") for described in hand_files()], check)


def _inside_boxes(points: Float64, corners: Float64) -> bool:
    """Whether any of (N, 3) points is in one of the boxes with (B, 8, 3) corners."""
    for box_corners in corners:
        edges = box_corners[[4, 2, 1]] - box_corners[0]
        places = (points - box_corners[0]) @ edges.T / (edges * edges).sum(axis=1)
        if ((places > 0.0) & (places < 1.0)).all(axis=1).any():
            return True
    return False


def test_an_arm_that_turns_to_an_angle_said_to_be_free_meets_nothing() -> None:
    """A wall on one side of the box: at every free angle of `approaches` the boxes of the opened hand hold no point of box or wall."""
    camera = Camera(60.0)
    cloud, table = camera.see(LOW), camera.table()
    across, up = np.linspace(-0.25, 0.25, 101), np.linspace(0.005, 0.35, 70)
    around_m = np.concatenate([np.stack(np.meshgrid(across, [y], up), axis=-1).reshape(-1, 3) for y in (0.11, 0.12)])
    wall = camera.to_camera(around_m)
    around = Obstacles(wall.astype(np.float32), np.full(len(wall), 7, np.int32))
    points = np.concatenate([cloud.finite.astype(np.float64), wall])
    upwards = np.asarray(table.normal) * -np.sign(np.asarray(table.normal) @ points[0])

    def check(name: str, thumb_at: str) -> None:
        hand = load_hand(name)
        plan = plan_grasps(cloud, table, CONFIG, hand=HandConfig(name=name, thumb_at=thumb_at), obstacles=around)
        assert plan.status == "ok", plan.reason
        grasp = plan.grasps[0]
        assert grasp.way is not None
        line = (grasp.g2 - grasp.g1) / grasp.width_m
        beside = np.cross(upwards, line)
        found = {True: 0, False: 0}
        for thumb, towards in enumerate((-line, line)):  # from the middle to g1, and to g2
            for tilt, clear_m in zip(TILTS, grasp.way.approaches[thumb], strict=True):
                z = -(np.sin(tilt) * beside + np.cos(tilt) * upwards)
                frame = np.stack([towards, np.cross(z, towards), z], axis=1)
                free = bool(clear_m >= 0.0)
                found[free] += 1
                met = _inside_boxes((points - grasp.midpoint) @ frame, hand.opened(grasp.width_m))
                assert not (free and met), (
                    f"thumb at g{thumb + 1}, {np.degrees(tilt):g} degrees: {1e3 * clear_m:.0f} mm"
                )
        chosen = grasp.way.approaches[0] if grasp.way.thumb_at == "g1" else grasp.way.approaches[1]
        angle = np.degrees(np.arctan2(-grasp.way.approach @ beside, -grasp.way.approach @ upwards))
        assert chosen[np.abs(np.degrees(TILTS) - angle).argmin()] > -0.003  # where the hand was planned to come from
        blocked[name] = bool(found[False])
        assert found[True]

    blocked: dict[str, bool] = {}
    every_case([(name, side) for name in hand_files() for side in ("g1", "g2")], check)
    assert not blocked["two_tips"]
    assert sum(blocked.values()) >= 4  # all but a slim one meet the wall from some side


def test_no_way_in_is_counted_and_named() -> None:
    """Under a ceiling no hand comes from above, and between walls none from the side."""
    camera = Camera(50.0)
    cloud, table = camera.see(LOW), camera.table()
    across = np.linspace(-0.3, 0.3, 90)
    ceiling = np.stack(np.meshgrid(across, across, [0.16]), axis=-1).reshape(-1, 3)
    around = Obstacles(camera.to_camera(ceiling).astype(np.float32), np.full(len(ceiling), 7, np.int32))
    plan = plan_grasps(cloud, table, CONFIG, hand=HandConfig(name="franka_hand"), obstacles=around)
    assert plan.status == "no_grasp"
    assert plan.counts["n_blocked"] > 0
    assert "are blocked by object 7" in plan.reason
    small = HandDescription.from_mapping({**load_yaml(hand_files()["franka_hand"]), "name": "short"})
    (posture,) = small.postures
    short = small.replace(postures=(posture.replace(depth_m=0.002),))
    assert Hand(short).depths.max() == 0.002


def test_between_two_others_no_part_of_the_hand_is_in_them() -> None:
    """Walls on two sides: the boxes of the opened hand, also 5 and 10 cm back on the way in, hold none of their points."""
    camera = Camera(50.0)
    cloud, table = camera.see(LOW), camera.table()
    across, up = np.linspace(-0.12, 0.12, 49), np.linspace(0.005, 0.08, 16)
    walls = [np.stack(np.meshgrid(across, [y], up), axis=-1).reshape(-1, 3) for y in (-0.075, 0.075)]
    points = camera.to_camera(np.concatenate(walls))
    around = Obstacles(points.astype(np.float32), np.repeat([7, 8], len(points) // 2).astype(np.int32))

    def check(name: str) -> None:
        hand = load_hand(name)
        plan = plan_grasps(cloud, table, CONFIG, hand=HandConfig(name=name), obstacles=around)
        assert plan.status == "ok", plan.reason
        (grasp,) = plan.grasps
        assert grasp.way is not None
        pose = grasp.way.pose_of_hand @ np.linalg.inv(hand.at(grasp.width_m).tool)
        for back_m in (0.0, 0.05, 0.1):
            local = (points - pose[:3, 3] + back_m * pose[:3, 2]) @ pose[:3, :3]
            for corners in hand.opened(grasp.width_m):
                edges = corners[[4, 2, 1]] - corners[0]
                places = (local - corners[0]) @ edges.T / (edges * edges).sum(axis=1)
                assert not ((places > 0.0) & (places < 1.0)).all(axis=1).any()

    every_case([(name,) for name in HANDS], check)


def _described(changes: dict[str, object]) -> str:
    """A description of the Franka Hand with changes, as text."""
    stated = load_yaml(hand_files()["franka_hand"])
    for key, value in changes.items():
        group, names = stated, key.split(".")
        for name in names[:-1]:
            group = group[int(name)] if isinstance(group, list) else group[name]
        group[names[-1]] = value  # type: ignore[index]
    return yaml.safe_dump(stated)


def test_a_description_is_read_once_and_again_when_it_was_edited(tmp_path: Path) -> None:
    path = tmp_path / "hand.yaml"
    for opening_m in (0.05, 0.06):
        path.write_text(_described({"opening_m": opening_m}), encoding="utf-8")
        assert load_hand(path).config.opening_m == opening_m
        assert load_hand(path) is load_hand(str(path))


def test_a_file_named_as_a_hand_or_sensor_of_the_package_is_not_taken_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever lies in the working folder, the package can be imported and its names mean its own descriptions."""
    for name in ("two_tips", "franka_hand", "biotac_sp"):
        (tmp_path / name).write_text("hello", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code = "import foretouch; from foretouch.grasp.config import HandConfig as H; print(H().opening, H(name='franka_hand').opening)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0.1", "0.076"]
    assert load_sensor("biotac_sp").config.name == "biotac_sp"


def test_a_hand_whose_file_is_edited_or_removed_stays_as_it_was_for_the_plans_of_its_settings(tmp_path: Path) -> None:
    path = tmp_path / "hand.yaml"
    path.write_text(_described({}), encoding="utf-8")
    cloud, table = Camera(50.0).see(LOW), Camera(50.0).table()
    hand = HandConfig(name=str(path))
    before = plan_grasps(cloud, table, CONFIG, hand=hand).grasps
    for change in (lambda: path.write_text("{", encoding="utf-8"), path.unlink):
        change()
        np.testing.assert_array_equal(plan_grasps(cloud, table, CONFIG, hand=hand).grasps.g1, before.g1)
        assert hand.hand.config.name == "franka_hand"


def test_descriptions_that_break_a_rule_are_refused(tmp_path: Path) -> None:
    joint = {"name": "J1", "lower": 0.0, "upper": 1.0}

    def check(changes: dict[str, object], reason: str) -> None:
        path = tmp_path / "hand.yaml"
        path.write_text(_described(changes), encoding="utf-8")
        with pytest.raises(ConfigError) as caught:
            HandConfig(name=str(path))
        assert "hand.yaml" in str(caught.value)
        assert reason in str(caught.value)
        assert "\n" not in str(caught.value)

    cases = {
        "opens 0": ({"opening_m": 0}, "opening_m: 0.0 is below 0.005"),
        "deeper than its fingers": (
            {"postures.0.depth_m": 0.09},
            "postures[0].depth_m: 0.09 m, but the palm is 0.046 m from the line",
        ),
        "a palm of no size": ({"boxes.0.size": [0.06, 0, 0.065]}, "size[1]: 0.0 is below 0.001"),
        "outside its limits": (
            {"joints": [joint], "postures.0.angles": [1.5]},
            "postures[0].angles: J1 1.5 is outside of its limits, 0 to 1 rad",
        ),
        "joints unknown": ({"postures.0.angles": [0.5]}, "postures[0].angles: 1 of 0 joints"),
        "twice": ({"joints": [joint, joint], "postures.0.angles": [0, 0]}, "joints: J1 occurs twice"),
        "both fingers at one contact": (
            {"postures.0.boxes.2.part": "finger", "postures.0.boxes.3.part": "finger"},
            "postures[0].boxes: none is of the thumb",
        ),
        "a finger in the palm": ({"boxes.0.part": "thumb"}, "boxes: hold the palm"),
        "two numbers": ({"postures.0.xyz": [0, 0]}, "xyz: [0.0, 0.0] are not three numbers"),
        "unknown key": ({"openning_m": 0.1}, "openning_m"),
    }
    every_case(cases, check)
    (tmp_path / "text.yaml").write_text("{", encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"^{tmp_path / 'text.yaml'}: not YAML"):
        load_hand(tmp_path / "text.yaml")
    with pytest.raises(ConfigError, match="name: frank_hand: is neither a file nor one of"):
        HandConfig(name="frank_hand")


def test_a_file_that_is_no_description_is_refused_without_its_content_and_units_are_doubted(tmp_path: Path) -> None:
    secret = "root:*:20228:0:99999:7:::\nbin:*:20228\n"
    posture = "name: jaw\nopening_m: 0.08\npostures:\n- {width_m: 0.0, "
    hands = {
        "secret.yaml": (secret, "not YAML that describes a hand"),
        "secret": (secret, "is neither a file nor one of"),
        "passwd.txt": (secret, "is neither a file .* nor one of"),
        "compose.yaml": ("name: site\npassword: 20228\nservices: {a: 1}\n", "is no description of a hand, whose settings are name"),
        "empty.yaml": ("", "is no description of a hand"),
        "comment.yaml": ("# name:\n", "is no description of a hand"),
        "degrees.yaml": (posture + "rpy: [0, 0, 90]}\n", "rpy: 90 exceeds a full turn: is it in degrees"),
        "millimetres.yaml": (posture + "xyz: [0, 0, -103.4]}\n", "xyz: -103.4 is longer than a hand: is it in mm"),
        "joints.yaml": (posture + "angles: [0.1]}\njoints: [{name: a, lower: -90, upper: 90}]\n", "lower: -90 exceeds a full turn"),
        "opening.yaml": ("opening_m: 80\n", "opening_m: 80.0 is above"),
    }  # fmt: skip

    def check(name: str, text: str, rule: str) -> None:
        (tmp_path / name).write_text(text)
        for load in (load_hand, lambda path: HandConfig(name=str(path))):
            with pytest.raises(ConfigError, match=rule) as caught:
                load(tmp_path / name)
            assert "20228" not in str(caught.value)
        if "secret" in name:
            with pytest.raises(ConfigError) as caught:
                load_sensor(tmp_path / name)
            assert "20228" not in str(caught.value)

    every_case([(name, *case) for name, case in hands.items()], check)
    for long in ("h" * 5000, "h" * 5000 + ".yaml", "a\0b", "a\0b.yaml"):
        for load in (load_hand, load_sensor, lambda name: HandConfig(name=name)):
            with pytest.raises(ConfigError) as caught:
                load(long)
            assert len(str(caught.value)) < 2100
