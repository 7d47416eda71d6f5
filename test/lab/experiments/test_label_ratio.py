# SPDX-License-Identifier: Apache-2.0
"""P2's label ratios, on a few simulated grasps and with networks that are hardly trained."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from foretouch.errors import ConfigError
from foretouch.models.network.config import ModelConfig
from foretouch_lab.experiments import Sweep, find_experiment
from foretouch_lab.experiments.framework.manifest import RESULTS_FILE
from foretouch_lab.experiments.label_ratio import LabelRatioSettings
from foretouch_lab.experiments.label_ratio.training import (
    MODELS,
    PointnetTrainer,
    PresampledSet,
    configured,
    prepare_simulated,
)
from foretouch_lab.learning.data import Dataset, load_dataset
from foretouch_lab.learning.network.networks import GeneratorConfig
from foretouch_lab.learning.training.srgan import SrganConfig, SrganTrainer

ROOT = Path(__file__).parents[3]
SCENE = ROOT / "config" / "scenes" / "deformables_wide.yaml"
TINY: dict[str, Any] = {
    "updates": 8,
    "modalities": ["PDC_TH"],
    "cached_points": 64,
    "training.batch_size": 4,
    "readings": [],
}
TWO = {"ratios": [50, 90], "seeds": [0, 1]}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return prepare_simulated(settings_of(samples=80), SCENE, tmp_path_factory.mktemp("deformables"))


@pytest.fixture(scope="module")
def data(store: Path) -> Dataset:
    return load_dataset(store)


def settings_of(preset: str = "smoke", **changes: Any) -> LabelRatioSettings:
    return find_experiment("label_ratio").resolve(preset, changes)


def test_the_printed_recipe_is_that_of_p2(data: Dataset) -> None:
    settings = settings_of("p2_as_printed")
    cells = find_experiment("label_ratio").cells(settings, data)
    networks = [cell.values for cell in cells if cell.values["model"] in MODELS]
    assert len(networks) == 5 * 5 * 4 * 5
    assert (settings.model.n_points, settings.model.feature_size, settings.model.head_size) == (750, 1024, 1039)
    found = {}
    for network in networks:
        config = configured(settings.training, network["model"], network["trial"], 320, settings.updates, 0)
        found[network["trial"]] = config
        assert (config.optimiser, config.learning_rate, config.schedule) == ("adam", 0.01, "constant")
        assert (config.weight_decay, config.target_scaling) == (0.0, "ranges")
    pointnet = found.pop("P2")
    assert (pointnet.batch_size, pointnet.epochs) == (32, 50)
    assert set(found) == {f"P2, {one}" for one in ("as_printed", "contrast", "batch_means", "srgan")}
    for trial, config in found.items():
        assert (config.batch_size, config.epochs, f"P2, {config.loss.loss_variant}") == (10, 30, trial)
        weights = (config.loss.weight_unlabeled, config.loss.weight_fake)
        assert weights == (10.0, 0.1)


def test_settings_that_cannot_be_are_refused(data: Dataset, store: Path) -> None:
    few = "cached_points: 512 points are fewer than the network's 750"
    with pytest.raises(ConfigError, match=f"label_ratio: {few}"):
        settings_of("p2_as_printed", cached_points=512)
    experiment = find_experiment("label_ratio")
    settings = settings_of(**{**TINY, **TWO, "readings": ["fast"]})
    with pytest.raises(ConfigError, match="srgan 'fast' is not one of batch_means"):
        experiment.run(experiment.cells(settings, data)[-1], settings, data)


def test_a_store_is_made_once_and_refused_for_another_scene(tmp_path: Path, store: Path) -> None:
    clean = SCENE.with_name("clean.yaml")
    path = prepare_simulated(settings_of(samples=10), clean, tmp_path)
    before = (path / "manifest.json").stat().st_mtime_ns
    assert prepare_simulated(settings_of(samples=10), clean, tmp_path) == path
    assert (path / "manifest.json").stat().st_mtime_ns == before
    with pytest.raises(ConfigError, match="another scene or size"):
        prepare_simulated(settings_of(samples=11), clean, tmp_path)
    experiment = find_experiment("label_ratio")
    with pytest.raises(ConfigError, match="give --data a scene"):
        Sweep(experiment, settings_of(), tmp_path / "out")


def swept(out: Path, settings: Any, store: Path) -> Sweep:
    sweep = Sweep(find_experiment("label_ratio"), settings, out, source=store, resume=True)
    sweep.run()
    sweep.finish()
    return sweep


@pytest.mark.usefixtures("in_this_process")
def test_a_run_may_be_extended_by_ratios_modalities_and_trials(store: Path, tmp_path: Path) -> None:
    """And one that was cut gives the same table."""
    out = tmp_path / "out"
    tiny = {**TINY, "ratios": [50, 90], "seeds": [0]}
    assert swept(out, settings_of(**{**tiny, "ratios": [90]}), store).finished == 3
    both = settings_of(**{**tiny, "modalities": ["PDC_TH", "E_MF"]})
    result = swept(out, both, store)
    assert (result.reused, result.finished, result.failures) == (3, 10, {})
    assert [(r["modality"], r["ratio"]) for r in result.rows] == [(m, r) for m in ("PDC_TH", "E_MF") for r in (50, 90)]
    assert all(0.0 < row["trees_rmse"] != row["mean_rmse"] for row in result.rows)
    shutil.copytree(out, cut := tmp_path / "cut")
    (cut / RESULTS_FILE).unlink()
    for cell in sorted((cut / "cells").glob("*E_MF*")):
        cell.unlink()
    again = swept(cut, both, store)
    assert (again.reused, len(again.cells)) == (6, 10)
    assert (out / RESULTS_FILE).read_bytes() == (cut / RESULTS_FILE).read_bytes()


POINTS = 16
MODEL = ModelConfig(n_points=POINTS, tnet=False, trunk_widths=(16, 32), head_widths=(16,), outputs=("PDC_TH",))
BASE = SrganConfig(
    batch_size=8, target_scaling="standardised", generator=GeneratorConfig(noise_length=1, widths=(4,), stride=4)
)


@pytest.fixture
def presampled() -> PresampledSet:
    rng = np.random.default_rng(0)
    clouds = rng.uniform(-1.0, 1.0, (24, POINTS, 3)).astype(np.float32)
    return PresampledSet(
        clouds=tuple(clouds),
        cached_points=clouds,
        grasps=rng.normal(size=(24, 15)).astype(np.float32),
        labels=rng.normal(2000.0, 100.0, (24, 50)),
        lengths=np.zeros((24, 0)),
        config=MODEL,
    )


def test_the_pointnet_is_the_srgan_without_unsupervised_weights(presampled: PresampledSet) -> None:
    """One batch of all points of all labelled samples, so that neither order nor choice makes a difference."""
    for recipe in ("frozen 0.001", "batch 0.001"):
        config = configured(BASE, "pointnet", recipe, 8, updates=5, seed=1)
        assert config.loss.weight_unlabeled == config.loss.weight_fake == 0.0
        nets = []
        for kind in (PointnetTrainer, SrganTrainer):
            trainer = kind(presampled, np.arange(8), np.arange(8, 24), config)
            while trainer.epoch < config.epochs:
                trainer.run_epoch()
            assert trainer.epoch == 5
            nets.append(trainer.net)
        # Not the weights: a bias before batch norm has no effect, and so no gradient but rounding, which Adam scales up.
        clouds, grasps = torch.from_numpy(presampled.cached_points), torch.from_numpy(presampled.grasps).float()
        torch.testing.assert_close(*(net.train()(clouds, grasps) for net in nets), rtol=1e-3, atol=1e-5)
        nets = [  # and the SR-GAN of a trial begins with the same network
            kind(presampled, np.arange(8), np.arange(8, 24), configured(BASE, model, trial, 8, updates=1, seed=4)).net
            for kind, model, trial in (
                (PointnetTrainer, "pointnet", recipe),
                (SrganTrainer, "srgan", f"batch_means, {recipe}"),
            )
        ]
        for one, other in zip(nets[0].state_dict().values(), nets[1].state_dict().values(), strict=True):
            assert torch.equal(one, other)
