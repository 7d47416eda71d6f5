# SPDX-License-Identifier: Apache-2.0
"""Training in one call of Python: samples in, a touch model out, as `foretouch train` makes it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from foretouch.dataset.samples import SampleSet
from foretouch.errors import ConfigError, DatasetError
from foretouch.models import TouchModel
from foretouch.models.registry import temporary_model
from foretouch.types import Sample
from foretouch_lab.learning.data.dataset import dataset_from
from foretouch_lab.learning.training.run import train_run
from foretouch_lab.learning.training.run_config import load_run_config


def fit(samples: SampleSet | Sequence[Sample] | str | Path, recipe: str, settings: Mapping[str, Any]) -> TouchModel:
    """Train a model on samples; its files are in a temporary folder that lives as long as the model.

    Raises:
        ConfigError: If `data` is among the settings.
        DatasetError: If `calibrate=True` is among the settings, and no calibration can be made.
    """
    if "data" in settings:
        raise ConfigError("data: is given twice, as samples and as a setting")
    data = dataset_from(samples)
    config = load_run_config(recipe).updated(dict(settings), "fit")
    config = config.replace(name=config.name or "model")
    model = temporary_model(lambda folder: train_run(config, data, folder / "model", lambda _: None))
    if settings.get("calibrate") is True and model.calibration is None:
        raise DatasetError(f"calibrate: {model.card['limits'][0]}")
    return model
