# SPDX-License-Identifier: Apache-2.0
"""Hard cases of calibration and training, for `check_outcome`."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from experiment_samples import make_samples
from run_builders import run_config

from foretouch.errors import ModelError
from foretouch.models import load_model
from foretouch.models.calibration import Calibration
from foretouch.tactile import BIOTAC, TOUCH_SIZE, biotac_touch
from foretouch.types import Sample
from foretouch_lab.learning.data import Dataset
from foretouch_lab.learning.training.calibration import HeldOutPredictions, make_calibration
from foretouch_lab.learning.training.run import train_run

Cases = Iterator[tuple[Any, ...]]

_MODEL = {"n_points": 32, "tnet": False, "trunk_widths": [8, 16], "head_widths": [16]}
_TRAIN = {"epochs": 2, "batch_size": 4, "device": "cpu"}
_SRGAN = {"epochs": 2, "batch_size": 2, "generator": {"noise_length": 4, "stride": 2}, "device": "cpu"}


def calibration_cases() -> Cases:
    """Covariances and half widths from held-out predictions."""
    rng = np.random.default_rng(5)
    labels = 2500.0 + 100.0 * rng.normal(size=(12, TOUCH_SIZE))
    constant, noisy = np.full((12, TOUCH_SIZE), 2500.0), labels + 10.0 * rng.normal(size=labels.shape)
    for name, predicted, actual, objects, reason in (
        ("zero residuals", labels, labels, "aaabbbcccddd", None),
        ("constant labels and predictions", constant, constant, "aaabbbcccddd", None),
        ("one object", noisy, labels, "aaaaaaaaaaaa", None),
        ("one value off by 4000", labels + 4000.0 * np.eye(12, TOUCH_SIZE), labels, "aaabbbcccddd", None),
        ("one sample", noisy[:1], labels[:1], "a", None),
        ("no sample", noisy[:0], labels[:0], "", "no sample"),
        ("a residual of NaN", noisy * math.nan, labels, "aaabbbcccddd", "finite"),
        ("residuals of 1e9", labels + 1e9, labels, "aaabbbcccddd", "exceeds"),
    ):
        yield f"calibration: {name}", partial(_calibrated, predicted, actual, objects), reason


def _calibrated(predicted: Any, labels: Any, objects: str) -> list[Any]:
    """A calibration that was written and read."""
    names = np.array(list(objects), np.str_)
    held_out = HeldOutPredictions(predicted, labels, names, names, BIOTAC)
    made, _ = make_calibration(np.full(TOUCH_SIZE, 2500.0), {"known": held_out, "new": held_out})
    return list(Calibration.from_tensors(made.to_tensors(), BIOTAC).to_tensors().values())


def run_cases() -> Cases:
    """Whole runs with too little to learn, whose model is then loaded and predicts one grasp."""
    same = [replace(sample, touch=biotac_touch(np.full(TOUCH_SIZE, 2000.0))) for sample in make_samples(3, 4)]
    few = "fewer than (one batch|five|5)|no sample is unlab"
    for method in ("supervised", "srgan", "contact"):
        yield f"training: {method}, one sample", partial(_run, method, make_samples(1, 1)), few
        yield f"training: {method}, one object", partial(_run, method, make_samples(1, 12))
        yield f"training: {method}, constant labels", partial(_run, method, same), "are the same in all"
    scaled = partial(_run, "supervised", same, target_scaling="ranges", loss="mse")
    yield "training: mse of constant labels scaled by their ranges", scaled, "are the same in all"
    run = partial(_run, "supervised", make_samples(3, 4))
    yield "training: a batch of one", partial(run, batch_size=1), "batch_size"
    steep = partial(run, optimiser="sgd", learning_rate=10.0, schedule="constant", epochs=60)
    yield "training: a learning rate of 10", steep, "not finite .*lower learning_rate"


def _run(method: str, samples: list[Sample], **train: Any) -> list[Any]:
    """Predictions and bounds of the model of a run."""
    config = run_config(method=method, model=_MODEL, train=_TRAIN | train, srgan=_SRGAN, contact={"trees": 3})
    if method == "srgan":  # half of the samples lose their labels
        samples = [replace(sample, touch=None) if k % 2 else sample for k, sample in enumerate(samples)]
    data = Dataset("made-up", tuple(samples), "0" * 64, {})
    with TemporaryDirectory() as folder:
        model = load_model(train_run(config, data, Path(folder) / "run", lambda _: None))
        prediction = model.predict(samples[0].cloud, [samples[0].grasp])[0]
    if not prediction.ok:
        raise ModelError(prediction.reason)
    return [part.values for part in (prediction.value, prediction.lower, prediction.upper)][
        : 3 if prediction.calibrated else 1
    ]
