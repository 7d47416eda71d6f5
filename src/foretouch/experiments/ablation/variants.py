# SPDX-License-Identifier: Apache-2.0
"""The contact model without one of its components or features, and its tracker without one of its parts.

The released model has no switches for this: its components are taken from its estimator, and combined here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from foretouch.learning.data import Indices, labels_of
from foretouch.learning.evaluation.baselines import geometry_features
from foretouch.learning.evaluation.prequential import Recording, predict_after
from foretouch.learning.training.calibration import resting_labels
from foretouch.learning.training.contact import (
    ContactConfig,
    ContactPredictor,
    describe_samples,
    fit_contact,
    thinned_samples,
)
from foretouch.models.calibration import Calibration
from foretouch.models.contact.estimator import TOGETHER, ContactEstimator, by_modality
from foretouch.models.contact.features import CHECKED, CONDITIONS, FEATURES, SLOPE_FEATURES
from foretouch.models.novelty import IN_DISTRIBUTION
from foretouch.models.state_space import NEW, TrackerParameters
from foretouch.tactile import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

FULL: Final = "full"
"""The complete model, as released."""


@dataclass(frozen=True, eq=False)
class _Components:
    """Predictions of the components of a contact model for S grasps."""

    joint_forest: Float64  # (S, 50) of the forest of all values [counts]
    separate_forests: Float64  # (S, 50) of the forests of the modalities [counts]
    kernel: Float64  # (S, 50) of the kernel [counts]
    in_distribution: Float64  # (S,) degree to which the objects are in the training distribution, 0...1


def _predict(estimator: ContactEstimator, rows: Float64) -> _Components:
    """Predictions for (S, F) feature rows, whose first columns are those of `CHECKED`."""
    inputs = rows[:, len(CONDITIONS) :]
    separate = np.empty((len(rows), TOUCH_SIZE))
    for name in MODALITIES:
        separate[:, columns([name])] = estimator.forests[name].predict(inputs)
    joint = estimator.forests[TOGETHER].predict(inputs)
    kernel = estimator.kernel.predict(inputs) * by_modality(estimator.generalisation_gain)
    counts = [part * estimator.deviation + estimator.mean for part in (joint, separate, kernel)]
    return _Components(counts[0], counts[1], counts[2], estimator.novelty.scores(rows))


def _gated(forests: Float64, parts: _Components) -> Float64:
    weight = parts.in_distribution[:, None]
    return weight * forests + (1.0 - weight) * parts.kernel


COMBINATIONS: Final[dict[str, Callable[[_Components], Float64]]] = {
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
    "no shrinkage": lambda parameters: replace(parameters, difference_shrinkage=np.ones((2, TOUCH_SIZE))),
    "diagonal B": _diagonal,
}
"""By name of the variant, changes of the full model's tracker, which only matter after touches."""


def _without_slopes(samples: Sequence[GraspSample]) -> Float64:
    return describe_samples(samples)[:, [name not in SLOPE_FEATURES for name in FEATURES]]


def _geometry_only(samples: Sequence[GraspSample]) -> Float64:
    checked = describe_samples(samples)[:, : len(CHECKED)]
    return np.column_stack([checked, [geometry_features(sample) for sample in samples]])


FEATURE_SETS: Final[dict[str, Callable[[Sequence[GraspSample]], Float64]]] = {
    "without slopes": _without_slopes,
    "geometry_features only": _geometry_only,
}
"""By name of the variant, (S, F) feature rows. The first columns are those by which novelty is detected;
`geometry_features` are those of the baseline's trees."""


@dataclass(frozen=True, eq=False)
class ModelVariant:
    """A variant of the contact model with its predictions for the test samples."""

    recording: Recording  # of the test samples, with its predictions by vision
    calibration: Calibration | None  # of the full model and of edits of its tracker, if one was made

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
    full = ContactPredictor(train, labels_of(train), config)

    def variant(parts: _Components, combine: Callable[[_Components], Float64]) -> ModelVariant:
        familiar = parts.in_distribution >= IN_DISTRIBUTION
        return ModelVariant(Recording.of_samples(test, labels_of(test), combine(parts), full.rest, familiar), None)

    parts = _predict(full.estimator, describe_samples(test))
    result = {name: variant(parts, combine) for name, combine in COMBINATIONS.items()}
    copies = thinned_samples(train, config)
    for name, describe in FEATURE_SETS.items():
        labels, thinned = (
            resting_labels(train, labels_of(train), full.rest),
            None if copies is None else describe(copies),
        )
        estimator = fit_contact(describe(train), labels, [sample.object for sample in train], config, thinned)
        result[name] = variant(_predict(estimator, describe(test)), COMBINATIONS[FULL])
    if calibrated:
        calibration = full.calibration[0]
        for name, edit in {FULL: lambda parameters: parameters, **TRACKER_EDITS}.items():
            tracker = edit(calibration.tracker_parameters)
            result[name] = replace(result[FULL], calibration=replace(calibration, tracker=tracker))
    return result
