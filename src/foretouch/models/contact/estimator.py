# SPDX-License-Identifier: Apache-2.0
"""The contact model: touch from the geometry at each contact.

    cloud, grasp ─► 88 features ─┬─ forests ── readings of similar training grasps ───────┐
                                 └─ kernel ─── an estimate that fades to the mean ─────────┴─ w·forests + (1 - w)·kernel
    cloud ─► 8 sizes ─► novelty detector ─► in-distribution score w, 1 … 0

Forests predict best on objects that were trained on, and worse than the mean of the training labels on others.
The kernel's parameters are selected on objects left out, so that it predicts only what generalises.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import ModelError
from foretouch.models.contact.features import FEATURES, OBJECT_FEATURES, ContactScene
from foretouch.models.contact.forest import Forest
from foretouch.models.contact.kernel_regression import KernelRegression
from foretouch.models.files import TensorRecord, read_part
from foretouch.models.novelty import IN_DISTRIBUTION, SizeNoveltyDetector
from foretouch.models.touch_model import Estimate
from foretouch.tactile import MODALITIES, P2_RANGES, TactileRanges, columns
from foretouch.types import TOUCH_SIZE, Cloud, Float64, Grasp

__all__ = ["TOGETHER", "ContactEstimator"]

TOGETHER: Final = "together"
"""Name of the forest with all values as outputs."""


@dataclass(frozen=True, eq=False)
class ContactEstimator:
    """A fitted contact model; immutable, so threads may share it.

    Attributes:
        forests: One for all 50 values together, and one for each modality; a value is the mean of its two.
        kernel: Of all 50 values.
        novelty: Fitted to the training objects.
        mean, deviation: (50,) float64 of the training labels [counts], which standardise the outputs of forests and kernel.
        ranges: Ranges outside which a predicted value is flagged.
    """

    forests: Mapping[str, Forest]
    kernel: KernelRegression
    novelty: SizeNoveltyDetector
    mean: Float64
    deviation: Float64
    ranges: TactileRanges = P2_RANGES

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """See `Estimator.estimate`."""
        return Estimate(*self.predict_rows(ContactScene(cloud.xyz).describe(grasps)))

    def predict_rows(self, rows: Float64) -> tuple[Float64, npt.NDArray[np.bool_]]:
        """Predict from feature rows, each of which may be of another object.

        Args:
            rows: (K, len(FEATURES)) of `ContactScene.describe`.

        Returns:
            (K, 50) [counts], and (K,) whether the object is in distribution.
        """
        scores = np.array([self.novelty.in_distribution_score(row[: len(OBJECT_FEATURES)]) for row in rows])
        weight = scores[:, None]
        scaled = weight * self._trees(rows) + (1.0 - weight) * self.kernel.predict(rows)
        return scaled * self.deviation + self.mean, scores >= IN_DISTRIBUTION

    def _trees(self, rows: Float64) -> Float64:
        scaled = self.forests[TOGETHER].predict(rows)
        for name in MODALITIES:
            index = columns([name])
            scaled[:, index] = (scaled[:, index] + self.forests[name].predict(rows)) / 2.0
        return scaled

    def to_tensors(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays by name, for a file."""
        parts: dict[str, TensorRecord] = {"kernel": self.kernel, "novelty": self.novelty}
        parts |= {f"forest_{name}": forest for name, forest in self.forests.items()}
        tensors = {f"{part}/{key}": value for part, one in parts.items() for key, value in one.to_tensors().items()}
        return tensors | {"mean": self.mean, "deviation": self.deviation}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]], ranges: TactileRanges) -> ContactEstimator:
        """From `to_tensors`.

        Raises:
            ModelError: Names the array that is missing or damaged.
        """
        for name in ("mean", "deviation"):
            if name not in tensors or tensors[name].shape != (TOUCH_SIZE,) or not np.isfinite(tensors[name]).all():
                raise ModelError(f"{name}: is missing, of another shape, or not finite")
        forests = {}
        for name in (TOGETHER, *MODALITIES):
            forests[name] = read_part(Forest, tensors, f"forest_{name}/")
            size = TOUCH_SIZE if name == TOGETHER else len(columns([name]))
            if forests[name].output_size != size or forests[name].feature.max() >= len(FEATURES):
                raise ModelError(f"forest_{name}: does not fit {len(FEATURES)} features and {size} values")
        kernel = read_part(KernelRegression, tensors, "kernel/")
        if kernel.known.shape[1] != len(FEATURES) or kernel.weight.shape[1] != TOUCH_SIZE:
            raise ModelError(f"kernel: does not fit {len(FEATURES)} features and {TOUCH_SIZE} values")
        novelty = read_part(SizeNoveltyDetector, tensors, "novelty/")
        return cls(forests, kernel, novelty, tensors["mean"], tensors["deviation"], ranges)
