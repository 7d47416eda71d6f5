# SPDX-License-Identifier: Apache-2.0
"""The learner of the contact model."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.config import setting
from foretouch.learning.data import Dataset, DataSplit, Indices
from foretouch.learning.training.contact import ContactConfig, ContactPredictor
from foretouch.learning.training.learners.learner import CardCalibration, Learner, RunConfig, register
from foretouch.learning.training.run_folder import RunFolder
from foretouch.models.contact.estimator import save_contact
from foretouch.tactile import MODALITIES, TactileRanges
from foretouch.types import Float64


@dataclass(frozen=True, kw_only=True)
class ContactRun(RunConfig):
    """Settings of `method: contact`; calibrated by default, since the model is fitted in seconds."""

    calibrate: bool = setting(True, "Calibrate intervals on held-out predictions; the weights do not depend on it")
    contact: ContactConfig = ContactConfig()

    @property
    def seed(self) -> int:
        """Seed of the trees."""
        return self.contact.seed


@register("contact")
class ContactLearner(Learner[ContactRun]):
    """Fits a contact model at the rest level of all training samples."""

    config_type = ContactRun

    def __init__(self, config: ContactRun, data: Dataset, split: DataSplit) -> None:
        super().__init__(config, data, split)
        self._predictor = ContactPredictor(self.samples, self.labels, config.contact)

    @property
    def ranges(self) -> TactileRanges:
        """Ranges of the hand that it learns from."""
        return self.config.contact.ranges

    def fit(self, chosen: Indices | None = None, run: RunFolder | None = None) -> None:
        """As `Learner.fit`; it takes seconds, so a run that was stopped starts again."""
        del run
        self._estimator = self._predictor.fit(np.arange(len(self.samples)) if chosen is None else chosen)

    def predict(self, index: Indices) -> Float64:
        """As `Learner.predict`."""
        return self._estimator.predict_rows(self._predictor.rows[index])[0]

    def save(
        self, folder: Path, name: str, facts: Mapping[str, Any], calibration: CardCalibration | None = None
    ) -> Path:
        """As `Learner.save`, all files or none."""
        limits = [*facts.get("limits", []), *_limits(self._estimator.generalisation_gain)]
        facts = {**facts, "config": self.config.contact.to_mapping(), "limits": limits}
        return save_contact(folder, name, self._estimator, facts, calibration)


def _limits(gain: Float64) -> list[str]:
    shares = ", ".join(f"{name} {value:.2f}" for name, value in zip(MODALITIES, gain, strict=True))
    return [
        f"Unfamiliar objects get the mean of the training labels and this share of what the kernel predicts beyond it: {shares}.",
        "The camera is taken to look along the vertical: grasps that approach from elsewhere than the camera are unfamiliar.",
    ]
