# SPDX-License-Identifier: Apache-2.0
"""Training in one call of Python: samples in, a touch model out, as `foretouch train` makes it."""

import tempfile
import weakref
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from foretouch.dataset.samples import SampleSet
from foretouch.models import TouchModel, load_model
from foretouch.types import Sample
from foretouch_lab.learning.data.dataset import dataset_of, load_dataset
from foretouch_lab.learning.training.run import train_run
from foretouch_lab.learning.training.run_config import load_run_config


def fit(samples: SampleSet | Sequence[Sample] | str | Path, recipe: str, settings: Mapping[str, Any]) -> TouchModel:
    """Train a model on samples; its files are in a temporary folder that lives as long as the model."""
    if isinstance(samples, str | Path):
        data = load_dataset(samples)
    elif isinstance(samples, SampleSet):
        data = dataset_of(list(samples), samples.path.name, samples.sensor)
    else:
        data = dataset_of(list(samples))
    config = load_run_config(recipe).updated(dict(settings), "fit")
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="foretouch-fit-")))
        model = load_model(
            train_run(config.replace(name=config.name or "model"), data, folder / "model", lambda _: None)
        )
        weakref.finalize(model, stack.pop_all().close)
    return model
