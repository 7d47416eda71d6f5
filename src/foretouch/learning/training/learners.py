# SPDX-License-Identifier: Apache-2.0
"""The two kinds of model that can be shipped: how each is held out, and how it is fitted to everything and written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from foretouch.errors import DatasetError
from foretouch.learning.data.folds import Fold
from foretouch.learning.data.training_set import TrainingSet
from foretouch.learning.training.contact import ContactConfig, describe_objects, describe_samples, fit_contact
from foretouch.learning.training.supervised import TrainConfig, predict_set, train_network
from foretouch.models.contact.checkpoint import save_contact
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.network.config import ModelConfig
from foretouch.models.novelty import Fallback, LengthRangeCheck
from foretouch.tactile import MODALITIES, TactileRanges
from foretouch.types import Float64, GraspSample

__all__ = ["ContactLearner", "Learner", "NetworkLearner"]

Say = Callable[[Mapping[str, Any]], None]


class Learner(Protocol):
    """A kind of model with its configuration and its data."""

    @property
    def ranges(self) -> TactileRanges:
        """Of the hand that it learns from."""
        ...

    def __call__(self, fold: Fold) -> Float64:
        """(T, 50) predictions of a fold's test side by a model fitted to the rest [counts]."""
        ...

    def finish(self, out: Path, name: str, facts: Mapping[str, Any], say: Say) -> tuple[Path, Fallback | None]:
        """Fit to all samples and write; the card's path, and the fallback that goes with a calibration."""
        ...


@dataclass(frozen=True, eq=False)
class NetworkLearner:
    """A PointNet with all four modalities.

    Attributes:
        data: All samples, prepared for it.
        config: How it is trained.
        objects: (S, len(OBJECT_FEATURES)) descriptions of the samples' clouds.
    """

    data: TrainingSet
    config: TrainConfig
    objects: Float64

    @classmethod
    def build(cls, samples: Sequence[GraspSample], model: ModelConfig, config: TrainConfig) -> NetworkLearner:
        """Prepare all samples.

        Raises:
            DatasetError: If the network does not predict all modalities in their usual order.
        """
        if model.outputs != MODALITIES:
            raise DatasetError(f"outputs: {list(model.outputs)} are not all modalities, {', '.join(MODALITIES)}")
        objects = describe_objects(samples)
        return cls(TrainingSet.build(samples, model), config, objects)

    @property
    def ranges(self) -> TactileRanges:
        """As of `Learner`."""
        return self.data.config.ranges

    def __call__(self, fold: Fold) -> Float64:
        """As of `Learner`."""
        counts = predict_set(train_network(self.data, fold.train, self.config), self.data, fold.test)
        fallback = Fallback.fit(self.objects[fold.train], self.data.labels[fold.train])
        return fallback.fade(counts, self.objects[fold.test])[0]

    def finish(self, out: Path, name: str, facts: Mapping[str, Any], say: Say) -> tuple[Path, Fallback | None]:
        """As of `Learner`; one record an epoch."""
        from foretouch.models.network.checkpoint import save_network

        everything = np.arange(len(self.data.labels))
        net = train_network(self.data, everything, self.config, lambda epoch, loss: say({"epoch": epoch, "loss": loss}))
        familiar = LengthRangeCheck.fit(self.data.lengths).to_card()
        own = {"familiar": familiar, "training": self.config.to_mapping()}
        return save_network(out, name, net, {**facts, **own}), Fallback.fit(self.objects, self.data.labels)


@dataclass(frozen=True, eq=False)
class ContactLearner:
    """A contact model.

    Attributes:
        rows: (S, F) described samples.
        labels: (S, 50) [counts].
        objects: (S,) names.
        config: How it is fitted.
    """

    rows: Float64
    labels: Float64
    objects: tuple[str, ...]
    config: ContactConfig

    @classmethod
    def build(cls, samples: Sequence[GraspSample], labels: Float64, config: ContactConfig) -> ContactLearner:
        """Describe all samples; labels are (S, 50), told at one rest level [counts]."""
        return cls(describe_samples(samples), labels, tuple(sample.object for sample in samples), config)

    @property
    def ranges(self) -> TactileRanges:
        """As of `Learner`."""
        return self.config.ranges

    def __call__(self, fold: Fold) -> Float64:
        """As of `Learner`."""
        objects = [self.objects[i] for i in fold.train]
        fitted = fit_contact(self.rows[fold.train], self.labels[fold.train], objects, self.config)
        return fitted.predict_rows(self.rows[fold.test])[0]

    def fit(self) -> ContactEstimator:
        """Fit to all samples."""
        return fit_contact(self.rows, self.labels, self.objects, self.config)

    def finish(self, out: Path, name: str, facts: Mapping[str, Any], say: Say) -> tuple[Path, Fallback | None]:
        """As of `Learner`; a contact model fades by itself."""
        del say
        return save_contact(out, name, self.fit(), {**facts, "config": self.config.to_mapping()}), None
