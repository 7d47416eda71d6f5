# SPDX-License-Identifier: Apache-2.0
"""How unlike the training objects an object is, by its sizes alone.

The distance of a cloud's sizes from the nearest clouds of training, against what is usual within the
training objects. On the public recordings it tells nine in ten grasps on an object that was left out, at one false alarm in
twenty; objects that look alike in size and shape pass, and no camera can tell them. (`familiarity` asks of a network
whether cloud and grasp are absurd.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from foretouch.errors import ModelError
from foretouch.models.contact.features import OBJECT_FEATURES, SHAPE_FEATURES
from foretouch.models.contact.kernel_regression import standardisation
from foretouch.types import Float32, Float64

__all__ = ["FAMILIAR", "Novelty"]

FAMILIAR: Final = 0.5
"""The least familiarity of an object that counts as familiar."""

_COLUMNS: Final = [OBJECT_FEATURES.index(name) for name in SHAPE_FEATURES]
_NEAREST: Final = 3
_USUAL: Final = (0.90, 0.97)  # quantiles of the distances within training between which trust goes from 1 to 0
_FIELDS: Final = ("centre", "scale", "known", "span")


@dataclass(frozen=True, eq=False)
class Novelty:
    """Sizes of S training clouds.

    Attributes:
        centre, scale: (8,) float64, which standardise `SHAPE_FEATURES`.
        known: (S, 8) float32, standardised.
        span: (2,) float64: the distance up to which an object is fully familiar, and from which it is not at all.
    """

    centre: Float64
    scale: Float64
    known: Float32
    span: Float64

    @classmethod
    def fit(cls, objects: Float64) -> Novelty:
        """From (S, len(OBJECT_FEATURES)) descriptions of the training clouds; S of at least 5."""
        sizes = objects[:, _COLUMNS]
        centre, scale = standardisation(sizes)
        known = ((sizes - centre) / scale).astype(np.float32)
        distance = np.sort(cdist(known, known, "cityblock"), axis=1)[:, 1 : _NEAREST + 1].mean(axis=1)
        low, high = np.quantile(distance, _USUAL)
        return cls(centre, scale, known, np.array([low, max(high, low + 1e-9)]))

    def familiarity(self, object_features: Float64) -> float:
        """1 for a cloud like those of training, 0 for one that is not; see `FAMILIAR`."""
        sizes = (object_features[_COLUMNS] - self.centre) / self.scale
        distance = np.partition(np.abs(self.known - sizes).sum(axis=1), _NEAREST - 1)[:_NEAREST].mean()
        low, high = self.span
        return float(np.clip((high - distance) / (high - low), 0.0, 1.0))

    def to_tensors(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays by name, for a file."""
        return {name: getattr(self, name) for name in _FIELDS}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]]) -> Novelty:
        """From `to_tensors`.

        Raises:
            ModelError: If an array is missing, of another shape, or holds a value that is not finite; if a scale is not
                above 0, or the span is empty.
        """
        size = len(_COLUMNS)
        for name, shape in (("centre", (size,)), ("scale", (size,)), ("known", (-1, size)), ("span", (2,))):
            if name not in tensors:
                raise ModelError(f"{name}: is missing")
            found = tensors[name]
            fits = found.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, found.shape, strict=True))
            if not fits or not np.isfinite(found).all():
                raise ModelError(f"{name}: shape {found.shape} is not {shape}, or a value is not finite")
        novelty = cls(**{name: tensors[name] for name in _FIELDS})
        if not (novelty.scale > 0.0).all():
            raise ModelError("scale: a value is not above 0")
        if len(novelty.known) < _NEAREST or not novelty.span[0] < novelty.span[1]:
            raise ModelError("known, span: too few clouds, or a span that is empty")
        return novelty
