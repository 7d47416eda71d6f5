# SPDX-License-Identifier: Apache-2.0
"""Data of `label_ratio`: the simulated grasps, prepared once per process, and their split at each label ratio.

P2's split is `labels`: 200 grasps per object are for testing, and 10 to 90 % of the others lose their labels. To choose
hyperparameters, some of those that kept their labels are held out: neither test samples nor withheld labels are used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.errors import CloudError, DatasetError
from foretouch.experiments.shared.simulated_data import SimulatedGrasps, load_simulated
from foretouch.learning.data import Dataset, Indices, TrainingSet
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.preparation import finite_points, prepare_grasps, sample_channels
from foretouch.types import Float32, GraspSample


@dataclass(frozen=True, eq=False)
class LabelSplit:
    """Indices of the samples."""

    train: Indices  # (T,) labelled training samples
    unlabelled: Indices  # (U,) training samples without labels
    test: Indices  # (J,) samples to predict: the test samples, or those held out for tuning


def load_scene(settings: Any, path: Path) -> SimulatedGrasps:
    """Read a store of the required scene.

    Raises:
        DatasetError: If it is of another scene, or contains an unlabelled sample.
    """
    data = load_simulated(settings, path)
    found = data.scene.sha256()
    if settings.scene_sha256 not in (None, found):
        raise DatasetError(f"{path}: scene_sha256: {found} is not {settings.scene_sha256}, the frozen scene's")
    if unlabelled := [sample.id for sample in data.collection.samples if sample.touch is None]:
        raise DatasetError(f"{path}: {unlabelled[0]}: touch: is not labelled")
    return data


def split_at(data: Dataset, ratio: int, held_out: float = 0.0, seed: int = 0) -> LabelSplit:
    """Split the samples at one of P2's ratios.

    Args:
        data: The samples.
        ratio: Percent without labels: 10 for T10.
        held_out: 0 to test on the test samples, else the share of the labelled samples that are held out and tested on
            instead; the test samples are then not used.
        seed: Seed of the held-out samples.

    Raises:
        DatasetError: If these samples have no such split, or no sample is held out.
    """
    (part,) = data.parts(f"labels/T{ratio}")
    train, test, unlabelled = (data.index(ids) for ids in (part.train, part.test, part.unlabelled))
    if held_out == 0.0:
        return LabelSplit(train, unlabelled, test)
    count = round(held_out * len(train))
    if count == 0:
        raise DatasetError(f"held_out: {held_out} of {len(train)} samples is none")
    shuffled = np.random.default_rng(seed).permutation(train)
    return LabelSplit(np.sort(shuffled[count:]), unlabelled, np.sort(shuffled[:count]))


def prepared(data: SimulatedGrasps, model: ModelConfig, count: int) -> PresampledSet:
    """All samples as input of a network, `count` points of each cloud; the clouds are prepared once per process.

    Raises:
        DatasetError: If a cloud is unusable; names the sample.
    """
    return replace(_prepared(data, model.channels, model.metric_inputs, count), config=model)


@dataclass(frozen=True, eq=False)
class PresampledSet(TrainingSet):
    """A training set whose clouds all have the same number of points, in random order."""

    cached_points: Float32  # (S, P, C) float32

    def points(self, index: npt.NDArray[np.integer], rng: np.random.Generator, n_points: int | None = None) -> Float32:
        """(B, n, C) float32: consecutive points of each cloud from a randomly drawn first one.

        Since the points are in random order, these are a random sample of them, twenty times as fast as drawing each;
        two draws may share a run of points.
        """
        count = self.config.n_points if n_points is None else n_points
        size = self.cached_points.shape[1]
        first = rng.integers(0, size, len(index))
        chosen: Float32 = self.cached_points[np.asarray(index)[:, None], (first[:, None] + np.arange(count)) % size]
        return chosen


@lru_cache(maxsize=1)
def _prepared(data: SimulatedGrasps, channels: str, metric_inputs: bool, count: int) -> PresampledSet:
    config = ModelConfig(channels=channels, metric_inputs=metric_inputs)
    rng = np.random.default_rng(0)
    samples = data.collection.samples
    pairs = [_one(sample, config, count, rng) for sample in samples]
    clouds = np.stack([points for points, _ in pairs])
    return PresampledSet(
        clouds=tuple(clouds),
        cached_points=clouds,
        grasps=np.array([grasp for _, grasp in pairs]),
        labels=np.array([sample.touch.vector() for sample in samples if sample.touch is not None]),
        lengths=np.zeros((len(samples), 0)),  # only needed in model cards, and no model is kept
        config=config,
        ids=tuple(sample.id for sample in samples),
    )


def _one(sample: GraspSample, config: ModelConfig, count: int, rng: np.random.Generator) -> tuple[Float32, Float32]:
    """Random points of a cloud, with normals and in the unit sphere of the whole cloud; and the grasp."""
    try:
        usable = finite_points(sample.cloud, config)
        frame = UnitSphereFrame.fit(usable.xyz)
    except CloudError as err:
        raise DatasetError(f"{sample.id}: {err}") from err
    index = np.resize(rng.permutation(usable.size), count)  # a smaller cloud repeats some
    return sample_channels(usable, index, frame, config), prepare_grasps([sample.grasp], frame, config)[0]
