# SPDX-License-Identifier: Apache-2.0
"""Contact models of the area: what is described and fitted once for all of them, and each of them from that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.learning.data import Fold, Indices, labels_of
from foretouch.learning.training.contact import (
    ContactConfig,
    describe_samples,
    fit_contact,
    fit_forests,
    thinned_samples,
)
from foretouch.models.contact.cheaper import GlobalFeaturesOnly, fewer_trees
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.contact.features import CONDITIONS
from foretouch.types import Float64, GraspSample


class Described:
    """Samples with the features of their grasps, computed once.

    Attributes:
        samples, labels, objects: The samples, their (S, 50) labels [counts], and the names of their objects.
    """

    def __init__(self, samples: Sequence[GraspSample]) -> None:
        self.samples = list(samples)
        self.labels = labels_of(samples)
        self.objects = [sample.object for sample in samples]
        self._rows: dict[str, Float64] = {}
        self._place = {sample.id: k for k, sample in enumerate(self.samples)}

    def index(self, samples: Sequence[GraspSample]) -> Indices:
        """(T,) places of some of the samples."""
        return np.array([self._place[sample.id] for sample in samples], np.intp)

    def rows(self, kind: str) -> Float64:
        """(S, F) features: `hand`, `thinned`, or of clouds with a number of points, such as `500`."""
        if kind not in self._rows:
            samples = self.samples
            if kind == "thinned":
                samples = thinned_samples(samples, ContactConfig()) or []
            elif kind.isdigit():
                samples = [replace(one, cloud=thin(one.cloud, int(kind))) for one in samples]
            self._rows[kind] = describe_samples(samples)
        return self._rows[kind]


def thin(cloud: Any, count: int) -> Any:
    """A cloud of at most so many of its points, drawn at random by a fixed seed."""
    finite = np.flatnonzero(np.isfinite(cloud.xyz.reshape(-1, 3)).all(axis=1))
    drawn = np.random.default_rng(0).choice(finite, min(count, len(finite)), replace=False)
    return cloud.take(np.sort(drawn))


@dataclass(frozen=True, eq=False)
class _OnePart(ContactEstimator):
    """The forests alone, or the kernel alone."""

    forests_alone: bool = True

    def predict_rows(self, rows: Float64) -> tuple[Float64, npt.NDArray[np.bool_]]:
        """As `ContactEstimator.predict_rows`."""
        inputs = rows[:, len(CONDITIONS) :]
        scaled = self._trees(inputs) if self.forests_alone else self.kernel.predict(inputs)
        return scaled * self.deviation + self.mean, np.ones(len(rows), np.bool_)


class FittedContact:
    """The shipped recipe fitted to some samples, and its variants.

    Args:
        data: The samples.
        train: Those to fit to.
        seed: Of the trees.
    """

    def __init__(self, data: Described, train: Indices, seed: int) -> None:
        self._data, self._train, self._seed = data, train, seed
        self._fitted = self._fit(ContactConfig(seed=seed), "hand", data.rows("thinned"))

    def _fit(self, config: ContactConfig, kind: str, thinned: Float64 | None) -> ContactEstimator:
        data, train = self._data, self._train
        names = [data.objects[k] for k in train]
        copies = None if thinned is None else thinned[train]
        return fit_contact(data.rows(kind)[train], data.labels[train], names, config, copies)

    def variant(self, values: Mapping[str, Any]) -> tuple[ContactEstimator, str]:
        """A variant, and the kind of rows that it predicts from."""
        estimator = self._fitted
        if "refit" in values:
            config = ContactConfig(seed=self._seed, **values["refit"])
            forests = fit_forests(
                self._data.rows("hand")[self._train],
                self._data.labels[self._train],
                config,
                self._data.rows("thinned")[self._train],
            )
            estimator = replace(estimator, forests=forests)
        return cut(estimator, values), str(values.get("points", "hand"))


def cut(estimator: ContactEstimator, values: Mapping[str, Any]) -> ContactEstimator:
    """A fitted model with fewer trees or one part of it alone."""
    if "trees" in values:
        estimator = fewer_trees(estimator, values["trees"])
    part = values.get("part")
    if part == "no surroundings":
        return GlobalFeaturesOnly.of(estimator)
    if part is not None:
        parts = {name: getattr(estimator, name) for name in ContactEstimator.__dataclass_fields__}
        return _OnePart(**parts, forests_alone=part == "forests")
    return estimator


def predict_fold(data: Described, fold: Fold, fitted: FittedContact, values: Mapping[str, Any]) -> Float64:
    """(T, 50) predictions of the test side of a fold by a variant [counts]."""
    estimator, kind = fitted.variant(values)
    return estimator.predict_rows(data.rows(kind)[fold.test])[0]
