# SPDX-License-Identifier: Apache-2.0
"""Kernel ridge regression with a Laplacian kernel: a smooth guess that fades to the mean far from what is known.

It is the mean of a Gaussian process with k(x, y) = exp(-γ/F · Σ|x_f - y_f|) over standardised columns [Rasmussen and
Williams 2006, eq. 2.25]: rough enough for touch, and without an opinion where nothing like x was seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from foretouch.errors import ModelError
from foretouch.types import Float32, Float64

__all__ = ["KernelRegression", "laplacian", "standardisation"]

_FIELDS: Final = ("centre", "scale", "known", "weight", "decay")
_CONSTANT: Final = 1e-9  # deviation of a column [m or 1] that is rounding: no point or direction is known so well


@dataclass(frozen=True, eq=False)
class KernelRegression:
    """S known rows of F columns and M outputs in units of their deviation from their mean.

    Attributes:
        centre, scale: (F,) float64, which standardise the columns.
        known: (S, F) float32, the known rows, standardised.
        weight: (S, M) float32.
        decay: () float64, γ.
    """

    centre: Float64
    scale: Float64
    known: Float32
    weight: Float32
    decay: Float64

    def predict(self, rows: Float64) -> Float64:
        """(K, M) float64 for (K, F) rows; 0, the mean, far from all known ones."""
        kernel = laplacian((rows - self.centre) / self.scale, self.known.astype(np.float64), float(self.decay))
        weight = self.weight.astype(np.float64)
        # Row by row, so that a prediction is equal to the last bit whatever rows stand beside it.
        return np.array([row @ weight for row in kernel]).reshape(len(rows), weight.shape[1])

    def to_tensors(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays by name, for a file."""
        return {name: np.asarray(getattr(self, name)) for name in _FIELDS}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]]) -> KernelRegression:
        """From `to_tensors`.

        Raises:
            ModelError: If an array is missing, does not fit the others, or holds a value that is not finite, or a scale or
                the decay is not above 0.
        """
        for name in _FIELDS:
            if name not in tensors:
                raise ModelError(f"{name}: is missing")
            if not np.isfinite(tensors[name]).all():
                raise ModelError(f"{name}: holds a value that is not finite")
        found = cls(**{name: tensors[name] for name in _FIELDS})
        rows, columns = found.weight.shape[:1], found.centre.shape
        fits = found.scale.shape == columns and found.known.shape == rows + columns
        if not fits or len(columns) != 1 or found.weight.ndim != 2 or found.decay.shape != ():
            raise ModelError("kernel: its arrays do not fit together")
        if not (found.scale > 0.0).all() or not found.decay > 0.0:
            raise ModelError("scale, decay: a value is not above 0")
        return found


def laplacian(rows: Float64, known: Float64, decay: float) -> Float64:
    """(K, S) float64 kernel of (K, F) and (S, F) standardised rows."""
    return np.asarray(np.exp(-decay / rows.shape[1] * cdist(rows, known, "cityblock")), np.float64)


def standardisation(rows: Float64) -> tuple[Float64, Float64]:
    """Mean and deviation of each column; 1 where a column is constant."""
    deviation = rows.std(axis=0)
    return rows.mean(axis=0), np.where(deviation > _CONSTANT, deviation, 1.0)
