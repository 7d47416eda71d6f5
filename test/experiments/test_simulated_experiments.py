# SPDX-License-Identifier: Apache-2.0
"""The experiments on simulated grasps, at the least size that still says something."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foretouch.errors import ConfigError
from foretouch.experiments import Experiment, find_experiment, list_experiments, run_sweep
from foretouch.experiments.shared.simulated_data import SimulatedSettings, beside, load_simulated, simulate_store
from foretouch.experiments.sim_to_real import TRANSFER_METHODS
from foretouch.types import Cloud, Grasp, GraspSample

SCENES = Path(__file__).parents[2] / "config" / "scenes"


def swept(name: str, out: Path, source: Path | None = None, **changes: Any) -> list[dict[str, Any]]:
    experiment: Experiment[Any, Any] = find_experiment(name)
    result = run_sweep(experiment, experiment.resolve("smoke", changes), out, source=source)
    assert result.failures == {}
    assert experiment.summarise(result.rows)
    (figure,) = experiment.draw(result.rows, out)
    assert figure.stat().st_size > 5000
    return result.rows


def test_noise_ceiling(tmp_path: Path) -> None:
    few = {"samples": 24, "grasps": 4, "repeats": 3, "alone": 2, "effort": 0.01}
    rows = swept("noise_ceiling", tmp_path / "out", SCENES / "deformables.yaml", **few)
    rmse = {row["name"]: row["rmse"] for row in rows if row["modality"] == "E_TH"}
    assert {"ceiling", "ceiling, change from the tare", "object_mean", "geometry_trees"} <= set(rmse)
    assert {f"only {cause} hidden" for cause in ("command", "posture", "placement", "sensor")} <= set(rmse)
    assert rmse["only sensor hidden"] < rmse["ceiling"] < rmse["object_mean"]


def test_lookalikes(tmp_path: Path) -> None:
    """Clouds do not distinguish them; after touches, skill is at most that of training on the object alone."""
    few = {"samples": 48, "encounter": 6, "predictors": ["training_mean"], "touches": [0, 5]}
    rows = swept("lookalikes", tmp_path / "out", SCENES / "lookalikes.yaml", **few)
    skill = {row["table"]: row["skill"] for row in rows if (row["kind"], row["modality"]) == ("all", "PDC_TH")}
    assert skill["no touch"] == pytest.approx(0.0, abs=1e-9)
    assert 0.3 < skill["after 5 touches"] < skill["told which"]
    assert {row["kind"] for row in rows} == {"all", "soft", "stiff"}


@pytest.mark.real_data
def test_sim_to_real(tmp_path: Path, real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(SCENES.parents[1])
    few = {"samples": 20, "effort": 0.01, "draws": 2, "touches": [0, 1], "predictors": ["simulated_scaled"]}
    rows = swept("sim_to_real", tmp_path / "out", real_data / "vision2tactile", references=[], **few)
    told = [row for row in rows if row["object"] == "all" and row["table"] == "no touch"]
    assert len(told) == 5
    assert all(row["skill"] > -0.2 for row in told)  # no better than the mean, but not much worse
    assert (beside(tmp_path / "out") / "real").is_symlink()


def test_all_three_are_listed() -> None:
    assert {"noise_ceiling", "lookalikes", "sim_to_real"} <= {one.name for one in list_experiments()}


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


def _grasps(count: int) -> list[GraspSample]:
    cloud = Cloud(np.zeros((3, 3), np.float32))
    grasp = Grasp(np.zeros(3), np.ones(3), np.eye(3))
    return [GraspSample(f"a/{k}", "a", cloud, grasp) for k in range(count)]


@pytest.mark.parametrize(("slope", "expected"), [(0.5, 0.5), (3.0, 1.0), (-2.0, 0.0)])
def test_what_was_simulated_counts_by_its_worth(slope: float, expected: float) -> None:
    """Labels that follow f by a slope: b is that slope, held to 0...1."""
    grasps = _grasps(30)
    said = {sample.id: np.random.default_rng(k).normal(0.0, 10.0, 50) for k, sample in enumerate(grasps)}
    f = np.array(list(said.values()))
    labels = 2000.0 + slope * f[:20]
    predicted = TRANSFER_METHODS["simulated_scaled"](said, 1)(grasps[:20], labels, grasps[20:], 0)
    np.testing.assert_allclose(predicted, labels.mean(axis=0) + expected * (f[20:] - f[:20].mean(axis=0)))
    whole = TRANSFER_METHODS["simulated_offset"](said, 1)(grasps[:20], labels, grasps[20:], 0)
    np.testing.assert_allclose(whole, labels.mean(axis=0) + f[20:] - f[:20].mean(axis=0))
