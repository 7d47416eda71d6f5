# SPDX-License-Identifier: Apache-2.0
"""The ceiling on numbers whose answer is known; repeats keep what a model sees and draw anew what it does not."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from sim_builders import SPONGE, scene

from foretouch.errors import ConfigError, SimulationError
from foretouch.tactile.channels import BIOTAC
from foretouch_lab.experiments import find_experiment, run_sweep
from foretouch_lab.experiments.noise_ceiling import CAUSES, NEW_OBJECT, Repeater, ceiling_rows
from foretouch_lab.experiments.shared.simulated_data import SimulatedSettings, load_simulated, simulate_store
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.world import SampleKey

GRASPS, SIGMA_M, SIGMA = 4000, 3.0, 4.0  # so 9 / 25 of the variance can be told
TRUE_CEILING = SIGMA_M**2 / (SIGMA_M**2 + SIGMA**2)


def rows(repeats: int, predictors: dict[str, Any]) -> list[dict[str, Any]]:
    """As the cells of `noise_ceiling` make them; a predictor is given the (S, 50) true means."""
    rng = np.random.default_rng(0)
    true = rng.normal(0.0, SIGMA_M, (GRASPS, 50))
    made = true[:, None] + rng.normal(0.0, SIGMA, (GRASPS, repeats, 50))
    mean, spread = made.mean(axis=1), made.var(axis=1, ddof=1)
    share = 1.0 - 1.0 / repeats
    columns = {"mean": mean, "rest": share * spread, "within": spread, "within_change": spread}
    columns["reference"] = mean**2 + share * spread
    sizes = {name: channel.size for name, channel in BIOTAC.channel_of.items()}
    head = {"what": "repeats", "name": "all", "modalities": sizes}
    told = [{**head, "id": str(k), **{name: all_[k] for name, all_ in columns.items()}} for k in range(GRASPS)]
    for name, predict in predictors.items():
        said = predict(true)
        told += [{"what": "predictor", "name": name, "id": str(k), "predicted": said[k]} for k in range(GRASPS)]
    return told


def test_the_ceiling_is_that_of_any_number_of_repeats_and_shares_of_it_are_as_known() -> None:
    def check(repeats: int) -> None:
        told = {row["modality"]: row for row in ceiling_rows(rows(repeats, {}), 100) if row["name"] == "ceiling"}
        for modality in ("PDC_TH", "E_MF"):
            assert told[modality]["skill"] == pytest.approx(TRUE_CEILING, abs=0.03)
            assert told[modality]["skill_low"] < told[modality]["skill"] < told[modality]["skill_high"]
        assert told["E_TH"]["skill"] == pytest.approx(TRUE_CEILING, abs=0.01)
        assert told["E_TH"]["rmse"] == pytest.approx(SIGMA, rel=0.01)

    every_case([2, 20], check)
    # Half of m leaves a quarter of its variance: 3/4 of the ceiling.
    knowing = {"all": lambda m: m, "half": lambda m: 0.5 * m, "nothing": np.zeros_like}
    told = {row["name"]: row for row in ceiling_rows(rows(3, knowing), 100) if row["modality"] == "E_TH"}
    assert told["all"]["share"] == pytest.approx(1.0, abs=0.01)
    assert told["half"]["share"] == pytest.approx(0.75, abs=0.01)
    assert told["nothing"]["share"] == pytest.approx(0.0, abs=1e-9)
    assert told["nothing"]["skill"] == pytest.approx(0.0, abs=1e-9)
    assert {row["name"] for row in ceiling_rows(rows(2, {}), 100)} == {"ceiling", "ceiling, change from the tare"}
    assert ceiling_rows([], 100) == []


POSTURE = {"pitch_deg": [-10, 35]}
HIDDEN = {
    "grasps": {"insertion_m": 0.012, "control": "depth", "thumb": {"depth_m": [0.001, 0.004]}, "error": {}},
    "fingers": {"thumb_posture": POSTURE, "middle_posture": POSTURE, "drift": {}, "noise": {}},
}
CONFIG = scene(SPONGE, **HIDDEN)
EVERYTHING = frozenset(CAUSES)


def test_repeats_follow_from_the_sample_alone_and_are_the_sample_without_a_cause() -> None:
    first, again = (Repeater(CONFIG, EVERYTHING).repeat(0, 0, 3) for _ in range(2))
    np.testing.assert_array_equal(first.touches, again.touches)
    assert len(np.unique(first.touches, axis=0)) == 3
    assert not np.array_equal(Repeater(CONFIG, EVERYTHING).repeat(1, 0, 3).touches, first.touches)
    made = Repeater(CONFIG, frozenset()).repeat(0, 0, 3)
    sample = Engine(CONFIG, EFFECTS, ("touch", "tare")).run(SampleKey(CONFIG.seed, 0))
    np.testing.assert_array_equal(made.touches, np.tile(sample.touch.values, (3, 1)))
    np.testing.assert_array_equal(made.tares, np.tile(sample.tare.values, (3, 1)))


def test_each_cause_moves_the_touch_and_only_the_sensor_the_tare() -> None:
    def check(cause: str) -> None:
        made = Repeater(CONFIG, frozenset({cause})).repeat(0, 0, 4)
        assert np.ptp(made.touches, axis=0).max() > 0.0
        assert (np.ptp(made.tares, axis=0).max() > 0.0) == (cause == "sensor")

    every_case(CAUSES, lambda effects: check(next(name for name, own in CAUSES.items() if own is effects)))
    assert frozenset().union(*CAUSES.values()) <= {effect.name for effect in EFFECTS}


def test_what_cannot_be_repeated_is_named() -> None:
    smooth = scene(SPONGE | {"friction": 0.0}, **HIDDEN)  # every finger slips off
    with pytest.raises(SimulationError, match="slot 0: 0 of 20 repeats succeed"):
        Repeater(smooth, EVERYTHING).repeat(0, 0, 2)
    with pytest.raises(ConfigError, match="scene: campaign: grasps are repeated at one moment"):
        Repeater(scene(SPONGE, campaign={}), EVERYTHING)


def test_a_new_object_may_be_of_any_material_of_the_scene_and_is_touched_on_another_day() -> None:
    """A sponge and a hard look-alike: what is known of the object leaves less open than what is not."""
    hard = SPONGE | {"name": "hard", "young_pa": 5e6}
    both = scene(SPONGE, hard, **HIDDEN | {"fingers": {}})
    command = frozenset({"command"})
    known, new = (Repeater(both, causes).repeat(0, 0, 6) for causes in (command, command | {NEW_OBJECT}))
    assert np.ptp(new.touches, axis=0).max() > 1.5 * np.ptp(known.touches, axis=0).max()
    days = scene(SPONGE, **HIDDEN | {"fingers": {"sessions": {}}})
    assert np.ptp(Repeater(days, EVERYTHING).repeat(0, 0, 3).tares, axis=0).max() == 0.0
    assert np.ptp(Repeater(days, frozenset({NEW_OBJECT})).repeat(0, 0, 3).tares, axis=0).max() > 1.0


def test_noise_ceiling(swept, scenes: Path) -> None:
    few = {"samples": 24, "grasps": 4, "repeats": 3, "single_cause_grasps": 2, "training_fraction": 0.01}
    rows = swept("noise_ceiling", scenes / "deformables.yaml", **few)
    rmse = {row["name"]: row["rmse"] for row in rows if row["modality"] == "E_TH"}
    assert {"ceiling", "ceiling, change from the tare", "object_mean", "geometry_trees"} <= set(rmse)
    assert {f"only {cause} hidden" for cause in ("command", "posture", "placement", "sensor")} <= set(rmse)
    assert rmse["only sensor hidden"] < rmse["ceiling"] < rmse["object_mean"]


def test_a_store_is_made_once_refused_for_another_scene_and_asked_for_where_absent(tmp_path, scenes) -> None:
    path = simulate_store(scenes / "clean.yaml", 3, tmp_path)
    before = (path / "manifest.json").stat().st_mtime_ns
    assert simulate_store(scenes / "clean.yaml", 3, tmp_path) == path
    assert (path / "manifest.json").stat().st_mtime_ns == before
    assert load_simulated(SimulatedSettings(), path).scene.objects[0].name == "can"
    with pytest.raises(ConfigError, match="another scene or size"):
        simulate_store(scenes / "clean.yaml", 4, tmp_path)
    experiment = find_experiment("noise_ceiling")
    with pytest.raises(ConfigError, match="give --data a scene"):
        run_sweep(experiment, experiment.resolve("smoke", {}), tmp_path / "out")
