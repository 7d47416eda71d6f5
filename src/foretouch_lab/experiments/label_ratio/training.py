# SPDX-License-Identifier: Apache-2.0
"""Data and training of the two models of `label_ratio`, and the recipes of each.

P2's split is `labels`: 200 grasps per object are for testing, and 10 to 90 % of the others lose their labels.

One trainer trains both models. The PointNet is the SR-GAN with unsupervised weights of zero: the same network from the
same initial weights, batches of labelled samples of the same size, the same optimiser and number of updates. What
remains is the effect of the unlabelled and fake clouds, and of the recipe of each model (`TRIALS`).

Departures from P2, equal for both models, each an option in the settings:

- An update takes `batch_size` samples of each kind, and the number of updates is the same at every ratio in `quick`:
  P2's 30 epochs over all labelled samples would give T10 nine times the updates of T90.
- AdamW at 0.001 with a cosine schedule instead of Adam at a constant 0.01: with P2's recipe a PointNet does not
  converge on touch.
- Batch norm is `frozen` at the statistics of real clouds before the first update, or by the statistics of each batch,
  those of each source apart (`per_source`).
- No early stopping: no held-out samples are used in training, and the last weights are evaluated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.dataset.store import Store, is_store
from foretouch.errors import CloudError, ConfigError, DatasetError
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.preparation import finite_points, prepare_grasps, sample_channels
from foretouch.tactile import BIOTAC
from foretouch.types import Float32, Float64, Integer, Sample
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.learning.data import Dataset, labels_of
from foretouch_lab.learning.data.folds import Fold
from foretouch_lab.learning.data.training_set import TrainingSet, predict_set
from foretouch_lab.learning.training.losses import labeled_loss
from foretouch_lab.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch_lab.learning.training.trainer import shuffled_batches
from foretouch_lab.simulation.scene import load_scene
from foretouch_lab.simulation.simulate import Simulation

POINTNET: Final = "pointnet"
SRGAN: Final = "srgan"
MODELS: Final = (POINTNET, SRGAN)

_SUPERVISED: Final = {"loss_variant": "as_printed", "weight_unlabeled": 0.0, "weight_fake": 0.0}


_RECIPES: Final = {
    name: {"batch_norm": batch_norm, "learning_rate": 1e-3, "schedule": "cosine"}
    for name, batch_norm in (("batch 0.001", "per_source"), ("frozen 0.001", "frozen"))
}


def _reading(variant: str, recipe: str, **weights: float) -> dict[str, Any]:
    """Return a trial of the SR-GAN: one reading of the losses, with P2's weights but for those that are given."""
    return {**_RECIPES[recipe], "loss": {"loss_variant": variant, **weights}}


# Changes of each trial by model. Trials of the SR-GAN begin with the reading of P2's losses; `P2` is its recipe, which is the
# defaults of `SrganConfig` but for batch norm.
TRIALS: Final[Mapping[str, Mapping[str, Mapping[str, Any]]]] = {
    POINTNET: {**_RECIPES, "P2": {"batch_norm": "per_source", "batch_size": 32, "epochs": 50}},
    SRGAN: {
        **{
            f"{statistics}, {name}": _reading(statistics, name)
            for statistics in ("batch_means", "as_printed", "srgan")
            for name in _RECIPES
        },
        "batch_means w_U 0.1 w_F 0.01, batch 0.001": _reading(
            "batch_means", "batch 0.001", weight_unlabeled=0.1, weight_fake=0.01
        ),
        **{
            f"P2, {variant}": {"batch_norm": "per_source", "loss": {"loss_variant": variant}}
            for variant in ("as_printed", "contrast", "batch_means", "srgan")
        },
    },
}

# Readings of P2's losses that differ in nothing else.
READINGS: Final = tuple(f"{variant}, batch 0.001" for variant in ("batch_means", "as_printed", "srgan"))


def prepare_simulated(settings: Any, source: Path | None, out: Path) -> Path:
    """Return the store at `--data`, or simulate the first samples of a scene (YAML) to a store once: the `prepare` of the experiment.

    The store lies beside the folder of the sweep, in `<DIR>.data`; it is needed again only to resume.

    Raises:
        ConfigError: If `source` is neither, or the store there is of another scene or size.
    """
    if source is None or (source.is_dir() and not is_store(source)):
        rule = "is neither a scene (.yaml) nor a store; give --data a scene, such as config/scenes/deformables.yaml"
        raise ConfigError(f"--data: {source or 'nothing'}: {rule}")
    if is_store(source):
        return source
    scene, path = load_scene(source), Path(f"{out.absolute()}.data") / source.stem
    if not is_store(path):
        about = {"scene": scene.to_mapping(), "scene_sha256": scene.sha256()}
        with StoreWriter(path, about, scene.fingers.taxel_sensor()) as writer:
            for sample in Simulation(scene).samples(settings.samples):
                writer.write(sample)
    store = Store(path)
    if len(store) != settings.samples or store.manifest.get("about", {}).get("scene_sha256") != scene.sha256():
        raise ConfigError(f"{path}: contains {len(store)} samples of another scene or size; remove it")
    return path


def prepared(data: Dataset, model: ModelConfig, count: int) -> PresampledSet:
    """Return all samples as input of a network, `count` points of each cloud; the clouds are prepared once per process.

    Args:
        data: The samples.
        model: Configuration of the network.
        count: Points of each cloud.
    """
    return replace(_prepared(data, model.channels, model.metric_inputs, count), config=model)


@dataclass(frozen=True, eq=False)
class PresampledSet(TrainingSet):
    """A training set whose clouds all have the same number of points, in random order."""

    cached_points: Float32  # (S, P, C) float32

    def points(self, index: Integer, rng: np.random.Generator, n_points: int | None = None) -> Float32:
        """Return (B, n, C) float32: consecutive points of each cloud from a randomly drawn first one.

        Since the points are in random order, these are a random sample of them, twenty times as fast as drawing each;
        two draws may share a run of points.
        """
        count = self.config.n_points if n_points is None else n_points
        size = self.cached_points.shape[1]
        first = rng.integers(0, size, len(index))
        chosen: Float32 = self.cached_points[np.asarray(index)[:, None], (first[:, None] + np.arange(count)) % size]
        return chosen


@lru_cache(maxsize=1)
def _prepared(data: Dataset, channels: str, metric_inputs: bool, count: int) -> PresampledSet:
    config = ModelConfig(channels=channels, metric_inputs=metric_inputs)
    rng = np.random.default_rng(0)
    samples = data.samples
    pairs = [_one(sample, config, count, rng) for sample in samples]
    clouds = np.stack([points for points, _ in pairs])
    return PresampledSet(
        clouds=tuple(clouds),
        cached_points=clouds,
        grasps=np.array([grasp for _, grasp in pairs]),
        labels=labels_of(samples),
        lengths=np.zeros((len(samples), 0)),  # only needed in model cards, and no model is kept
        config=config,
    )


def _one(sample: Sample, config: ModelConfig, count: int, rng: np.random.Generator) -> tuple[Float32, Float32]:
    """Return random points of a cloud, with normals and in the unit sphere of the whole cloud; and the grasp."""
    try:
        usable = finite_points(sample.cloud, config)
        frame = UnitSphereFrame.fit(usable.xyz)
    except CloudError as err:
        raise DatasetError(f"{sample.id}: {err}") from err
    index = np.resize(rng.permutation(usable.size), count)  # a smaller cloud repeats some
    return sample_channels(usable, index, frame, config), prepare_grasps([sample.grasp], frame, config)[0]


def configured(base: SrganConfig, model: str, trial: str, labelled: int, updates: int | None, seed: int) -> SrganConfig:
    """Return the configuration of one training; raises `ConfigError` if there is no such model or trial.

    Args:
        base: Configuration that both models and all trials share.
        model: One of `MODELS`.
        trial: One of `TRIALS[model]`.
        labelled: Number of labelled samples.
        updates: Number of updates, rounded to whole epochs, at least one; None for the epochs of `base`.
        seed: Seed of weights, order, points and noise.
    """
    known = TRIALS.get(model, {})
    if trial not in known:
        raise ConfigError(f"label_ratio: {model} {trial!r} is not one of {', '.join(known or MODELS)}")
    config = base.updated(known[trial], trial).replace(seed=seed)
    if model == POINTNET:
        config = config.updated({"loss": _SUPERVISED})
    if updates is None:
        return config
    return config.replace(epochs=max(1, round(updates / max(1, labelled // config.batch_size))))


class PointnetTrainer(SrganTrainer):
    """The SR-GAN's trainer without unlabelled and fake clouds.

    With `_SUPERVISED` it takes the steps of `SrganTrainer` on the same batches, without the generator and the terms
    that are multiplied by zero, in a quarter of the time.
    """

    def _epoch(self) -> Iterator[Mapping[str, float]]:
        self._set_mode()
        for batch in shuffled_batches(self._labelled, self.config.batch_size, self.rng):
            error = self.net(*self._inputs(batch)) - self._targets(batch)
            loss = labeled_loss(error, torch.zeros_like(error), self.sizes)
            self.step("net", loss)
            yield {"labeled": float(loss.detach())}


def train_and_predict(data: TrainingSet, split: Fold, model: str, config: SrganConfig) -> tuple[Float64, int]:
    """Train a network, and predict the test samples.

    Args:
        data: The samples.
        split: Training, unlabelled and test side.
        model: `pointnet` or `srgan`.
        config: Settings of the networks.

    Returns:
        (J, M) predictions of the test samples [counts], and the number of updates.

    Raises:
        DatasetError: If there are fewer samples than a batch takes, or a loss is not finite.
    """
    kind = PointnetTrainer if model == POINTNET else SrganTrainer
    trainer = kind(data, split.train, split.unlabelled, config)
    return predict_set(trainer.train(), data, split.test), config.epochs * trainer.batch_count


def error_row(data: Dataset, outputs: Sequence[str], split: Fold, predicted: Float64) -> Row:
    """Return squared errors of (J, M) predictions of some modalities and of the training mean, for each test sample.

    Args:
        data: The samples.
        outputs: Modalities of the predictions.
        split: Whose test side was predicted.
        predicted: (J, M) predictions [counts].

    Returns:
        By object, in order of the samples, both means over the modality's values [counts²].
    """
    train, test = split.sides(data.samples)
    own = BIOTAC.columns(outputs)
    actual, mean = labels_of(test)[:, own], labels_of(train)[:, own].mean(axis=0)
    both = {"squared": ((predicted - actual) ** 2).mean(axis=1), "reference": ((mean - actual) ** 2).mean(axis=1)}
    names = np.array([sample.object for sample in test])
    errors = {
        str(name): {what: values[names == name].round(3).tolist() for what, values in both.items()}
        for name in np.unique(names)
    }
    return {"labelled": len(split.train), "objects": errors}
