# SPDX-License-Identifier: Apache-2.0
"""What the cells of `label_ratio` share: the simulated grasps, prepared once a process, and who is on which side.

P2's sides are the split `labels`: 200 grasps an object are tested, and 10 to 90 % of the others lose their labels.
To choose between settings, a part of those that kept them is held back: neither a test sample nor a withheld label
has any say in a choice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.unit_sphere import UnitSphereFrame
from foretouch.config import setting
from foretouch.errors import CloudError, DatasetError
from foretouch.experiments.shared.simulated_data import SimulatedGrasps, SimulatedSettings, load_simulated
from foretouch.learning.data.collection import Collection
from foretouch.learning.data.folds import Indices
from foretouch.learning.data.training_set import TrainingSet
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.preparation import finite_points, prepare_grasps, sample_channels
from foretouch.types import Float32, GraspSample

__all__ = ["RatioDataSettings", "Sides", "StockedSet", "load_frozen", "prepared", "sides"]

_SPLIT = "labels"


@dataclass(frozen=True, kw_only=True)
class RatioDataSettings(SimulatedSettings):
    """Which grasps, and what of their clouds is kept at hand."""

    scene_sha256: str | None = setting(
        "db79f5dd4379f4293d1bc390690fb94f61cba827eb42fd4f5fd58ce6e58f7c5b",
        "Hash of the scene that results belong to, config/scenes/deformables.sha256; any scene where empty",
    )
    stock: int = setting(
        512, "Points kept of each cloud, drawn once; training draws its own from these each time", minimum=32
    )


@dataclass(frozen=True, eq=False)
class Sides:
    """Places of the samples.

    Attributes:
        train: (T,) to learn from with their labels.
        unlabelled: (U,) to learn from without.
        judged: (J,) to be predicted: the test samples, or those held back to choose by.
    """

    train: Indices
    unlabelled: Indices
    judged: Indices


def load_frozen(settings: RatioDataSettings, path: Path) -> SimulatedGrasps:
    """Read a store of the frozen scene.

    Raises:
        DatasetError: If it is of another scene, or an unlabelled sample is in it.
    """
    data = load_simulated(settings, path)
    found = data.scene.sha256()
    if settings.scene_sha256 is not None and found != settings.scene_sha256:
        raise DatasetError(f"{path}: scene_sha256: {found} is not {settings.scene_sha256}, the frozen scene's")
    for sample in data.collection.samples:
        if sample.touch is None:
            raise DatasetError(f"{path}: {sample.id}: touch: is not labelled")
    return data


def sides(data: Collection, ratio: int, held: float = 0.0, seed: int = 0) -> Sides:
    """Who is on which side at one of P2's ratios.

    Args:
        data: The samples.
        ratio: 10 for T10.
        held: 0 to be judged on the test samples. Else the share of the labelled samples that is held back and judged
            instead; the test samples are then on no side.
        seed: Of whom is held back.

    Raises:
        DatasetError: If these samples have no such split, or nobody is held back.
    """
    (part,) = data.parts(f"{_SPLIT}/T{ratio}")
    train, test, unlabelled = (data.index(ids) for ids in (part.train, part.test, part.unlabelled))
    if held == 0.0:
        return Sides(train, unlabelled, test)
    count = round(held * len(train))
    if count == 0:
        raise DatasetError(f"held: {held} of {len(train)} samples is none")
    shuffled = np.random.default_rng(seed).permutation(train)
    return Sides(np.sort(shuffled[count:]), unlabelled, np.sort(shuffled[:count]))


def prepared(data: SimulatedGrasps, model: ModelConfig, stock: int) -> StockedSet:
    """All samples as a network of some outputs is fed them; the clouds are prepared once a process.

    Args:
        data: The samples.
        model: The network.
        stock: Points kept of each cloud.

    Raises:
        DatasetError: If a cloud is unusable; named by id.
    """
    return replace(_prepared(data, model.channels, model.metric_inputs, stock), config=model)


@dataclass(frozen=True, eq=False)
class StockedSet(TrainingSet):
    """A training set whose clouds all have the same number of points, in an order drawn once.

    Attributes:
        stock: (S, P, C) float32, the clouds.
    """

    stock: Float32

    def points(self, index: npt.NDArray[np.integer], rng: np.random.Generator, n_points: int | None = None) -> Float32:
        """(B, n, C) float32: of each cloud as many points as follow on one another from a place that is drawn.

        Points stand in random order, so these are a random choice of them, at a twentieth of the time of a fresh one;
        what it gives up is that two draws may share a run of points.

        Args:
            index: (B,) samples.
            rng: Draws the places.
            n_points: By default those of the configuration.
        """
        count = self.config.n_points if n_points is None else n_points
        size = self.stock.shape[1]
        first = rng.integers(0, size, len(index))
        chosen: Float32 = self.stock[np.asarray(index)[:, None], (first[:, None] + np.arange(count)) % size]
        return chosen


@lru_cache(maxsize=1)
def _prepared(data: SimulatedGrasps, channels: str, metric_inputs: bool, stock: int) -> StockedSet:
    config = ModelConfig(channels=channels, metric_inputs=metric_inputs)
    rng = np.random.default_rng(0)
    samples = data.collection.samples
    pairs = [_one(sample, config, stock, rng) for sample in samples]
    clouds = np.stack([points for points, _ in pairs])
    return StockedSet(
        clouds=tuple(clouds),
        stock=clouds,
        grasps=np.array([grasp for _, grasp in pairs]),
        labels=np.array([sample.touch.vector() for sample in samples if sample.touch is not None]),
        lengths=np.zeros((len(samples), 0)),  # of model cards, and no model is kept
        config=config,
        ids=tuple(sample.id for sample in samples),
    )


def _one(sample: GraspSample, config: ModelConfig, stock: int, rng: np.random.Generator) -> tuple[Float32, Float32]:
    """Some points of a cloud, with the normals and in the unit sphere of all of them; and the grasp."""
    try:
        usable = finite_points(sample.cloud, config)
        frame = UnitSphereFrame.fit(usable.xyz)
    except CloudError as err:
        raise DatasetError(f"{sample.id}: {err}") from err
    index = np.resize(rng.permutation(usable.size), stock)  # all of a smaller cloud, and some again
    return sample_channels(usable, index, frame, config), prepare_grasps([sample.grasp], frame, config)[0]
