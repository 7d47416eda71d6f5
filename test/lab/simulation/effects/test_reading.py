# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from sim_builders import CAN, run, scene

from foretouch_lab.simulation import fingertip
from foretouch_lab.simulation.fingertip import NOISE_ELECTRODE, WANDER_COUNTS, temperature_drift, warming

HELD = {"grasps": {"insertion_m": 0.01}}


def test_without_effects_touch_and_tare_are_the_rounded_ideal_of_the_fingers_of_the_scene() -> None:
    state, other = run(scene(**HELD)), run(scene(**HELD), slot=1)
    rest, touched = state.readings
    np.testing.assert_array_equal(state.tare["E_TH"], np.rint(rest[0, 1:]))
    np.testing.assert_array_equal(state.touch["E_MF"], np.rint(touched[1, 1:]))
    assert state.touch["PDC_MF"][0] == np.rint(touched[1, 0])
    np.testing.assert_array_equal(other.tare.values, state.tare.values)
    another = run(scene(fingers={"hand": 1}, **HELD))  # not with another seed
    assert not np.array_equal(another.tare["E_TH"], state.tare["E_TH"])


def test_a_timeline_rests_closes_holds_and_releases() -> None:
    timeline = {"rate_hz": 100, "rest_s": 0.1, "close_s": 0.05, "hold_s": 0.2}
    state = run(scene(fingers={"timeline": timeline}, **HELD))
    assert state.load.tolist() == [0.0] * 10 + [0.2, 0.4, 0.6, 0.8] + [1.0] * 20 + [0.8, 0.6, 0.4, 0.2] + [0.0] * 10
    assert state.hold_row == 33
    np.testing.assert_allclose(np.diff(state.times), 0.01)
    np.testing.assert_array_equal(state.series[0], state.readings[0])
    np.testing.assert_allclose(state.series[20], state.readings[1])


def test_a_session_moves_tare_and_touch_of_one_object_alike() -> None:
    """Slots 0 and 2 show one object, slot 1 the other."""
    plain, moved = (scene(CAN, CAN | {"name": "tin"}, fingers=fingers, **HELD) for fingers in ({}, {"sessions": {}}))
    shifts = [(run(moved, slot=k).series - run(plain, slot=k).series) for k in range(3)]
    for shift in shifts:
        np.testing.assert_allclose(shift[0], shift[1], atol=1e-9)
    np.testing.assert_allclose(shifts[0], shifts[2], atol=1e-9)
    assert np.abs(shifts[1] - shifts[0]).max() > 1.0


def test_noise_moves_tare_and_touch_apart_and_drift_the_touch_beyond_an_older_tare(monkeypatch) -> None:
    plain, noisy = run(scene(**HELD)), run(scene(fingers={"noise": {}}, **HELD))
    moved = (noisy.series - plain.series)[..., 1:]
    assert np.std(moved) == pytest.approx(np.hypot(NOISE_ELECTRODE, WANDER_COUNTS), rel=0.25)
    assert abs(np.corrcoef(moved[0].ravel(), moved[1].ravel())[0, 1]) < 0.5
    monkeypatch.setattr(fingertip, "SESSION_S", (100.0, 100.0))
    monkeypatch.setattr(fingertip, "TARE_AGE_S", (60.0, 60.0))
    config = scene(fingers={"drift": {}}, **HELD)
    warm = run(config)
    expected = temperature_drift(warming(np.array([100.0, 160.0])))
    for finger in range(2):
        np.testing.assert_allclose((warm.series - plain.series)[:, finger], expected)
    assert (expected[1] > expected[0]).all()


def test_slip_moves_the_touch_only_while_held() -> None:
    fingers = {"timeline": {"hold_s": 1.0}, "slip": {}}
    rough = CAN | {"surface": {}}
    state = run(scene(rough, fingers=fingers, **HELD))
    plain = run(scene(rough, fingers={"timeline": {"hold_s": 1.0}}, **HELD))
    moved = np.abs(state.series - plain.series).max(axis=(1, 2))
    assert moved[state.load < 1.0].max() == 0.0
    assert moved[state.hold_row] > 1.0
    path = moved[state.load == 1.0]
    assert (np.diff(path) >= -1e-9).all()


def test_dead_electrodes_say_so_and_the_others_do_not_change() -> None:
    plain = run(scene(**HELD))
    state = run(scene(fingers={"dead": {"thumb": [3], "middle": [1, 24]}}, **HELD))
    assert state.touch["E_TH"][2] == 0
    assert state.touch["E_MF"][[0, 23]].tolist() == [0, 0]
    np.testing.assert_array_equal(np.delete(state.touch["E_TH"], 2), np.delete(plain.touch["E_TH"], 2))
