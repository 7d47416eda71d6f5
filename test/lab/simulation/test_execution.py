# SPDX-License-Identifier: Apache-2.0
"""A trajectory against the readings of the same grasp in a data set, and against what the settings promise."""

from dataclasses import replace

import numpy as np
import pytest
from sim_builders import CAN, EVERY_FINGER_EFFECT, SPONGE, run, scene

from benchmarks.simulation.validate import steady_noise
from foretouch.types import Grasp
from foretouch_lab.simulation import fingertip
from foretouch_lab.simulation.execution import GraspTimingConfig, GraspTrajectory, SimulatedHand
from foretouch_lab.simulation.scene import SceneConfig

TIMING = GraspTimingConfig(rest_s=0.4, approach_s=0.3, close_s=0.2, hold_s=0.5)


def planned(config: SceneConfig, slot: int = 0) -> Grasp:
    return run(config, "grasp", slot=slot).grasp


def executed(config: SceneConfig, slot: int = 0, repeat: int = 0) -> GraspTrajectory:
    return SimulatedHand(config, TIMING).execute(planned(config, slot), slot, repeat)


def test_phases_come_when_they_are_due_and_pressure_rises_and_falls_with_them() -> None:
    found = executed(scene())
    assert found.success
    assert (found.start, found.onset, found.contact, found.release) == (40, 70, 89, 139)
    phases = [found.phase(k) for k in range(len(found.counts))]
    lengths = {"rest": 40, "approach": 30, "contact": 19, "hold": 50, "release": len(phases) - 139}
    assert phases == [name for name, length in lengths.items() for _ in range(length)]
    pdc = found.counts[:, :, 0].astype(int)
    assert (pdc[found.onset] > pdc[0]).all()
    assert (np.diff(pdc[: found.contact + 1], axis=0) >= 0).all()
    np.testing.assert_array_equal(found.counts[-1], found.counts[0])


def test_the_hold_reads_what_the_data_set_says_of_this_grasp() -> None:
    for item in (CAN, SPONGE):
        config = scene(item)
        sample = run(config, slot=2)
        found = executed(config, slot=2)
        spans = (slice(0, found.onset), sample.tare), (slice(found.contact, found.release), sample.touch)
        for rows, expected in spans:
            counts = found.counts[rows]
            assert (counts == counts[0]).all()
            np.testing.assert_array_equal(counts[0, :, 0], [expected["PDC_TH"][0], expected["PDC_MF"][0]])
            np.testing.assert_array_equal(counts[0, :, 1:], [expected["E_TH"], expected["E_MF"]])


def test_a_hand_with_taxels_reads_what_the_data_set_says_and_a_press_moves_only_the_normal_force_of_one_finger() -> (
    None
):
    config = scene(CAN, fingers={"sensor": "xela_uskin_4x4", "drift": {}})
    quiet = scene(CAN, fingers={"sensor": "xela_uskin_4x4"})
    sample, found = run(quiet), executed(quiet)
    columns = sample.touch.channels.finger_columns.values()
    for row, expected in ((0, sample.tare), (found.contact, sample.touch), (-1, sample.tare)):
        np.testing.assert_array_equal(found.counts[row], [expected.values[column] for column in columns])
    hand = SimulatedHand(quiet, TIMING)
    assert hand.sensor.config.name == "xela_uskin_4x4"
    np.testing.assert_array_equal(hand.rest(3)[2], found.counts[0])
    press = hand.press(1).reshape(3, 16)  # X, Y, Z
    assert not press[:2].any()
    assert (press[2] > 1000.0).all()
    assert (SimulatedHand(config, TIMING).rest(1, elapsed_s=3600.0) != found.counts[0]).mean() > 0.9  # it has warmed


def test_the_sensor_adds_only_what_the_scene_calls_for_and_each_time_anew() -> None:
    quiet, noisy = scene(SPONGE), scene(SPONGE, fingers={"timeline": {}, "noise": {}, "scan": {}})
    assert (executed(quiet, repeat=1).counts == executed(quiet, repeat=2).counts).all()
    first, second = executed(noisy, repeat=1), executed(noisy, repeat=2)
    assert (first.counts != second.counts).mean() > 0.5
    np.testing.assert_array_equal(executed(noisy, repeat=1).counts, first.counts)
    hold = first.counts[first.contact : first.release].mean(axis=0)
    clean = executed(quiet).counts[first.contact]
    np.testing.assert_allclose(hold, clean, atol=5 * 4.6 / np.sqrt(8))  # 0.5 s hold about eight independent values


def test_resting_fingers_are_as_noisy_as_real_ones() -> None:
    hand = SimulatedHand(scene(fingers={"timeline": {}, "noise": {}, "scan": {}}), TIMING)
    counts = hand.rest(3080, repeat=5)[..., 1:].astype(float)
    noise = steady_noise(counts.reshape(11, 280, -1))  # as long as the 22 recordings of a sensor in steady touch
    assert noise.sd == pytest.approx(4.4, abs=0.5)
    assert noise.repeated == pytest.approx(0.35, abs=0.05)
    assert noise.lag1 == pytest.approx(0.38, abs=0.08)
    read = np.array([hand.read(0.0) for _ in range(250)])
    assert (read[:200] != read[50:]).mean() > 0.5  # each new


def test_drift_goes_on_with_the_time_since_switch_on_and_does_not_jump_at_contact(monkeypatch) -> None:
    monkeypatch.setattr(fingertip, "SESSION_S", (0.0, 0.0))
    hand = SimulatedHand(scene(fingers={"drift": {}}), TIMING)
    cold, warm = (hand.rest(1, elapsed_s=t)[0].astype(int) for t in (0.0, 600.0))
    rise = 3.0 * (1.0 - np.exp(-1.0))  # K after one time constant
    assert np.ptp(warm[:, 0] - cold[:, 0] - round(8.0 * rise)) <= 1
    np.testing.assert_allclose(warm[:, 1:] - cold[:, 1:], 12.0 * rise, atol=1.0)
    found = hand.execute(planned(hand.scene), 0, elapsed_s=600.0)
    np.testing.assert_allclose(found.counts[0], warm, atol=1)
    np.testing.assert_allclose(found.counts[-1], warm, atol=1)


def test_a_hand_goes_where_it_is_sent_but_for_insertion_and_error() -> None:
    config = scene(grasps={"insertion_m": 0.01})
    grasp, found = planned(config), executed(config)
    np.testing.assert_allclose(found.rotation, grasp.rotation, atol=1e-9)
    np.testing.assert_allclose(found.midpoint - grasp.midpoint, [0.0, 0.0, 0.01], atol=1e-9)  # seen from above
    config = scene(SPONGE, grasps={"error": {"position_m": 0.002, "angle_deg": 2.0}}, fingers=EVERY_FINGER_EFFECT)
    one, other = executed(config, repeat=1), executed(config, repeat=2)
    assert np.linalg.norm(one.midpoint - other.midpoint) > 1e-4
    for found in (one, other):
        np.testing.assert_allclose(found.rotation.T @ found.rotation, np.eye(3), atol=1e-9)
        assert np.linalg.det(found.rotation) == pytest.approx(1.0)
        assert found.success
        assert (found.counts[:, 0, 3] == 0).all()  # the dead electrode


def test_a_hand_that_closes_beside_the_object_reads_its_rest_and_says_why() -> None:
    config = scene()
    grasp = planned(config)
    aside = np.array([0.3, 0.0, 0.0])
    away = replace(grasp, g1=grasp.g1 + aside, g2=grasp.g2 + aside)
    found = SimulatedHand(config, TIMING).execute(away, 0)
    assert (found.success, found.reason, found.contact) == (False, "misses", None)
    assert "closes beside the object" in found.message
    assert (found.counts == found.counts[0]).all()
    wide = replace(grasp, g2=grasp.g1 + aside)
    assert SimulatedHand(config, TIMING).execute(wide, 0).reason == "too_wide"
