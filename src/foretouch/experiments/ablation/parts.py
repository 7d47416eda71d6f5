# SPDX-License-Identifier: Apache-2.0
"""A contact model taken apart: what each part says, and the whole put together again without one of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.learning.data.folds import Fold, Indices
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.baselines import geometry_features
from foretouch.learning.training.calibration import HeldOutPredictions, make_calibration
from foretouch.learning.training.contact import ContactConfig, describe_samples, fit_contact, rest_level, resting_labels
from foretouch.learning.training.contact_predictor import calibration_folds
from foretouch.models.calibration import Calibration, CalibrationGroup
from foretouch.models.contact.estimator import TOGETHER, ContactEstimator
from foretouch.models.contact.features import FEATURES, OBJECT_FEATURES, SLOPE_FEATURES
from foretouch.models.novelty import FAMILIAR
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

__all__ = ["BLENDS", "DESCRIPTIONS", "FULL", "REGIME_EDITS", "Assembled", "Pieces", "assemble"]

FULL: Final = "full"
"""The model as it ships."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """What the parts of a contact model say of S grasps.

    Attributes:
        together: (S, 50) the forest of all values [counts].
        apart: (S, 50) the forests of the modalities [counts].
        kernel: (S, 50) the kernel [counts].
        familiarity: (S,) of the objects, 0...1.
    """

    together: Float64
    apart: Float64
    kernel: Float64
    familiarity: Float64

    @classmethod
    def ask(cls, estimator: ContactEstimator, rows: Float64) -> Pieces:
        """Of (S, F) described grasps, whose first columns are those of the object."""
        apart = np.empty((len(rows), TOUCH_SIZE))
        for name in MODALITIES:
            apart[:, columns([name])] = estimator.forests[name].predict(rows)
        together, kernel = estimator.forests[TOGETHER].predict(rows), estimator.kernel.predict(rows)
        familiarity = [estimator.novelty.familiarity(row[: len(OBJECT_FEATURES)]) for row in rows]
        mean, deviation = estimator.mean, estimator.deviation
        return cls(
            together * deviation + mean, apart * deviation + mean, kernel * deviation + mean, np.array(familiarity)
        )

    @classmethod
    def gather(cls, parts: Sequence[tuple[Indices, Pieces]]) -> Pieces:
        """Of all samples, from the pieces of disjoint places that together hold each of them."""
        order = np.argsort(np.concatenate([place for place, _ in parts]))
        names = ("together", "apart", "kernel", "familiarity")
        return cls(*(np.concatenate([getattr(piece, name) for _, piece in parts])[order] for name in names))


def _gated(forests: Float64, pieces: Pieces) -> Float64:
    weight = pieces.familiarity[:, None]
    return weight * forests + (1.0 - weight) * pieces.kernel


Blend = Callable[[Pieces], Float64]

BLENDS: Final[dict[str, Blend]] = {
    FULL: lambda p: _gated((p.together + p.apart) / 2.0, p),
    "forests alone": lambda p: (p.together + p.apart) / 2.0,
    "kernel alone": lambda p: p.kernel,
    "no gate, half of each": lambda p: (p.together + p.apart) / 4.0 + p.kernel / 2.0,
    "joint forest only": lambda p: _gated(p.together, p),
}
"""By name, (S, 50) predictions before any touch [counts]."""

REGIME_EDITS: Final[dict[str, Callable[[CalibrationGroup], CalibrationGroup]]] = {
    "no worth": lambda regime: replace(regime, worth=np.ones(TOUCH_SIZE)),
    "diagonal B": lambda regime: replace(regime, between=np.diag(np.diag(regime.between))),
}
"""What only matters after touches: the full model, and its regime with a part taken out."""


def _without_slopes(samples: Sequence[GraspSample]) -> Float64:
    return describe_samples(samples)[:, [name not in SLOPE_FEATURES for name in FEATURES]]


def _plain(samples: Sequence[GraspSample]) -> Float64:
    objects = describe_samples(samples)[:, : len(OBJECT_FEATURES)]
    return np.column_stack([objects, [geometry_features(sample) for sample in samples]])


DESCRIPTIONS: Final[dict[str, Callable[[Sequence[GraspSample]], Float64]]] = {
    FULL: describe_samples,
    "without slopes": _without_slopes,
    "geometry_features only": _plain,
}
"""By name, (S, F) rows; the first columns are those of the object, which familiarity is told by. `geometry_features` are
what the trees of the baselines are given, beside the object's columns."""


@dataclass(frozen=True, eq=False)
class Assembled:
    """A contact model put together from parts, and what it expects of the test samples.

    Attributes:
        expected: (S, 50) before any touch, at the rest level of training [counts].
        familiar: (S,) whether each is of a familiar object.
        felt: (S, 50) labels [counts].
        shifts: (S, 50) what tares differ by from the rest level; zeros without tares [counts].
        trust: Its calibration, where one was made.
    """

    expected: Float64
    familiar: npt.NDArray[np.bool_]
    felt: Float64
    shifts: Float64
    trust: Calibration | None

    def predict(self, asked: Indices, touched: Indices, *, tare: bool) -> Float64:
        """(K, 50) predictions as `ContactPredictor.predict_after` gives them [counts]; touches call for a trust."""
        shifts = self.shifts if tare else np.zeros_like(self.shifts)
        counts = self.expected[asked]
        if self.trust is not None and len(touched):
            means = self.expected[touched].mean(axis=0), (self.felt - shifts)[touched].mean(axis=0)
            counts, _ = self.trust.lean(counts, self.familiar[asked], tare=tare, touched=means, count=len(touched))
        return counts + shifts[asked]


def assemble(
    train: Sequence[GraspSample], test: Sequence[GraspSample], config: ContactConfig, *, calibrated: bool
) -> dict[str, Assembled]:
    """All variants, fitted to labelled samples and asked about others, by name; those of `REGIME_EDITS` only if calibrated.

    Raises:
        DatasetError: If a label is missing, or the training samples are too few.
    """
    result = {}
    for name, describe in DESCRIPTIONS.items():
        model = _Dissected(train, config, describe)
        said = model.ask(test)
        held_out = model.held_out() if calibrated and name == FULL else {}
        for variant, blend in BLENDS.items() if name == FULL else [(name, BLENDS[FULL])]:
            trust = model.trust(blend, held_out) if held_out else None
            counts, known = blend(said), said.familiarity >= FAMILIAR
            result[variant] = Assembled(counts, known, labels_of(test), model.shifts(test), trust)
    whole = result[FULL]
    if whole.trust is not None:
        for variant, edit in REGIME_EDITS.items():
            regimes = {name: edit(regime) for name, regime in whole.trust.groups.items()}
            result[variant] = replace(whole, trust=replace(whole.trust, groups=regimes))
    return result


class _Dissected:
    """A contact model fitted as `ContactPredictor` fits it, whose parts are asked one by one."""

    def __init__(
        self, train: Sequence[GraspSample], config: ContactConfig, describe: Callable[[Sequence[GraspSample]], Float64]
    ) -> None:
        self._train, self._config, self._describe = list(train), config, describe
        self._rest, self._rest_recorded = rest_level(train)
        self._labels = labels_of(train)
        self._resting = resting_labels(train, self._labels, self._rest)
        self._objects = np.array([sample.object for sample in train])
        self._rows = describe(train)
        self._estimator = self._fit(np.arange(len(train)))

    def ask(self, samples: Sequence[GraspSample]) -> Pieces:
        return Pieces.ask(self._estimator, self._describe(samples))

    def shifts(self, samples: Sequence[GraspSample]) -> Float64:
        tares = [self._rest if sample.tare is None else sample.tare.vector() for sample in samples]
        return np.array(tares) - self._rest

    def held_out(self) -> dict[str, tuple[Pieces, npt.NDArray[np.str_]]]:
        """What the parts say of training samples that they were not fitted to, and the sessions, by condition."""
        return {
            name: (Pieces.gather([(fold.test, self._without(fold)) for fold in folds]), sessions)
            for name, (folds, sessions) in calibration_folds(self._train, self._config.seed).items()
        }

    def trust(self, blend: Blend, held_out: Mapping[str, tuple[Pieces, npt.NDArray[np.str_]]]) -> Calibration:
        """The calibration of one way to put the parts together."""
        found = {}
        for name, (pieces, sessions) in held_out.items():
            predicted = blend(pieces)
            found[name] = HeldOutPredictions(predicted, self._labels, self._objects, sessions)
            if self._rest_recorded:
                found[f"{name}_tare"] = HeldOutPredictions(predicted, self._resting, self._objects, sessions)
        return make_calibration(self._rest, found)[0]

    def _without(self, fold: Fold) -> Pieces:
        return Pieces.ask(self._fit(fold.train), self._rows[fold.test])

    def _fit(self, index: Indices) -> ContactEstimator:
        return fit_contact(self._rows[index], self._resting[index], list(self._objects[index]), self._config)
