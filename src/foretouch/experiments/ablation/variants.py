# SPDX-License-Identifier: Apache-2.0
"""The contact model without one of its components, and predictions of each component alone.

The released model has no switches for this: its components are fitted as `ContactPredictor` fits them, and combined
here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.learning.data import Fold, Indices, labels_of
from foretouch.learning.evaluation.baselines import geometry_features
from foretouch.learning.evaluation.prequential import Recording, predict_after
from foretouch.learning.training.calibration import calibrate, calibration_folds, rest_level, resting_labels
from foretouch.learning.training.contact import ContactConfig, describe_samples, fit_contact, thinned_samples
from foretouch.models.calibration import Calibration
from foretouch.models.contact.estimator import TOGETHER, ContactEstimator, by_modality
from foretouch.models.contact.hand_features import CHECKED, CONDITIONS, FEATURES, SLOPE_FEATURES
from foretouch.models.novelty import IN_DISTRIBUTION
from foretouch.models.state_space import NEW, TrackerParameters
from foretouch.tactile import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

FULL: Final = "full"
"""The complete model, as released."""


@dataclass(frozen=True, eq=False)
class Components:
    """Predictions of the components of a contact model for S grasps."""

    joint_forest: Float64  # (S, 50) of the forest of all values [counts]
    separate_forests: Float64  # (S, 50) of the forests of the modalities [counts]
    kernel: Float64  # (S, 50) of the kernel [counts]
    in_distribution: Float64  # (S,) degree to which the objects are in the training distribution, 0...1

    @classmethod
    def predict(cls, estimator: ContactEstimator, rows: Float64) -> Components:
        """Predictions for (S, F) feature rows, whose first columns are those of `CHECKED`."""
        inputs = rows[:, len(CONDITIONS) :]
        separate = np.empty((len(rows), TOUCH_SIZE))
        for name in MODALITIES:
            separate[:, columns([name])] = estimator.forests[name].predict(inputs)
        joint = estimator.forests[TOGETHER].predict(inputs)
        kernel = estimator.kernel.predict(inputs) * (1.0 if estimator.claim is None else by_modality(estimator.claim))
        mean, deviation, weights = estimator.mean, estimator.deviation, estimator.novelty.scores(rows)
        return cls(joint * deviation + mean, separate * deviation + mean, kernel * deviation + mean, weights)

    @classmethod
    def gather(cls, parts: Sequence[tuple[Indices, Components]]) -> Components:
        """Predictions for all samples, from disjoint index sets that together contain each of them."""
        order = np.argsort(np.concatenate([index for index, _ in parts]))
        names = ("joint_forest", "separate_forests", "kernel", "in_distribution")
        return cls(*(np.concatenate([getattr(part, name) for _, part in parts])[order] for name in names))


def _gated(forests: Float64, parts: Components) -> Float64:
    weight = parts.in_distribution[:, None]
    return weight * forests + (1.0 - weight) * parts.kernel


Combination = Callable[[Components], Float64]

COMBINATIONS: Final[dict[str, Combination]] = {
    FULL: lambda p: _gated((p.joint_forest + p.separate_forests) / 2.0, p),
    "forests alone": lambda p: (p.joint_forest + p.separate_forests) / 2.0,
    "kernel alone": lambda p: p.kernel,
    "no gate, half of each": lambda p: (p.joint_forest + p.separate_forests) / 4.0 + p.kernel / 2.0,
    "joint forest only": lambda p: _gated(p.joint_forest, p),
}
"""By name of the variant, (S, 50) predictions before any touch [counts]."""


def _diagonal(parameters: TrackerParameters) -> TrackerParameters:
    """The same variance of each value, without covariances."""
    squared = parameters.basis**2
    scale = squared @ parameters.noise[NEW]
    per_value = {
        name: (getattr(parameters, name) @ squared.T) / scale
        for name in ("slow", "fast", "object", "noise", "tare_noise")
    }
    share = squared / squared.sum(axis=1, keepdims=True)
    times = {name: share @ getattr(parameters, name) for name in ("slow_time_s", "fast_time_s")}
    return replace(parameters, basis=np.diag(np.sqrt(scale)), **per_value, **times)


TRACKER_EDITS: Final[dict[str, Callable[[TrackerParameters], TrackerParameters]]] = {
    "no shrinkage": lambda parameters: replace(parameters, worth=np.ones((2, TOUCH_SIZE))),
    "diagonal B": _diagonal,
}
"""By name of the variant, changes of the full model's tracker, which only matter after touches."""


def _without_slopes(samples: Sequence[GraspSample]) -> Float64:
    return describe_samples(samples)[:, [name not in SLOPE_FEATURES for name in FEATURES]]


def _geometry_only(samples: Sequence[GraspSample]) -> Float64:
    checked = describe_samples(samples)[:, : len(CHECKED)]
    return np.column_stack([checked, [geometry_features(sample) for sample in samples]])


FEATURE_SETS: Final[dict[str, Callable[[Sequence[GraspSample]], Float64]]] = {
    FULL: describe_samples,
    "without slopes": _without_slopes,
    "geometry_features only": _geometry_only,
}
"""By name of the variant, (S, F) feature rows. The first columns are those by which novelty is detected;
`geometry_features` are those of the baseline's trees."""


@dataclass(frozen=True, eq=False)
class ModelVariant:
    """A variant of the contact model with its predictions for the test samples."""

    recording: Recording  # of the test samples, with its predictions by sight
    calibration: Calibration | None  # its calibration, if one was made

    def predict(self, index: Indices, touched: Indices, *, tare: bool) -> Float64:
        """(K, 50) predictions [counts], after touches or with tares only if it is calibrated."""
        if self.calibration is None:
            return self.recording.expected[index]
        used = self.recording if tare else replace(self.recording, tares=None)
        earlier = touched[np.argsort(used.stamps_ns[touched], kind="stable")]
        return predict_after(self.calibration, used.take(earlier), used.take(index))[0]


def fit_variants(
    train: Sequence[GraspSample], test: Sequence[GraspSample], config: ContactConfig, *, calibrated: bool
) -> dict[str, ModelVariant]:
    """Fit all variants to labelled samples and predict others; those of `TRACKER_EDITS` only if calibrated.

    Raises:
        DatasetError: If a label is missing, or there are too few training samples.
    """
    result = {}
    for name, describe in FEATURE_SETS.items():
        model = _ComponentModel(train, config, describe)
        components = model.predict(test)
        held_out = model.held_out() if calibrated and name == FULL else {}
        for variant, combine in COMBINATIONS.items() if name == FULL else [(name, COMBINATIONS[FULL])]:
            calibration = model.calibrate(combine, held_out) if held_out else None
            counts, familiar = combine(components), components.in_distribution >= IN_DISTRIBUTION
            recording = Recording.of_samples(test, labels_of(test), counts, model.rest, familiar)
            result[variant] = ModelVariant(recording, calibration)
    full = result[FULL]
    if full.calibration is not None:
        for variant, edit in TRACKER_EDITS.items():
            tracker = edit(full.calibration.tracker_parameters)
            result[variant] = replace(full, calibration=replace(full.calibration, tracker=tracker))
    return result


class _ComponentModel:
    """A contact model that is fitted as `ContactPredictor` fits it and predicts with each component."""

    def __init__(
        self, train: Sequence[GraspSample], config: ContactConfig, describe: Callable[[Sequence[GraspSample]], Float64]
    ) -> None:
        self._train, self._config, self._describe = list(train), config, describe
        self.rest, _ = rest_level(train)
        self._labels = labels_of(train)
        self._resting = resting_labels(train, self._labels, self.rest)
        self._objects = np.array([sample.object for sample in train])
        self._rows = describe(train)
        copies = thinned_samples(train, config)
        self._thinned = None if copies is None else describe(copies)
        self._estimator = self._fit(np.arange(len(train)))

    def predict(self, samples: Sequence[GraspSample]) -> Components:
        return Components.predict(self._estimator, self._describe(samples))

    def held_out(self) -> dict[str, tuple[Components, npt.NDArray[np.str_]]]:
        """Predictions for held-out training samples, and the sessions of these, by calibration group."""
        return {
            name: (Components.gather([(fold.test, self._without(fold)) for fold in folds]), sessions)
            for name, (folds, sessions) in calibration_folds(self._train, self._config.seed).items()
        }

    def calibrate(
        self, combine: Combination, held_out: Mapping[str, tuple[Components, npt.NDArray[np.str_]]]
    ) -> Calibration:
        """Calibration of one combination of the components."""
        predicted = {name: (combine(components), sessions) for name, (components, sessions) in held_out.items()}
        return calibrate(self._train, self._labels, predicted)[0]

    def _without(self, fold: Fold) -> Components:
        return Components.predict(self._fit(fold.train), self._rows[fold.test])

    def _fit(self, index: Indices) -> ContactEstimator:
        thinned = None if self._thinned is None else self._thinned[index]
        return fit_contact(self._rows[index], self._resting[index], list(self._objects[index]), self._config, thinned)
