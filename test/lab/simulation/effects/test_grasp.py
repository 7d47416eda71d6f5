# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from sim_builders import CAN, SPONGE, run, scene, unit

from foretouch.errors import ConfigError, ConvergenceError, SimulationError
from foretouch.grasp.hand import FINGER, THUMB, load_hand
from foretouch_lab.simulation.contact import grip
from foretouch_lab.simulation.effects import grasp

BALL = {"name": "ball", "shape": "ball", "size_m": [0.08, 0.08, 0.08]}
ABOVE = {"geograsp": {"method": "original"}}  # meets a ball above its middle


def test_pad_and_ball_meet_where_their_normals_are_opposite() -> None:
    """On the upper half of a ball the surface faces up, so it meets the pad behind its middle; the relief is a cap."""
    state = run(scene(BALL, grasps=ABOVE), "relief")
    centre = state.bodies[0].position
    for touch, pad, (_, tip), behind in zip(state.touches, state.pads, state.postures, state.relief, strict=True):
        assert np.linalg.norm(touch.origin - centre) == pytest.approx(0.04, abs=3e-5)
        outward = unit(touch.origin - centre)
        assert outward @ -touch.normal > np.cos(0.08)  # the search steps by 1 mm on a radius of 40
        np.testing.assert_allclose(tip @ pad.frame.rotation, touch.rotation, atol=1e-12)
        assert touch.normal[2] < -0.1  # pressed down onto the slope
        assert pad.frame.origin[0] > 1e-3  # x is towards the tip, which points down
        local = (centre - touch.origin) @ touch.rotation
        square = 0.04**2 - (pad.x - local[0]) ** 2 - (pad.y - local[1]) ** 2
        np.testing.assert_allclose(behind, local[2] - np.sqrt(square), atol=5e-5)


def test_the_relief_has_its_height_and_a_posture_moves_the_contact_over_the_pad() -> None:
    rough = CAN | {"surface": {}}
    plain = [run(scene(), "relief", slot=slot).relief for slot in range(8)]
    heights = [run(scene(rough), "surface", slot=slot).relief - plain[slot] for slot in range(8)]
    assert np.std(heights) == pytest.approx(2e-4, rel=0.25)
    again = run(scene(rough, grasps={"thumb": {"force_n": [2.0, 2.0]}}), "surface", slot=5)
    np.testing.assert_array_equal(again.relief - plain[5], heights[5])
    postures = ({"thumb_posture": {"pitch_deg": [pitch, pitch]}} for pitch in (-20.0, 0.0, 20.0))
    places = [run(scene(BALL, fingers=fingers), "relief").pads[0].frame.origin[0] for fingers in postures]
    assert places == sorted(places)


def test_fingertips_take_the_posture_of_the_hand_that_a_scene_names() -> None:
    """The pads of the Shadow Hand's description are off the line as its kinematics say, and no others than by its two fingers' own tips."""
    hand = load_hand("shadow_thumb_middle")
    tin = CAN | {"size_m": [0.05, 0.05, 0.06]}
    plain, posed = (run(scene(tin, **named), "contact") for named in ({}, {"hand": "shadow_thumb_middle"}))
    for state, low, high in ((plain, -1e-6, 1e-6), (posed, 20.0, 45.0)):
        for finger, (_, tip) in zip(state.fingers, state.postures, strict=True):
            assert low <= np.degrees(np.arccos(np.clip(finger.normal @ -tip[:, 2], -1.0, 1.0))) <= high
            np.testing.assert_allclose(tip.T @ tip, np.eye(3), atol=1e-12)
    x = unit(posed.fingers[0].origin - posed.fingers[1].origin)  # to the thumb, which takes g1
    z = scene(tin).camera.view().R_world_camera @ posed.grasp.way.approach
    axes = np.column_stack([x, np.cross(z, x), z])
    for part, (_, tip) in zip((THUMB, FINGER), posed.postures, strict=True):
        np.testing.assert_allclose(tip, axes @ hand.fingertip(part, posed.grasp.width_m), atol=1e-9)
    for side in (0, 1):  # the tip of the finger touches, not the middle of its pad
        assert posed.pads[side].frame.origin[0] > plain.pads[side].frame.origin[0] + 1e-3


def test_a_gripper_presses_with_pads_that_face_each_other_and_an_unknown_hand_is_refused() -> None:
    plain, posed = (
        run(scene(CAN | {"size_m": [0.05, 0.05, 0.06]}, **named), "posture") for named in ({}, {"hand": "franka_hand"})
    )
    for state in (plain, posed):
        np.testing.assert_allclose(
            [finger.normal @ tip[:, 2] for finger, (_, tip) in zip(state.fingers, state.postures, strict=True)], -1.0
        )
    with pytest.raises(ConfigError, match="hand: shadow_thumb: is neither a file nor one of"):
        scene(CAN, hand="shadow_thumb")


def test_the_execution_error_moves_both_fingers_as_one_hand() -> None:
    config = scene(BALL, grasps={"error": {"position_m": 0.002, "angle_deg": 3.0}})
    shifts = []
    for slot in range(16):
        before, after = (run(one, "execution_error", slot=slot).fingers for one in (scene(BALL), config))
        width = [np.linalg.norm(a.origin - b.origin) for a, b in (before, after)]
        assert width[0] == pytest.approx(width[1])
        shift = (after[0].origin + after[1].origin - before[0].origin - before[1].origin) / 2.0
        assert abs(shift @ before[0].normal) < 1e-12  # only in the tangent plane
        shifts.append(shift)
    assert np.sqrt(np.mean(np.sum(np.square(shifts), axis=1))) == pytest.approx(0.002 * np.sqrt(2), rel=0.4)


def test_a_finger_that_finds_no_hold_and_a_solver_that_fails_are_named(monkeypatch) -> None:
    with pytest.raises(SimulationError, match="ball: the thumb closes beside the object") as caught:
        run(scene(BALL, grasps={"insertion_m": 0.12}))
    assert caught.value.reason == "misses"
    with pytest.raises(SimulationError, match=r"friction holds 0\.05") as caught:
        run(scene(BALL | {"friction": 0.05}, grasps=ABOVE))
    assert caught.value.reason == "slips"

    def fail(*_: object) -> None:
        raise ConvergenceError("elastic layer: no convergence")

    monkeypatch.setitem(grip._SOLVERS, "layer", fail)
    run(scene(CAN))  # rigid objects take the bed of springs
    with pytest.raises(SimulationError, match=r"sponge: contact: elastic layer: no convergence") as caught:
        run(scene(SPONGE))
    assert caught.value.reason == "not_converged"


def test_fingers_press_as_commanded_by_force_and_by_depth() -> None:
    for item in (CAN, SPONGE):
        config = scene(item, grasps={"thumb": {"force_n": [1.5, 3.0]}, "insertion_m": 0.01})
        for slot in range(4):
            state = run(config, "contact", slot=slot)
            assert [contact.force_n for contact in state.contacts] == pytest.approx([state.target] * 2, rel=1e-3)
    config = scene(grasps={"control": "depth", "thumb": {"depth_m": [0.0002, 0.0003]}, "insertion_m": 0.01})
    state = run(config, "contact")
    thumb, middle = state.contacts
    assert thumb.depth_m + middle.depth_m == pytest.approx(2.0 * state.target, rel=1e-4)
    assert thumb.force_n == pytest.approx(middle.force_n, rel=1e-3)


def test_weight_loads_one_finger_more_and_too_much_of_it_falls() -> None:
    state = run(scene(CAN | {"mass_kg": 0.05}, gravity={}, grasps={"insertion_m": 0.01}), "contact")
    difference = state.contacts[1].force_n - state.contacts[0].force_n
    assert difference == pytest.approx(state.axial_load_n, abs=2e-3)
    across = np.linalg.norm(state.tangential_n.sum(axis=0))
    assert np.hypot(across, state.axial_load_n) == pytest.approx(0.05 * grasp._GRAVITY_M_S2, rel=1e-6)
    with pytest.raises(SimulationError, match=r"its weight slips through|opens a grip") as caught:
        run(scene(CAN | {"mass_kg": 2.0}, gravity={}))
    assert caught.value.reason in {"falls", "contact"}
