# SPDX-License-Identifier: Apache-2.0
"""The experiments on simulated grasps, at the least size that still says something."""

from pathlib import Path

import pytest

from foretouch.errors import ConfigError
from foretouch.experiments import find_experiment, run_sweep
from foretouch.experiments.shared.simulated_data import SimulatedSettings, load_simulated, simulate_store

SCENES = Path(__file__).parents[2] / "config" / "scenes"


def test_noise_ceiling(swept) -> None:
    few = {"samples": 24, "grasps": 4, "repeats": 3, "single_cause_grasps": 2, "training_fraction": 0.01}
    rows = swept("noise_ceiling", SCENES / "deformables.yaml", **few)
    rmse = {row["name"]: row["rmse"] for row in rows if row["modality"] == "E_TH"}
    assert {"ceiling", "ceiling, change from the tare", "object_mean", "geometry_trees"} <= set(rmse)
    assert {f"only {cause} hidden" for cause in ("command", "posture", "placement", "sensor")} <= set(rmse)
    assert rmse["only sensor hidden"] < rmse["ceiling"] < rmse["object_mean"]


def test_a_store_is_made_once_and_refused_for_another_scene(tmp_path: Path) -> None:
    path = simulate_store(SCENES / "clean.yaml", 3, tmp_path)
    before = (path / "manifest.json").stat().st_mtime_ns
    assert simulate_store(SCENES / "clean.yaml", 3, tmp_path) == path
    assert (path / "manifest.json").stat().st_mtime_ns == before
    assert load_simulated(SimulatedSettings(), path).scene.objects[0].name == "can"
    with pytest.raises(ConfigError, match="another scene or size"):
        simulate_store(SCENES / "clean.yaml", 4, tmp_path)


def test_without_data_what_is_wanted_is_told(tmp_path: Path) -> None:
    for name, wanted in (("noise_ceiling", "give --data a scene"), ("sim_to_real", "no real grasps")):
        with pytest.raises(ConfigError, match=wanted):
            run_sweep(find_experiment(name), find_experiment(name).resolve("smoke", {}), tmp_path / "out")
