# SPDX-License-Identifier: Apache-2.0
"""Repeats keep what a model sees and draw anew what it does not."""

import numpy as np
import pytest
from sim_builders import SPONGE, scene

from foretouch.errors import ConfigError, SimulationError
from foretouch.experiments.noise_ceiling.repeats import CAUSES, NEW_OBJECT, Repeater
from foretouch.simulation.effects import EFFECTS
from foretouch.simulation.engine import Engine
from foretouch.simulation.world import SampleKey

HIDDEN = {
    "grasps": {"insertion_m": 0.012, "control": "depth", "thumb": {"depth_m": [0.001, 0.004]}, "error": {}},
    "fingers": {
        "thumb_posture": {"pitch_deg": [-10, 35]},
        "middle_posture": {"pitch_deg": [-10, 35]},
        "drift": {},
        "noise": {},
    },
}
CONFIG = scene(SPONGE, **HIDDEN)
EVERYTHING = frozenset(CAUSES)


def test_repeats_follow_from_the_sample_alone() -> None:
    first, again = (Repeater(CONFIG, EVERYTHING).repeat(0, 0, 3) for _ in range(2))
    np.testing.assert_array_equal(first.touches, again.touches)
    assert len(np.unique(first.touches, axis=0)) == 3
    assert not np.array_equal(Repeater(CONFIG, EVERYTHING).repeat(1, 0, 3).touches, first.touches)


def test_without_a_cause_all_repeats_are_the_sample() -> None:
    made = Repeater(CONFIG, frozenset()).repeat(0, 0, 3)
    sample = Engine(CONFIG, EFFECTS, ("touch", "tare")).run(SampleKey(CONFIG.seed, 0))
    np.testing.assert_array_equal(made.touches, np.tile(sample.touch.vector(), (3, 1)))
    np.testing.assert_array_equal(made.tares, np.tile(sample.tare.vector(), (3, 1)))


@pytest.mark.parametrize("cause", ["command", "posture", "placement", "sensor"])
def test_each_cause_moves_the_touch_and_only_the_sensor_the_tare(cause: str) -> None:
    made = Repeater(CONFIG, frozenset({cause})).repeat(0, 0, 4)
    assert np.ptp(made.touches, axis=0).max() > 0.0
    assert (np.ptp(made.tares, axis=0).max() > 0.0) == (cause == "sensor")


def test_what_is_hidden_are_effects_that_exist() -> None:
    assert frozenset().union(*CAUSES.values()) <= {effect.name for effect in EFFECTS}


def test_a_grasp_that_never_succeeds_again_is_named() -> None:
    """Without friction every finger slips off."""
    smooth = scene(SPONGE | {"friction": 0.0}, **HIDDEN)
    with pytest.raises(SimulationError, match="slot 0: 0 of 20 repeats succeed"):
        Repeater(smooth, EVERYTHING).repeat(0, 0, 2)


def test_a_new_object_may_be_of_any_material_of_the_scene() -> None:
    """A sponge and a hard look-alike: what is known of the object leaves less open than what is not."""
    hard = SPONGE | {"name": "hard", "young_pa": 5e6}
    both = scene(SPONGE, hard, **HIDDEN | {"fingers": {}})
    command = frozenset({"command"})
    known, new = (Repeater(both, causes).repeat(0, 0, 6) for causes in (command, command | {NEW_OBJECT}))
    assert np.ptp(new.touches, axis=0).max() > 1.5 * np.ptp(known.touches, axis=0).max()


def test_a_new_object_is_touched_on_another_day() -> None:
    days = scene(SPONGE, **HIDDEN | {"fingers": {"sessions": {}}})
    assert np.ptp(Repeater(days, EVERYTHING).repeat(0, 0, 3).tares, axis=0).max() == 0.0
    assert np.ptp(Repeater(days, frozenset({NEW_OBJECT})).repeat(0, 0, 3).tares, axis=0).max() > 1.0


def test_a_campaign_is_refused_since_no_moment_comes_twice() -> None:
    with pytest.raises(ConfigError, match="scene: campaign: grasps are repeated at one moment"):
        Repeater(scene(SPONGE, campaign={}), EVERYTHING)
