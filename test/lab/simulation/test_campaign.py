# SPDX-License-Identifier: Apache-2.0
"""Campaigns: the calendar, and what becomes of the sensors, against the settings that state it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sim_builders import CAN, SPONGE, made, run, scene

from foretouch.errors import ConfigError, SimulationError
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC, tdc_of
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.prequential import TimedReadings, replay
from foretouch_lab.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch_lab.learning.training.tracker import fit_tracker
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.execution import SimulatedHand
from foretouch_lab.simulation.fingertip import TDC_REST, temperature_drift, warming
from foretouch_lab.simulation.scene import campaign as calendar
from foretouch_lab.simulation.scene import load_scene
from foretouch_lab.simulation.scene.campaign import CHANGE_S, GRASP_S, POWER_ON_S
from foretouch_lab.simulation.simulate import explain_scene
from foretouch_lab.simulation.world import Campaign, SampleKey, World, object_index

SCENES = Path(__file__).parents[3] / "config" / "scenes"
HELD = {"grasps": {"insertion_m": 0.01}}
BOX = {"name": "box", "shape": "box", "size_m": [0.06, 0.09, 0.07]}
QUIET = {"hand_counts": 0.0, "finger_counts": 0.0, "electrode_counts": 0.0, "pdc_counts": 0.0}
NOW = np.zeros(1)


def campaign(seed: int = 0, **settings: Any) -> Campaign:
    config = scene(CAN, BOX, SPONGE, seed=seed, campaign=settings, camera={"width": 64, "height": 48})
    found = World.of(config).campaign
    assert found is not None
    return found


def drift_at(found: Campaign, *slots: int, load: float = 0.0) -> np.ndarray:
    """(slots, 2, 25) counts."""
    return np.stack([found.drift(found.time_of(slot), NOW, np.array([load]))[0] for slot in slots])


def test_a_campaign_without_effects_changes_no_reading() -> None:
    for one, other in zip(made(scene(CAN, **HELD), 2), made(scene(CAN, campaign={}, **HELD), 2), strict=True):
        assert one.stamp_ns == 0 < other.stamp_ns
        assert "session" not in one.extra
        np.testing.assert_array_equal(one.cloud.xyz, other.cloud.xyz)
        np.testing.assert_array_equal(one.touch.values, other.touch.values)  # type: ignore[union-attr]
        np.testing.assert_array_equal(one.tare.values, other.tare.values)  # type: ignore[union-attr]


def test_sessions_start_when_they_are_due_and_tares_are_recorded_where_it_is_stated() -> None:
    found = campaign(days=[0, 1.5, 7], objects=2, grasps=3)
    times = [found.time_of(slot) for slot in range(18)]
    seconds = np.array([time.stamp_ns for time in times]) * 1e-9
    np.testing.assert_allclose(seconds[::6] - seconds[0], np.array([0, 1.5, 7]) * 86400)
    assert {time.powered_s for time in times[::6]} == {POWER_ON_S}
    pauses = np.diff(seconds.reshape(3, 2, 3), axis=2)
    assert ((pauses >= GRASP_S[0]) & (pauses <= GRASP_S[1])).all()
    changes = seconds[3::6] - seconds[2::6]
    assert ((changes >= GRASP_S[0] + CHANGE_S[0]) & (changes <= GRASP_S[1] + CHANGE_S[1])).all()
    assert [time.session for time in times] == [0] * 6 + [1] * 6 + [2] * 6
    assert [time.visit for time in times] == np.repeat(range(6), 3).tolist()
    with pytest.raises(SimulationError, match="slot 18: the campaign has 18 grasps"):
        found.time_of(18)
    for tares, kept in {"grasp": [*range(8)], "object": [0, 2, 4, 6], "session": [0, 4], "none": []}.items():
        settings = {"days": [0, 1], "objects": 2, "grasps": 2, "tares": tares}
        samples = made(scene(CAN, campaign=settings, **HELD), 8)
        assert [k for k, sample in enumerate(samples) if sample.tare is not None] == kept, tares


def test_objects_take_turns_by_visits_and_keep_their_surface() -> None:
    config = scene(CAN, BOX, SPONGE, campaign={"days": [0, 1, 2, 3], "objects": 3, "grasps": 5})
    visits = np.array([object_index(config, slot) for slot in range(60)]).reshape(12, 5)
    assert (visits == visits[:, :1]).all()
    turns = visits[:, 0].reshape(4, 3)
    assert (np.sort(turns, axis=1) == [0, 1, 2]).all()
    assert len({tuple(turn) for turn in turns.tolist()}) > 1  # in another order
    assert [object_index(scene(CAN, BOX), slot) for slot in range(4)] == [0, 1, 0, 1]


def test_samples_carry_stamp_object_and_place_in_the_campaign() -> None:
    config = scene(CAN, BOX, campaign={"days": [0, 1], "objects": 2, "grasps": 2}, **HELD)
    samples = made(config, 8)
    assert (np.diff([sample.stamp_ns for sample in samples]) > 40_000_000_000).all()
    assert [sample.extra["session"] for sample in samples] == [0, 0, 0, 0, 1, 1, 1, 1]
    assert [sample.extra["visit"] for sample in samples] == [0, 0, 1, 1, 2, 2, 3, 3]
    objects = [config.objects[object_index(config, slot)].name for slot in range(8)]
    assert [sample.id for sample in samples] == [f"{name}/{slot:06d}" for slot, name in enumerate(objects)]
    with pytest.raises(ConfigError, match=r"campaign: 9 grasps exceed its 8"):
        made(config, 9)


def test_a_repeated_grasp_is_the_one_before_executed_again() -> None:
    """On the same cloud and later, with other errors of the hand and the sensor; the others stay as they are."""
    held: dict[str, Any] = {"grasps": {"insertion_m": 0.01, "error": {}}, "fingers": {"noise": {}}}
    settings = {"days": [0, 1], "objects": 1, "grasps": 5, "drift": [{}]}
    config = scene(CAN, campaign=settings | {"repeat_every": 3}, **held)
    found, plain = made(config, 10), made(scene(CAN, campaign=settings, **held), 10)
    for slot, (sample, other) in enumerate(zip(found, plain, strict=True)):
        assert (sample.id, sample.stamp_ns) == (other.id, other.stamp_ns) == (f"can/{slot:06d}", sample.stamp_ns)
        if slot not in (2, 7):
            assert "repeat" not in sample.extra
            np.testing.assert_array_equal(sample.touch.values, other.touch.values)  # type: ignore[union-attr]
            continue
        before = found[slot - 1]
        np.testing.assert_array_equal(sample.cloud.xyz, before.cloud.xyz)
        np.testing.assert_array_equal(sample.grasp.g1, before.grasp.g1)
        change = np.abs(sample.touch.values - before.touch.values)  # type: ignore[union-attr]
        assert 0.0 < change.mean() < np.abs(other.touch.values - before.touch.values).mean()  # type: ignore[union-attr]
        key = SampleKey(0, *(int(sample.extra[name]) for name in ("slot", "attempt", "repeat")))
        assert key.slot == slot - 1
        np.testing.assert_array_equal(Engine(config, EFFECTS).run(key).touch.values, sample.touch.values)  # type: ignore[union-attr]


LONG = {"days": [0, 5, 10, 20, 40], "objects": 1, "grasps": 1}


def test_drift_has_the_stated_variance_memory_and_shares() -> None:
    """48 electrodes of 40 seeds are 1920 independent paths: the standard error of a correlation is below .03."""
    term = QUIET | {"memory_days": 10, "electrode_counts": 30.0}
    found = np.stack([drift_at(campaign(seed, **LONG, drift=[term]), *range(5))[..., 1:] for seed in range(40)])
    paths = np.moveaxis(found, 1, -1).reshape(-1, 5)
    np.testing.assert_allclose(paths.std(axis=0), 30.0, rtol=0.06)
    np.testing.assert_allclose(paths.mean(axis=0), 0.0, atol=4 * 30.0 / np.sqrt(len(paths)))
    expected = np.exp(-np.abs(np.subtract.outer(LONG["days"], LONG["days"])) / 10.0)
    np.testing.assert_allclose(np.corrcoef(paths.T), expected, atol=0.09)
    # Variances 16, 9 and 4: within a finger 25 of 29 is shared, across 16 of 29; PDC is on its own.
    term = {"memory_days": 0.5, "hand_counts": 4.0, "finger_counts": 3.0, "electrode_counts": 2.0, "pdc_counts": 5.0}
    weeks = {"days": list(range(0, 100, 2)), "objects": 1, "grasps": 1}  # sessions that have forgotten each other
    found = np.concatenate([drift_at(campaign(seed, **weeks, drift=[term]), *range(50)) for seed in range(10)])
    correlation = np.corrcoef(found.reshape(-1, 50).T)
    thumb, middle = slice(1, 25), slice(26, 50)
    within = correlation[thumb, thumb][np.triu_indices(24, 1)]
    assert np.mean(within) == pytest.approx(25 / 29, abs=0.02)
    assert np.mean(correlation[thumb, middle]) == pytest.approx(16 / 29, abs=0.06)
    assert abs(correlation[0, 25]) < 0.12  # three standard errors
    assert np.abs(correlation[0, thumb]).mean() < 0.12
    np.testing.assert_allclose(found[:, :, 0].std(), 5.0, rtol=0.08)
    np.testing.assert_allclose(found[:, :, 1:].std(), np.sqrt(29.0), rtol=0.08)


def test_drift_is_a_function_of_time_and_seed_and_its_terms_add_up() -> None:
    settings: dict[str, Any] = {"objects": 2, "grasps": 5, "drift": [{}, {"memory_days": 0.05}]}
    first = drift_at(campaign(**settings, days=[0, 3]), *range(20))
    backward = drift_at(campaign(**settings, days=[0, 3]), *range(19, -1, -1))[::-1]
    np.testing.assert_array_equal(first, backward)
    np.testing.assert_array_equal(first, drift_at(campaign(**settings, days=[0, 3, 30]), *range(20)))
    assert not np.array_equal(first, drift_at(campaign(1, **settings, days=[0, 3]), *range(20)))
    slow, in_contact = {"memory_days": 10}, {"memory_days": 0.05, "in_contact": True}
    single, both = campaign(**LONG, drift=[slow]), campaign(**LONG, drift=[slow, in_contact])
    np.testing.assert_array_equal(drift_at(both, 0, 3), drift_at(single, 0, 3))  # at rest
    assert np.abs(drift_at(both, 3, load=1.0) - drift_at(single, 3)).max() > 1.0


def test_warm_up_decays_after_each_power_on() -> None:
    warm_up = {"warming_s": 500, "body_kelvin": 2}
    config = scene(CAN, campaign={"days": [0, 1], "objects": 1, "grasps": 20, "warm_up": warm_up}, **HELD)
    for slot in (0, 1, 19, 20, 39):
        state = run(config, slot=slot)
        rise = 2.0 * (1.0 - np.exp(-state.campaign_time.powered_s / 500))
        np.testing.assert_allclose(state.level[0], np.broadcast_to([8.0 * rise] + [12.0 * rise] * 24, (2, 25)))
    assert run(config, slot=20).campaign_time.powered_s == POWER_ON_S  # cold again


def test_electrodes_follow_tdc_and_tdc_follows_warm_up_and_object(monkeypatch) -> None:
    monkeypatch.setattr(calendar, "OBJECT_KELVIN", (-2.0, -2.0))
    warm_up = {"body_kelvin": 0.8, "tdc": {}}
    settings: dict[str, Any] = {"days": [0, 1], "objects": 1, "grasps": 2, "tares": "object"}
    config, plain = (scene(CAN, campaign=settings | one, **HELD) for one in ({"warm_up": warm_up}, {}))
    found = World.of(config).campaign
    assert found is not None
    slopes = found.slopes(0)
    np.testing.assert_allclose(slopes.mean(axis=1), [0.75, 0.65], atol=0.09)
    np.testing.assert_allclose(slopes.std(), np.hypot(0.15, 0.05), rtol=0.3)
    starts = []
    for slot, (warm, cold) in enumerate(zip(made(config, 4), made(plain, 4), strict=True)):
        assert not [name for name in cold.extra if "TDC" in name or "TAC" in name]
        assert np.isfinite(tdc_of(warm.extra, BIOTAC, "tare_")).all() == (warm.tare is not None) == (slot % 2 == 0)
        change = tdc_of(warm.extra, BIOTAC) - TDC_REST
        pairs = ((warm.touch, cold.touch, ""), (warm.tare, cold.tare, "tare_"))
        for touch, other, prefix in pairs[: 1 + (warm.tare is not None)]:
            moved = touch.values - other.values  # type: ignore[union-attr]
            expected = slopes * (tdc_of(warm.extra, BIOTAC, prefix) - TDC_REST)[:, None]
            np.testing.assert_allclose(moved[2:].reshape(2, -1), expected, atol=1.6)  # of rounded counts
            np.testing.assert_array_equal(moved[:2], 0.0)  # PDC does not follow
        if warm.tare is not None:
            cooled = tdc_of(warm.extra, BIOTAC) - tdc_of(warm.extra, BIOTAC, "tare_")
            np.testing.assert_allclose(cooled, -2.0 * 75.0 * (1.0 - np.exp(-1.0 / 20.0)), atol=1.0)
            assert (warm.extra["tare_TAC_TH"], warm.extra["TAC_TH"]) == (2048.0, 2010.0)
            starts.append(change)
        elif slot == 1:
            assert (change - starts[0] > 4.0).all()  # it warms on
    assert np.ptp(starts, axis=0).min() > 5.0  # each session begins at another temperature


def test_a_live_hand_sends_tdc_and_tac_of_a_scene_with_a_temperature(monkeypatch) -> None:
    monkeypatch.setattr(calendar, "OBJECT_KELVIN", (-2.0, -2.0))
    settings = {"days": [0, 1], "objects": 1, "grasps": 2, "warm_up": {"tdc": {}}}
    config, plain = (scene(CAN, campaign=one, **HELD) for one in (settings, {**settings, "warm_up": {}}))
    hand = SimulatedHand(config)
    assert (hand.rest(3).shape, SimulatedHand(plain).rest(3).shape) == ((3, 2, 29), (3, 2, 25))
    rise = hand.rest(1, elapsed_s=600.0)[0, :, 28] - hand.rest(1)[0, :, 28]
    np.testing.assert_allclose(rise, 75.0 * 3.0 * (1.0 - np.exp(-1.0)), atol=1.0)
    grasp = hand.execute(run(config, "grasp").grasp, 0)
    tac, tdc = np.moveaxis(grasp.counts[..., 27:].astype(int), 2, 0)
    assert not grasp.counts[..., 25:27].any()  # PAC is not simulated
    assert (tac[: grasp.start] == 2048).all()
    assert (tac[grasp.contact] < 2012).all()
    assert (tdc[grasp.release] < tdc[0]).all()


@pytest.mark.slow
def test_temperature_improves_electrodes_before_the_first_touch(rng, monkeypatch) -> None:
    """On a campaign that the tracker was not fitted to; without a temperature, nothing changes to the bit."""
    days = {"days": list(range(40)), "objects": 1, "grasps": 2, "tares": "none"}
    monkeypatch.setattr(calendar, "SESSION_KELVIN", 2.0)
    warm_up: dict[str, Any] = {"warm_up": {"tdc": {}}}

    def recorded(seed: int, settings: dict[str, Any], mean: np.ndarray | None = None) -> TimedReadings:
        items = [CAN | {"name": f"can{k}", "size_m": [0.06 + 0.002 * k] * 2 + [0.1]} for k in range(8)]
        samples = made(scene(*items, seed=seed, campaign=days | settings, **HELD), 80)
        labels = labels_of(samples)
        expected = np.tile(labels.mean(axis=0) if mean is None else mean, (len(labels), 1))
        return TimedReadings.of_samples(samples, labels, expected, labels[0]).ordered()

    first = recorded(0, warm_up)
    group = fit_group(
        HeldOutPredictions(first.expected, first.readings, first.objects, first.objects, BIOTAC), new=True
    )
    parameters = fit_tracker(first, group, group)
    assert ((parameters.slope[2:] > 0.3) & (parameters.slope[2:] < 1.0)).all()
    warm = recorded(1, warm_up, first.expected[0])
    shown = {"none": None, "whole": warm.tdc, "zeros": np.zeros_like(warm.tdc), "thumb only": warm.tdc * [1.0, np.nan]}
    played = {name: replay(SensorTracker(parameters), replace(warm, tdc=tdc)).counts for name, tdc in shown.items()}
    first_touches = np.flatnonzero(warm.begins())[5:]

    def errors(name: str) -> np.ndarray:
        """(runs, 2) mean squared errors of the electrodes of both fingers before the first touch [counts²]."""
        squared = (played[name] - warm.readings)[first_touches, 2:] ** 2
        return squared.reshape(-1, 2, 24).mean(axis=2)

    gain = errors("none") - errors("whole")
    draws = gain[rng.integers(0, len(gain), (1000, len(gain)))].mean(axis=1)
    assert (np.quantile(draws, 0.025, axis=0) > 0.0).all()
    np.testing.assert_array_equal(played["zeros"], played["none"])
    np.testing.assert_allclose(played["thumb only"][:, [0, *range(2, 26)]], played["whole"][:, [0, *range(2, 26)]])
    np.testing.assert_allclose(played["thumb only"][:, 26:], played["none"][:, 26:], atol=0.5)
    cold = recorded(1, {}, first.expected[0])
    without = replace(parameters, slope=np.zeros(50), slope_sd=np.zeros(50))
    found, same = (replay(SensorTracker(one), cold) for one in (parameters, without))
    np.testing.assert_array_equal(found.counts, same.counts)
    np.testing.assert_array_equal(found.half, same.half)


def test_an_exchange_changes_level_and_drift_once_and_of_one_finger() -> None:
    exchange = {"session": 2, "finger": "thumb", "electrode_counts": -150, "pdc_counts": 40}
    found = campaign(days=[0, 1, 2, 3, 4], objects=1, grasps=1, exchanges=[exchange])
    mounted = [found.fingers(session) for session in range(5)]
    levels = np.array([[finger.electrode_rest.mean() for finger in pair] for pair in mounted])
    np.testing.assert_allclose(np.diff(levels, axis=0), [[0, 0], [-150, 0], [0, 0], [0, 0]], atol=1e-9)
    np.testing.assert_allclose(np.diff([pair[0].pdc_rest for pair in mounted]), [0, 40, 0, 0])
    assert np.ptp(mounted[2][0].electrode_rest - mounted[1][0].electrode_rest) > 50  # another sensor, not an offset
    assert mounted[1] == mounted[0]
    settings: dict[str, Any] = {"days": [0, 1, 2], "objects": 1, "grasps": 1, "drift": [{"hand_counts": 0.0}]}
    kept = drift_at(campaign(**settings), 0, 1, 2)
    new = drift_at(campaign(**settings, exchanges=[{"session": 1, "finger": "middle"}]), 0, 1, 2)
    np.testing.assert_array_equal(new[:, 0], kept[:, 0])  # the other finger goes on
    np.testing.assert_array_equal(new[0], kept[0])
    assert (new[1:, 1] != kept[1:, 1]).all()


def test_tare_and_touch_follow_the_state_and_samples_hold_the_true_rest_levels() -> None:
    settings: dict[str, Any] = {"days": [0, 1], "objects": 1, "grasps": 2, "warm_up": {}, "exchanges": [{"session": 1}]}
    settings["drift"] = [{}, {"memory_days": 0.05, "in_contact": True}]
    config = scene(CAN, campaign=settings, **HELD)
    for slot, sample in enumerate(made(config, 4)):
        state = run(config, slot=slot)
        np.testing.assert_allclose(state.series - state.readings, state.level)
        tare = np.array([[*state.tare[f"PDC_{one}"], *state.tare[f"E_{one}"]] for one in ("TH", "MF")])
        np.testing.assert_array_equal(tare, np.clip(np.rint(state.series[0]), 0, 4095))
        assert np.abs(state.level).min() > 0.0
        assert sample.extra["rest_pdc_th"] == pytest.approx(tare[0, 0], abs=0.5)
        assert sample.extra["rest_e_th"] == pytest.approx(tare[0, 1:].mean(), abs=0.5)
        assert sample.extra["rest_e_mf"] == pytest.approx(tare[1, 1:].mean(), abs=0.5)


def test_a_live_hand_passes_through_the_campaign_by_its_clock() -> None:
    """86.4 s are a day: on the second one the thumb is another, and sensors that stayed on are warm."""
    settings: dict[str, Any] = {"days": [0, 1], "objects": 2, "grasps": 5, "warm_up": {}, "live_speed": 1000.0}
    settings |= {"drift": [{}, {"memory_days": 0.05, "in_contact": True}], "exchanges": [{"session": 1}]}
    config = scene(CAN, BOX, campaign=settings, **HELD)
    found = World.of(config).campaign
    assert found is not None
    hand = SimulatedHand(config)
    for elapsed in (0.0, 40.0, 90.0):
        now = found.live(elapsed)
        assert now.time_s == pytest.approx(1000.0 * elapsed)
        assert now.session == int(elapsed > 86.4)
        warm = temperature_drift(warming(np.array([now.powered_s])))[:, None]
        level = found.drift(now, NOW, NOW) + warm
        rest = np.array([np.append(f.pdc_rest, f.electrode_rest) for f in found.fingers(now.session)])
        np.testing.assert_allclose(hand.rest(1, elapsed_s=elapsed)[0], rest + level[0], atol=0.51)
    grasp = run(config, "grasp").grasp
    trajectory = hand.execute(grasp, 0, elapsed_s=40.0)
    assert trajectory.success
    np.testing.assert_array_equal(trajectory.counts[0], hand.rest(1, elapsed_s=40.0)[0])
    again = SimulatedHand(config).execute(grasp, 0, elapsed_s=40.0)  # after a restart
    np.testing.assert_array_equal(again.counts, trajectory.counts)


def test_the_committed_campaign_is_long_and_shares_no_object_with_the_unseen_ones() -> None:
    config, unseen = load_scene(SCENES / "campaign.yaml"), load_scene(SCENES / "unseen_objects.yaml")
    assert {object_index(config, slot) for slot in range(config.campaign.size)} == set(range(36))
    assert not {item.size_m for item in config.objects} & {item.size_m for item in unseen.objects}
    reasons = {plan.name: plan.reason for plan in explain_scene(config)}
    assert (reasons["calendar"], reasons["tares"]) == ("campaign", "campaign.tares: session")
