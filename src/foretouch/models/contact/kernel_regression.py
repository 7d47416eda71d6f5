# SPDX-License-Identifier: Apache-2.0
"""Kernel ridge regression with a Laplacian kernel: a smooth estimate that fades to the mean far from the training data.

It is the mean of a Gaussian process with k(x, y) = exp(-γ/F · Σ|x_f - y_f|) over standardised columns [Rasmussen and
Williams 2006, eq. 2.25], whose samples are as rough as tactile readings.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from foretouch.errors import ModelError
from foretouch.models.files import TensorRecord
from foretouch.types import Float32, Float64


@dataclass(frozen=True, eq=False)
class KernelRegression(TensorRecord):
    """S training rows of F columns and M outputs in units of their deviation from their mean.

    Attributes:
        centre, scale: (F,) float64, which standardise the columns.
        known: (S, F) float32, the training rows, standardised.
        weight: (S, M) float32.
        decay: () float64, γ.
    """

    centre: Float64
    scale: Float64
    known: Float32
    weight: Float32
    decay: Float64

    def predict(self, rows: Float64) -> Float64:
        """(K, M) float64 for (K, F) rows; 0, the mean, far from all training rows."""
        kernel = laplacian((rows - self.centre) / self.scale, self.known.astype(np.float64), float(self.decay))
        weight = self.weight.astype(np.float64)
        # Row by row, so that a prediction is equal to the last bit whatever the other rows are.
        return np.array([row @ weight for row in kernel]).reshape(len(rows), weight.shape[1])

    def _check(self) -> None:
        for name, array in self.to_tensors().items():
            if not np.isfinite(array).all():
                raise ModelError(f"{name}: holds a value that is not finite")
        rows, columns = self.weight.shape[:1], self.centre.shape
        fits = self.scale.shape == columns and self.known.shape == rows + columns
        if not fits or len(columns) != 1 or self.weight.ndim != 2 or self.decay.shape != ():
            raise ModelError("kernel: its arrays do not fit together")
        if not (self.scale > 0.0).all() or not self.decay > 0.0:
            raise ModelError("scale, decay: a value is not above 0")


def laplacian(rows: Float64, known: Float64, decay: float) -> Float64:
    """(K, S) float64 kernel of (K, F) and (S, F) standardised rows."""
    return np.asarray(np.exp(-decay / rows.shape[1] * cdist(rows, known, "cityblock")), np.float64)
