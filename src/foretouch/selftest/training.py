# SPDX-License-Identifier: Apache-2.0
"""Hard cases of training: runs of a second on made-up samples that leave nothing, or too little, to learn."""

import json
import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.errors import ModelError
from foretouch.selftest.case import HardCase
from foretouch.types import TOUCH_SIZE, Cloud, Grasp, GraspSample, Touch

_MODEL = {"n_points": 32, "tnet": False, "trunk_widths": [8, 16], "head_widths": [16]}
_METHODS: dict[str, dict[str, Any]] = {
    "supervised": {"model": _MODEL, "train": {"epochs": 2, "batch_size": 4}},
    "srgan": {
        "model": _MODEL,
        "srgan": {"epochs": 2, "batch_size": 2, "generator": {"widths": [6], "stride": 2, "channels": 3}},
    },
    "contact": {"contact": {"trees": 3}},
}
_FEW = "fewer than (one batch|five|5)"


def training_cases() -> Iterator[HardCase]:
    """All cases of this module."""
    yield from label_cases()
    yield from network_cases()
    yield from run_cases()


def made_samples(objects: int = 3, each: int = 4, *, constant: float | None = None) -> list[GraspSample]:
    """Boxes of 3 to 9 cm with plausible labels, or with labels that all have one value [counts]."""
    rng = np.random.default_rng(8)
    made = []
    for number in range(objects * each):
        size = rng.uniform(0.03, 0.09, 3)
        cloud = Cloud((rng.uniform(-0.5, 0.5, (60, 3)) * size + [0.0, 0.0, 1.2]).astype(np.float32))
        ends = np.array([[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]]) * size + [0.0, 0.0, 1.2]
        label = rng.uniform(1000.0, 3000.0, TOUCH_SIZE) if constant is None else np.full(TOUCH_SIZE, constant)
        name = f"box{number % objects}"
        stamp = (1_562_000_000 + 60 * number) * 1_000_000_000
        grasp = Grasp(ends[0], ends[1], np.eye(3))
        made.append(GraspSample(f"{name}/{number}", name, cloud, grasp, Touch.from_vector(label), stamp_ns=stamp))
    return made


# --- labels -----------------------------------------------------------------------------------------------------


def label_cases() -> Iterator[HardCase]:
    """Readings at and beyond the ranges of a working sensor."""
    for value in (1.0, 5e-324, 4095.0):
        yield HardCase(
            f"training: all readings {value:g}", partial(_labels, value), right=lambda rows: rows.min() > 0.0
        )
    for value in (0.0, -1.0, -22072.0, 4095.5, 4096.0, 1e300, math.inf, math.nan):
        yield HardCase(f"training: a reading of {value:g}", partial(_labels, value), "not between 0 and 4095|finite")
    yield HardCase("training: no sample", lambda: _prepared([]), "no sample")
    unlabelled = [replace(one, touch=None) for one in made_samples(1, 2)]
    yield HardCase("training: no label", lambda: _prepared(unlabelled), "is not labelled")


def _labels(value: float) -> Any:
    return _prepared([replace(one, touch=Touch.from_vector(np.full(TOUCH_SIZE, value))) for one in made_samples(1, 2)])


def _prepared(samples: list[GraspSample]) -> Any:
    from foretouch.learning.data import TrainingSet
    from foretouch.models.network.config import ModelConfig

    return TrainingSet.build(samples, ModelConfig.from_mapping(_MODEL)).labels


# --- networks ---------------------------------------------------------------------------------------------------


def network_cases() -> Iterator[HardCase]:
    """Batch norm of one cloud, and networks whose features leave the range of their numbers."""
    yield HardCase("network: batch norm of one cloud in training", lambda: _network(1))  # its points are a batch
    yield HardCase("network: batch norm of one cloud in prediction", lambda: _network(1, training=False))
    yield HardCase("network: batch norm of equal clouds in training", lambda: _network(2))
    for precision in ("float32", "bfloat16"):
        for size in (1e-20, 1e4):
            yield HardCase(
                f"network: weights of {size:g} in {precision}", partial(_network, 2, precision, size, training=False)
            )
        yield HardCase(
            f"network: a step with weights of 1e25 in {precision}", partial(_step, precision, 1e25), "not finite"
        )
        yield HardCase(f"network: a step with weights of 0 in {precision}", partial(_step, precision, 0.0))
    yield HardCase(
        "network: a prediction with weights of 1e15", lambda: _overflowing(1e15), "gives a value that is not finite"
    )


def _network(clouds: int, precision: str = "float32", size: float = 1.0, *, training: bool = True) -> Any:
    import torch

    from foretouch.learning.training.device import DeviceConfig, TrainingDevice
    from foretouch.models.network.config import ModelConfig
    from foretouch.models.network.networks import TouchNet

    torch.manual_seed(0)
    net = TouchNet(ModelConfig.from_mapping(_MODEL))
    TrainingDevice.of(DeviceConfig(device="cpu", precision=precision), 2).prepare(net)
    _multiply(net, size)
    points = torch.rand(1, 32, 3).expand(clouds, 32, 3).contiguous()
    grasps = torch.rand(1, net.config.grasp_size).expand(clouds, -1)
    if not training:
        with torch.inference_mode():
            return net.eval()(points, grasps)
    answer = net.train()(points, grasps)
    answer.sum().backward()
    return [answer, *(one.grad for one in net.parameters() if one.grad is not None)]


def _multiply(net: Any, size: float) -> None:
    """Multiply all weights of a network."""
    import torch

    with torch.no_grad():
        for parameter in net.parameters():
            parameter.mul_(size)


def _overflowing(size: float) -> Any:
    """A prediction by a model file whose weights were multiplied."""
    from foretouch.models.network.checkpoint import save_network
    from foretouch.models.network.config import ModelConfig
    from foretouch.models.network.networks import TouchNet
    from foretouch.models.registry import load_model

    net = TouchNet(ModelConfig.from_mapping(_MODEL)).eval()
    _multiply(net, size)
    sample = made_samples(1, 1)[0]
    with tempfile.TemporaryDirectory() as folder:
        model = load_model(save_network(Path(folder), "overflowing", net, {}))
        prediction = model.predict(sample.cloud, [sample.grasp])[0]
    raise ModelError(prediction.reason)


def _step(precision: str, size: float) -> Any:
    """One epoch of a network whose weights were multiplied."""
    from foretouch.learning.data import TrainingSet
    from foretouch.learning.training.supervised import SupervisedTrainer, TrainConfig
    from foretouch.models.network.config import ModelConfig

    data = TrainingSet.build(made_samples(), ModelConfig.from_mapping(_MODEL))
    config = TrainConfig(epochs=1, batch_size=4, device="cpu", precision=precision)
    trainer = SupervisedTrainer(data, np.arange(len(data)), config)
    _multiply(trainer.net, size)
    return [trainer.run_epoch(), list(trainer.net.state_dict().values())]


# --- runs -------------------------------------------------------------------------------------------------------


def run_cases() -> Iterator[HardCase]:
    """Whole runs, whose model is then loaded and predicts one grasp."""
    constant = "is the same in all samples"
    for method in _METHODS:
        yield HardCase(
            f"training: {method}, one sample", partial(_run, method, made_samples(1, 1)), _FEW + "|no sample is unlab"
        )
        yield HardCase(f"training: {method}, one object", partial(_run, method, made_samples(1, 12)))
        yield HardCase(
            f"training: {method}, constant labels",
            partial(_run, method, made_samples(constant=2000.0)),
            constant if method == "contact" else "",
        )
    for scaling in ("standardised", "ranges"):
        for loss in ("rmse", "mse"):
            yield HardCase(
                f"training: {loss} of {scaling} constant labels",
                partial(_run, "supervised", made_samples(constant=2000.0), target_scaling=scaling, loss=loss),
            )
    for value in (1.0, 4095.0):
        yield HardCase(
            f"training: constant labels of {value:g}", partial(_run, "supervised", made_samples(constant=value))
        )
    yield HardCase("training: in bfloat16", lambda: _run("supervised", made_samples(), precision="bfloat16"))
    yield HardCase("training: a batch of one", lambda: _run("supervised", made_samples(), batch_size=1), "batch_size")
    yield HardCase(
        "training: a learning rate of 10",
        lambda: _run("supervised", made_samples(), optimiser="sgd", learning_rate=10.0, schedule="constant", epochs=60),
        "not finite .*lower learning_rate",
    )


def _run(method: str, samples: list[GraspSample], **train: Any) -> list[Any]:
    """Predictions and bounds of the model of a run."""
    from foretouch.learning.data import Dataset
    from foretouch.learning.training.learners import read_run_config
    from foretouch.learning.training.run import train_run
    from foretouch.models.registry import load_model

    given = json.loads(json.dumps({"name": "tiny", "method": method, **_METHODS[method]}))
    if method != "contact":
        given["train" if method == "supervised" else method].update(train, device="cpu")
    if method == "srgan":  # half of the samples lose their labels
        samples = [replace(one, touch=None) if k % 2 else one for k, one in enumerate(samples)]
    data = Dataset("made-up", tuple(samples), "0" * 64, {})
    with tempfile.TemporaryDirectory() as folder:
        card = train_run(read_run_config(given), data, Path(folder) / "run", lambda _: None)
        model = load_model(card)
        prediction = model.predict(samples[0].cloud, [samples[0].grasp])[0]
    if prediction.value is None:
        raise ModelError(prediction.reason)
    return [part.vector() for part in (prediction.value, prediction.lower, prediction.upper) if part is not None]
