# SPDX-License-Identifier: Apache-2.0
"""Hard cases of losses, metrics, preparation of clouds, calibration and training, for `check_outcome`."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from corpus.outcome import nearly
from experiment_samples import make_samples
from run_builders import run_config

from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.errors import ModelError
from foretouch.models import load_model
from foretouch.models.calibration import Calibration
from foretouch.models.network.checkpoint import save_network
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.networks import TouchNet
from foretouch.models.network.preparation import prepare_cloud
from foretouch.tactile import BIOTAC, P2_RANGES, TOUCH_SIZE, TactileRanges, biotac_touch
from foretouch.types import Cloud, GraspSample
from foretouch_lab.learning.data import Dataset
from foretouch_lab.learning.data.training_set import TrainingSet
from foretouch_lab.learning.evaluation import metrics
from foretouch_lab.learning.training import losses
from foretouch_lab.learning.training.calibration import HeldOutPredictions, make_calibration
from foretouch_lab.learning.training.run import train_run
from foretouch_lab.learning.training.supervised import SupervisedTrainer, TrainConfig
from foretouch_lab.learning.training.trainer import set_precision

Cases = Iterator[tuple[Any, ...]]

_ROUNDING = {"float32": 1e-5, "bfloat16": 1e-2, "float16": 2e-3}  # relative, that an answer may show
_LARGEST = {"float32": 1e18, "bfloat16": 1e18, "float16": 6e4}  # whose square or sum is still finite
_MODEL = {"n_points": 32, "tnet": False, "trunk_widths": [8, 16], "head_widths": [16]}
_TRAIN = {"epochs": 2, "batch_size": 4, "device": "cpu"}
_SRGAN = {"epochs": 2, "batch_size": 2, "generator": {"noise_length": 4, "stride": 2}, "device": "cpu"}


def loss_cases() -> Cases:
    """Supervised and SR-GAN losses, their gradients included."""
    ones, equal = np.ones((4, 2)), np.full((3, 4), 0.5)
    for dtype, near in _ROUNDING.items():
        for kind, three in (("rmse", 3.0), ("mse", 9.0)):
            loss, case = partial(_labeled, dtype=dtype, kind=kind), f"losses: {kind} in {dtype}"
            yield f"{case}, zero residual", partial(loss, 0.0 * ones, gradient=True), nearly(0.0)
            yield f"{case}, one sample", partial(loss, np.array([[3.0, 3.0]])), nearly(three, near)
            yield f"{case}, 70,000 equal residuals", partial(loss, np.ones((35_000, 2))), nearly(1.0, near)
        for size in (1e-4, 300.0):
            yield f"losses: residuals of {size:g} in {dtype}", partial(_labeled, size * ones, dtype), nearly(size, near)
        denormal = partial(_labeled, 1e-7 * ones, dtype, gradient=True)
        yield f"losses: denormal residuals in {dtype}", denormal, lambda found: 0.0 <= float(found[0].detach()) < 1e-6
        far = _LARGEST[dtype]
        for variant in ("as_printed", "contrast", "srgan"):
            loss, case = partial(_srgan, variant, dtype), f"losses: {variant} in {dtype}"
            yield f"{case}, equal features", partial(loss, equal, equal, equal)
            yield f"{case}, one sample of each source", partial(loss, equal[:1], 2 * equal[:1], 3 * equal[:1])
            yield f"{case}, fake features of {far:g}", partial(loss, equal, equal, far * equal)
    for dtype in ("int8", "int64", "bool"):
        yield f"losses: labels as {dtype}", partial(_labeled, ones, dtype), "dtype .* is not"
    yield "losses: an empty batch", lambda: _labeled(np.empty((0, 2)), "float32"), "no sample"


def _labeled(residual: Any, dtype: str, kind: str = "rmse", *, gradient: bool = False) -> Any:
    """Loss of residuals, with its gradient if wanted."""
    number = getattr(torch, dtype)
    scaled = torch.from_numpy(residual).to(number).requires_grad_(number.is_floating_point)
    loss = losses.labeled_loss(scaled, torch.zeros_like(scaled), [residual.shape[1]], kind)
    loss.backward()
    return [loss, scaled.grad] if gradient else loss


def _srgan(variant: str, dtype: str, *features: Any) -> list[Any]:
    """Both losses and the gradients of labelled, unlabelled and fake features."""
    config = losses.SrganLossConfig(loss_variant=variant)
    parts = [torch.from_numpy(one).to(getattr(torch, dtype)).requires_grad_() for one in features]
    discriminator = losses.discriminator_loss(torch.tensor(0.5), losses.Features(*parts), config)
    total = discriminator["total"] + losses.matching_loss(parts[2], parts[1].detach(), config)
    total.backward()
    return [total, *discriminator.values(), *(one.grad for one in parts if one.grad is not None)]


def metric_cases() -> Cases:
    """Errors, skills and intervals."""
    labels = 2500.0 + 100.0 * np.random.default_rng(0).normal(size=(6, TOUCH_SIZE))
    mean = np.broadcast_to(labels.mean(axis=0), labels.shape)
    constant, one = np.full((6, TOUCH_SIZE), 2500.0), labels[:1]
    undefined = "the training mean is exact, so the skill is undefined"
    perfect = lambda found: all(row == [0.0, 0.0, 1.0] for row in found.values())  # noqa: E731
    worthless = lambda found: abs(found["PDC_TH"][2]) < 1e-12  # noqa: E731
    for name, predicted, actual, reference, expected in (
        ("perfect", labels, labels, mean, perfect),
        ("the mean", mean, labels, mean, worthless),
        ("one sample", one, one, mean[:1], perfect),
        ("one sample, its own mean", one, one, one, undefined),
        ("constant labels", constant + 1, constant, constant, undefined),
        ("residuals of 1e-200", labels, labels, labels + 1e-200, undefined),
        ("no sample", *[np.empty((0, TOUCH_SIZE))] * 3, "S of at least 1"),
        ("a prediction of NaN", constant * math.nan, labels, mean, "finite"),
        ("an infinite prediction", constant * math.inf, labels, mean, "finite"),
        ("predictions of 1e200", constant * 1e200, labels, mean, "exceeds"),
    ):
        yield f"metrics: {name}", partial(_scores, predicted, actual, reference), expected
    for low, high in ((math.nan, 5.0), (0.0, 5e-324), (-1e308, 1e308)):
        reason = "low < high|finite|is not between"
        yield f"metrics: a range of {low:g} to {high:g}", partial(_in_range, low, high), reason


def _scores(predicted: Any, actual: Any, reference: Any) -> dict[str, list[float]]:
    found = metrics.score(predicted, actual, reference, P2_RANGES.ranges)
    return {name: [one.rmse, one.nrmse, one.skill] for name, one in found.items()}


def _in_range(low: float, high: float) -> list[Any]:
    return [TactileRanges(pdc_th=(low, high)).ranges.scale(np.full(TOUCH_SIZE, 2500.0))]


def preparation_cases() -> Cases:
    """Clouds at the limits of numbers on their way into a network."""
    many = np.random.default_rng(4).normal(size=(750, 3)) * 0.03 + [0.0, 0.0, 1.0]
    line = np.stack([np.linspace(0.0, 0.1, 40), np.zeros(40), np.ones(40)], axis=1)
    for name, points, expected in (
        ("one point", many[:1], "all 1 points coincide"),
        ("two points", many[:2], _in_unit_sphere),
        ("1 nm", 1e-9 * many, "coincide"),
        ("1e29 m", 1e29 * many, _in_unit_sphere),
        ("1e300 m", 1e300 * many, "exceeds 1e.30 m"),
        ("NaN", many * math.nan, "not finite"),
        ("Inf", many * math.inf, "not finite"),
    ):
        yield f"preparation: unit sphere of {name}", partial(_sphere, points), expected
    for name, points, changes in (
        ("32 points as 750", many[:32], {}),
        ("normals of a line", line, {"channels": "xyz+normals"}),
        *((f"{one} sampling", many[[0, 1] * 400], {"sampler": one}) for one in ("random", "voxel", "farthest")),
    ):
        yield f"preparation: {name}", partial(_prepared, points, **changes), lambda found: len(found) == 750


def _sphere(points: Any) -> Any:
    return UnitSphereFrame.fit(points).apply_points(points)


def _in_unit_sphere(points: Any) -> bool:
    return bool(abs(np.linalg.norm(points, axis=1).max() - 1.0) < 1e-9)


def _prepared(points: Any, **changes: Any) -> Any:
    return prepare_cloud(Cloud(points.astype(np.float32)), ModelConfig(n_points=750, **changes)).points


def calibration_cases() -> Cases:
    """Covariances and half widths from held-out predictions."""
    rng = np.random.default_rng(5)
    labels = 2500.0 + 100.0 * rng.normal(size=(12, TOUCH_SIZE))
    constant, noisy = np.full((12, TOUCH_SIZE), 2500.0), labels + 10.0 * rng.normal(size=labels.shape)
    for name, predicted, actual, objects, reason in (
        ("zero residuals", labels, labels, "aaabbbcccddd", None),
        ("constant labels, zero residuals", constant, constant, "aaabbbcccddd", None),
        ("constant labels", noisy, constant, "aaabbbcccddd", None),
        ("constant predictions", constant, labels, "aaabbbcccddd", None),
        ("one object", noisy, labels, "aaaaaaaaaaaa", None),
        ("one object a sample", noisy, labels, "abcdefghijkl", None),
        ("one value off by 4000", labels + 4000.0 * np.eye(12, TOUCH_SIZE), labels, "aaabbbcccddd", None),
        ("the same residual everywhere", labels + 50.0, labels, "aaabbbcccddd", None),
        ("one sample", noisy[:1], labels[:1], "a", None),
        ("no sample", noisy[:0], labels[:0], "", "no sample"),
        ("a residual of NaN", noisy * math.nan, labels, "aaabbbcccddd", "finite"),
        ("an infinite residual", noisy * math.inf, labels, "aaabbbcccddd", "finite"),
        ("residuals of 1e9", labels + 1e9, labels, "aaabbbcccddd", "exceeds"),
    ):
        yield f"calibration: {name}", partial(_calibrated, predicted, actual, objects), reason


def _calibrated(predicted: Any, labels: Any, objects: str) -> list[Any]:
    """A calibration that was written and read."""
    names = np.array(list(objects), np.str_)
    held_out = HeldOutPredictions(predicted, labels, names, names, BIOTAC)
    made, _ = make_calibration(np.full(TOUCH_SIZE, 2500.0), {"known": held_out, "new": held_out})
    return list(Calibration.from_tensors(made.to_tensors(), BIOTAC).to_tensors().values())


def made_samples(objects: int = 3, each: int = 4, *, constant: float | None = None) -> list[GraspSample]:
    """Boxes with plausible labels, or with labels that all have one value [counts]."""
    made = make_samples(objects, each, seed=8)
    if constant is None:
        return made
    return [replace(one, touch=biotac_touch(np.full(TOUCH_SIZE, constant))) for one in made]


def label_cases() -> Cases:
    """Readings at and beyond the ranges of a working sensor."""
    for value in (1.0, 5e-324, 4095.0, 0.0, -1.0, -22072.0, 4095.5, 4096.0, 1e300, math.inf, math.nan):
        samples = made_samples(1, 2, constant=value)
        reason = None if 1.0 <= value <= 4095.0 else "not between 1 and 4095|finite|was not read"
        yield f"training: a reading of {value:g}", partial(_labels, samples), reason
    yield "training: no sample", lambda: _labels([]), "no sample"


def _labels(samples: list[GraspSample]) -> Any:
    return TrainingSet.build(samples, ModelConfig.from_mapping(_MODEL)).labels


def network_cases() -> Cases:
    """Batch norm of one cloud, and networks whose features leave the range of their numbers."""
    yield "network: batch norm of one cloud in training", lambda: _network(1)  # its points are a batch
    yield "network: batch norm of one cloud in prediction", lambda: _network(1, training=False)
    yield "network: batch norm of equal clouds in training", lambda: _network(2)
    for number in ("float32", "bfloat16"):
        for size in (1e-20, 1e4):
            run = partial(_network, 2, number, size, training=False)
            yield f"network: weights times {size:g} in {number}", run
        yield f"network: a step with weights times 1e25 in {number}", partial(_step, number, 1e25), "not finite"
        yield f"network: a step with weights of 0 in {number}", partial(_step, number, 0.0)
    yield "network: a prediction with weights times 1e15", _overflowing, "gives a value that is not finite"


def _network(clouds: int, precision: str = "float32", size: float = 1.0, *, training: bool = True) -> Any:
    torch.manual_seed(0)
    net = TouchNet(ModelConfig.from_mapping(_MODEL))
    set_precision(net, precision)
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
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.mul_(size)


def _overflowing() -> None:
    net = TouchNet(ModelConfig.from_mapping(_MODEL)).eval()
    _multiply(net, 1e15)
    sample = made_samples(1, 1)[0]
    with TemporaryDirectory() as folder:
        model = load_model(save_network(Path(folder), "overflowing", net, {}))
        raise ModelError(model.predict(sample.cloud, [sample.grasp])[0].reason)


def _step(precision: str, size: float) -> Any:
    """One epoch of a network whose weights were multiplied."""
    data = TrainingSet.build(made_samples(), ModelConfig.from_mapping(_MODEL))
    config = TrainConfig(epochs=1, batch_size=4, device="cpu", precision=precision)
    trainer = SupervisedTrainer(data, np.arange(len(data)), config)
    _multiply(trainer.net, size)
    return [trainer.run_epoch(), list(trainer.net.state_dict().values())]


def run_cases() -> Cases:
    """Whole runs with too little to learn, whose model is then loaded and predicts one grasp."""
    same, few = made_samples(constant=2000.0), "fewer than (one batch|five|5)|no sample is unlab"
    for method in ("supervised", "srgan", "contact"):
        yield f"training: {method}, one sample", partial(_run, method, made_samples(1, 1)), few
        yield f"training: {method}, one object", partial(_run, method, made_samples(1, 12))
        reason = "is the same in all samples" if method == "contact" else None
        yield f"training: {method}, constant labels", partial(_run, method, same), reason
    for loss, scaling in itertools.product(("rmse", "mse"), ("standardised", "ranges")):
        run = partial(_run, "supervised", same, target_scaling=scaling, loss=loss)
        yield f"training: {loss} of {scaling} constant labels", run
    for value in (1.0, 4095.0):
        run = partial(_run, "supervised", made_samples(constant=value))
        yield f"training: constant labels of {value:g}", run
    run = partial(_run, "supervised", made_samples())
    yield "training: in bfloat16", partial(run, precision="bfloat16")
    yield "training: a batch of one", partial(run, batch_size=1), "batch_size"
    steep = partial(run, optimiser="sgd", learning_rate=10.0, schedule="constant", epochs=60)
    yield "training: a learning rate of 10", steep, "not finite .*lower learning_rate"


def _run(method: str, samples: list[GraspSample], **train: Any) -> list[Any]:
    """Predictions and bounds of the model of a run."""
    config = run_config(method=method, model=_MODEL, train=_TRAIN | train, srgan=_SRGAN, contact={"trees": 3})
    if method == "srgan":  # half of the samples lose their labels
        samples = [replace(one, touch=None) if k % 2 else one for k, one in enumerate(samples)]
    data = Dataset("made-up", tuple(samples), "0" * 64, {})
    with TemporaryDirectory() as folder:
        model = load_model(train_run(config, data, Path(folder) / "run", lambda _: None))
        prediction = model.predict(samples[0].cloud, [samples[0].grasp])[0]
    if prediction.value is None:
        raise ModelError(prediction.reason)
    return [part.values for part in (prediction.value, prediction.lower, prediction.upper) if part is not None]
