# SPDX-License-Identifier: Apache-2.0
"""The contact model from samples to a calibrated predictor: fitted, held out, calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from foretouch.errors import DatasetError
from foretouch.learning.calibration import HeldOut, make_trust
from foretouch.learning.contact_training import (
    ContactConfig,
    describe_samples,
    object_folds,
    rest_level,
    resting_labels,
)
from foretouch.learning.learners import ContactLearner
from foretouch.learning.splits import Fold, make_folds
from foretouch.models.trust import Trust
from foretouch.types import Float64, GraspSample

__all__ = ["ContactPredictor"]


class ContactPredictor:
    """A contact model fitted to labelled grasps; it learns of its own doubt only when that is asked for.

    Args:
        train: Labelled samples.
        labels: (S, 50) [counts].
        config: How it is fitted.

    Attributes:
        estimator: Fitted to all of them.
        rest: (50,) rest level that its counts are told at [counts].
        rest_recorded: Whether tares tell it.
    """

    def __init__(self, train: Sequence[GraspSample], labels: Float64, config: ContactConfig) -> None:
        self._train = list(train)
        self.rest, self.rest_recorded = rest_level(train)
        self._labels = labels
        self._learner = ContactLearner.build(train, resting_labels(train, labels, self.rest), config)
        self.estimator = self._learner.fit()

    def predict(self, samples: Sequence[GraspSample]) -> Float64:
        """(S, 50) predictions from sight alone [counts]; labels and tares of the samples are not looked at."""
        return self.estimator.predict_rows(describe_samples(samples))[0]

    def predict_after(
        self, touched: Sequence[GraspSample], samples: Sequence[GraspSample], *, tare: bool = False
    ) -> Float64:
        """Predictions after touches of the same object, as `TouchModel.predict` with a memory gives them.

        Args:
            touched: Labelled samples of the object at hand; none are needed.
            samples: To predict.
            tare: Whether to lean on the tares of all of them, too.

        Raises:
            DatasetError: If a tare is asked for that a sample lacks.
        """
        predicted, familiar = self._expect(samples, tare=tare)
        if not touched:
            return predicted
        expected, _ = self._expect(touched, tare=tare)
        labels = np.array([sample.touch.vector() for sample in touched if sample.touch is not None])
        means = expected.mean(axis=0), labels.mean(axis=0)
        for known in (True, False):
            regime = self.trust[0].regime(familiar=known, tare=tare)
            mine = familiar == known
            predicted[mine] = regime.after(predicted[mine], *means, len(touched))
        return predicted

    @cached_property
    def trust(self) -> tuple[Trust, dict[str, Any]]:
        """The calibration, from time-blocked and object folds of the training samples, and the facts of its card.

        Raises:
            DatasetError: If all are of one object.
        """
        objects = np.array(self._learner.objects)
        time_folds = self._time_folds()
        stretches = objects.astype(object)
        for fold in time_folds:
            stretches[fold.test] = [f"{name}/{fold.name}" for name in objects[fold.test]]
        held_out = {}
        for name, folds, sessions in (
            ("known", time_folds, stretches.astype(np.str_)),
            ("new", object_folds(self._learner.objects), objects),
        ):
            predicted = self._held_out(folds)
            held_out[name] = HeldOut(predicted, self._labels, objects, sessions)
            if self.rest_recorded:
                held_out[f"{name}_tare"] = HeldOut(predicted, self._learner.labels, objects, sessions)
        return make_trust(self.rest, held_out)

    def _time_folds(self) -> list[Fold]:
        try:
            return make_folds(self._train, "time", self._learner.config.seed)
        except DatasetError:  # an object with fewer samples than blocks
            return make_folds(self._train, "random", self._learner.config.seed)

    def _held_out(self, folds: Sequence[Fold]) -> Float64:
        """(S, 50) predictions of each training sample by a model fitted without its fold [counts]."""
        predicted = np.full_like(self._labels, np.nan)
        for fold in folds:
            predicted[fold.test] = self._learner(fold)
        return predicted

    def _expect(self, samples: Sequence[GraspSample], *, tare: bool) -> tuple[Float64, np.ndarray[Any, Any]]:
        predicted, familiar = self.estimator.predict_rows(describe_samples(samples))
        if tare:
            for k, sample in enumerate(samples):
                if sample.tare is None:
                    raise DatasetError(f"{sample.id}: tare: is missing")
                predicted[k] += sample.tare.vector() - self.rest
        return predicted, familiar
