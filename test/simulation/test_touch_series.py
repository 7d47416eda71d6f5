# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from sim_builders import run, scene

from foretouch.errors import SimulationError
from foretouch.simulation.simulate import Simulation
from foretouch.simulation.touch_series import PHASES, TouchSeriesMaker

TIMELINE = {"rate_hz": 100.0, "rest_s": 0.1, "close_s": 0.05, "hold_s": 0.2}


def test_the_phases_follow_each_other_as_long_as_they_are_asked_to() -> None:
    series = TouchSeriesMaker(scene(fingers={"timeline": TIMELINE})).series(0)
    assert [PHASES[p] for p in dict.fromkeys(series.phases.tolist())] == list(PHASES)
    assert np.bincount(series.phases).tolist() == [10, 4, 20, 4, 10]
    assert series.times_s[-1] == pytest.approx(0.47)
    assert PHASES[series.phases[series.touch_row]] == "hold"
    assert series.pdc[series.touch_row].min() > series.pdc[0].min()


def test_a_data_sets_sample_is_read_out_of_the_series() -> None:
    config = scene(fingers={"timeline": TIMELINE, "noise": {}, "scan": {}, "creep": {}})
    series = TouchSeriesMaker(config).series(2)
    sample = list(Simulation(config).samples(3))[2].sample
    assert sample.touch is not None
    assert sample.tare is not None
    np.testing.assert_array_equal(sample.touch.e_th, series.electrodes[series.touch_row, 0])
    assert sample.touch.pdc_mf == series.pdc[series.touch_row, 1]
    np.testing.assert_array_equal(sample.tare.e_mf, np.median(series.electrodes[series.phases == 0, 1], axis=0))
    np.testing.assert_array_equal(sample.grasp.g1, series.grasp.g1)


def test_a_scene_without_a_timeline_gets_one_and_the_same_grasp() -> None:
    config = scene()
    series = TouchSeriesMaker(config).series(1)
    touch = run(config, "touch", slot=1).touch
    assert len(series.times_s) > 50
    np.testing.assert_array_equal(series.electrodes[series.touch_row, 0], touch.e_th)


def test_a_grasp_that_fails_is_named() -> None:
    with pytest.raises(SimulationError, match="closes beside the object"):
        TouchSeriesMaker(scene(grasps={"insertion_m": 0.15})).series(0)
