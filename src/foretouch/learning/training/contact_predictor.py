# SPDX-License-Identifier: Apache-2.0
"""The contact model from samples to a calibrated predictor: fitted, held out, calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.errors import DatasetError
from foretouch.learning.data.folds import Fold, make_folds
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.training.calibration import HeldOutPredictions, make_calibration
from foretouch.learning.training.contact import (
    ContactConfig,
    describe_samples,
    object_folds,
    rest_level,
    resting_labels,
)
from foretouch.learning.training.learners import ContactLearner
from foretouch.models.calibration import Calibration
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

__all__ = ["ContactPredictor", "calibration_folds"]


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
        self._known: dict[str, tuple[Float64, np.bool_]] = {}  # by the id of a sample

    def predict(self, samples: Sequence[GraspSample]) -> Float64:
        """(S, 50) predictions from sight alone [counts]; labels and tares of the samples are not looked at."""
        return self._expect(samples)[0]

    def familiar(self, samples: Sequence[GraspSample]) -> npt.NDArray[np.bool_]:
        """(S,) whether each is of an object like those of training; the others are flagged."""
        return self._expect(samples)[1]

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
        if not touched:  # needs no calibration
            return self._expect(samples)[0] + self._shifts(samples, tare=tare)
        return self.intervals_after(touched, samples, tare=tare)[0]

    def intervals_after(
        self, touched: Sequence[GraspSample], samples: Sequence[GraspSample], *, tare: bool = False
    ) -> tuple[Float64, Float64]:
        """The same with their half widths, (S, 50) both [counts].

        Raises:
            DatasetError: If a tare is asked for that a sample lacks, or the training samples cannot be held out.
        """
        expected, familiar = self._expect(samples)
        means = None
        if touched:  # at the rest level of training, since each sample has a tare of its own
            felt = labels_of(touched) - self._shifts(touched, tare=tare)
            means = self._expect(touched)[0].mean(axis=0), felt.mean(axis=0)
        counts, half = self.trust[0].adapt(expected, familiar, tare=tare, touched=means, count=len(touched))
        return counts + self._shifts(samples, tare=tare), half

    @cached_property
    def trust(self) -> tuple[Calibration, dict[str, Any]]:
        """The calibration, from time-blocked and object folds of the training samples, and the facts of its card.

        Raises:
            DatasetError: If all are of one object.
        """
        objects = np.array(self._learner.objects)
        held_out = {}
        for name, (folds, sessions) in calibration_folds(self._train, self._learner.config.seed).items():
            predicted = self._held_out(folds)
            held_out[name] = HeldOutPredictions(predicted, self._labels, objects, sessions)
            if self.rest_recorded:
                held_out[f"{name}_tare"] = HeldOutPredictions(predicted, self._learner.labels, objects, sessions)
        return make_calibration(self.rest, held_out)

    def _held_out(self, folds: Sequence[Fold]) -> Float64:
        """(S, 50) predictions of each training sample by a model fitted without its fold [counts]."""
        predicted = np.full_like(self._labels, np.nan)
        for fold in folds:
            predicted[fold.test] = self._learner(fold)
        return predicted

    def _expect(self, samples: Sequence[GraspSample]) -> tuple[Float64, npt.NDArray[np.bool_]]:
        """Before any touch and at rest; each sample is described once, however often it is asked for."""
        new = [sample for sample in samples if sample.id not in self._known]
        if new:
            pairs = zip(*self.estimator.predict_rows(describe_samples(new)), strict=True)
            self._known |= {sample.id: pair for sample, pair in zip(new, pairs, strict=True)}
        known = [self._known[sample.id] for sample in samples]
        return np.array([counts for counts, _ in known]), np.array([familiar for _, familiar in known], np.bool_)

    def _shifts(self, samples: Sequence[GraspSample], *, tare: bool) -> Float64:
        """(S, 50) what tares differ by from the rest level, zeros where they are not to be leaned on."""
        shifts = np.zeros((len(samples), TOUCH_SIZE))
        for k, sample in enumerate(samples if tare else ()):
            if sample.tare is None:
                raise DatasetError(f"{sample.id}: tare: is missing")
            shifts[k] = sample.tare.vector() - self.rest
        return shifts


def calibration_folds(samples: Sequence[GraspSample], seed: int) -> dict[str, tuple[list[Fold], npt.NDArray[np.str_]]]:
    """How training samples are held out to learn of a model's doubt, and to what a lasting part of the error belongs.

    Args:
        samples: To train on.
        seed: Of random folds, taken where an object has fewer samples than there are blocks of time.

    Returns:
        `known` and `new`: folds, and (S,) sessions: objects, or the stretches of their recordings.

    Raises:
        DatasetError: If all are of one object.
    """
    objects = np.array([sample.object for sample in samples])
    try:
        time_folds = make_folds(samples, "time", seed)
    except DatasetError:
        time_folds = make_folds(samples, "random", seed)
    stretches = objects.astype(object)
    for fold in time_folds:
        stretches[fold.test] = [f"{name}/{fold.name}" for name in objects[fold.test]]
    return {"known": (time_folds, stretches.astype(np.str_)), "new": (object_folds(list(objects)), objects)}
