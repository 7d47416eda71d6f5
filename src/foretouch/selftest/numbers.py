# SPDX-License-Identifier: Apache-2.0
"""Hard cases of what turns numbers into numbers: losses, metrics, preparation of clouds, calibration, contact."""

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from foretouch.errors import DatasetError
from foretouch.selftest.case import HardCase, nearly
from foretouch.types import TOUCH_SIZE, Cloud, Float64

_TYPES = ("float32", "bfloat16", "float16")
_HALF = {"float32": 1e-5, "bfloat16": 1e-2, "float16": 2e-3}  # relative rounding that an answer may show
_READINGS = ("as_printed", "contrast", "srgan")
_CONTRASTS = ("sqrt", "log", "abs", "ratio")


def number_cases() -> Iterator[HardCase]:
    """All cases of this module."""
    yield from loss_cases()
    yield from metric_cases()
    yield from preparation_cases()
    yield from calibration_cases()
    yield from contact_cases()


# --- losses -----------------------------------------------------------------------------------------------------


def loss_cases() -> Iterator[HardCase]:
    """Supervised and SR-GAN losses, their gradients included."""
    for name in _TYPES:
        yield from _labeled(name)
        yield from _srgan(name)
    for name in ("int8", "int64", "bool"):
        yield HardCase(f"losses: labels as {name}", partial(_labeled_loss, np.ones((4, 2)), name), "dtype .* is not")
    yield HardCase(
        "losses: pairs of unequal batches",
        lambda: _srgan_loss("contrast", "float32", np.ones((2, 3)), np.ones((1, 3)), np.ones((2, 3))),
        "2 and 1 samples cannot be compared",
    )
    yield HardCase("losses: an empty batch", lambda: _labeled_loss(np.empty((0, 2)), "float32"), "no sample")


def _labeled(name: str) -> Iterator[HardCase]:
    near = _HALF[name]
    ones = np.ones((4, 2))
    for kind in ("rmse", "mse"):
        case = f"losses: {kind} in {name}"
        yield HardCase(f"{case}, zero residual", partial(_labeled_loss, 0 * ones, name, kind), right=nearly(0.0))
        yield HardCase(
            f"{case}, one sample",
            partial(_labeled_value, np.array([[3.0, 3.0]]), name, kind),
            right=nearly(3.0 if kind == "rmse" else 9.0, near),
        )
        yield HardCase(
            f"{case}, equal residuals of 70,000 values",
            partial(_labeled_value, np.ones((35000, 2)), name, kind),
            right=nearly(1.0, near),
        )
    yield HardCase(
        f"losses: rmse in {name}, residuals of 1e-4",
        lambda: _labeled_loss(1e-4 * ones, name)[0],
        right=nearly(1e-4, near),
    )
    yield HardCase(
        f"losses: rmse in {name}, residuals of 300",
        lambda: _labeled_loss(300.0 * ones, name)[0],
        right=nearly(300, near),
    )
    yield HardCase(
        f"losses: rmse in {name}, denormal residuals",
        lambda: _labeled_loss(1e-7 * ones, name),
        right=lambda found: 0.0 <= float(found[0].detach()) < 1e-6,
    )


def _labeled_loss(residual: Float64, name: str, kind: str = "rmse") -> tuple[Any, Any]:
    """Loss and gradient of residuals."""
    import torch

    from foretouch.learning.training.losses import labeled_loss

    dtype = getattr(torch, name)
    scaled = torch.from_numpy(residual).to(dtype).requires_grad_(dtype.is_floating_point)
    loss = labeled_loss(scaled, torch.zeros_like(scaled), [residual.shape[1]], kind)
    loss.backward()  # type: ignore[no-untyped-call]
    return loss, scaled.grad


def _labeled_value(residual: Float64, name: str, kind: str = "rmse") -> Any:
    """The loss alone."""
    return _labeled_loss(residual, name, kind)[0]


def _srgan(name: str) -> Iterator[HardCase]:
    equal = np.full((3, 4), 0.5)
    far = {"float32": 1e18, "bfloat16": 1e18, "float16": 6e4}[name]
    for reading in _READINGS:
        case = f"losses: {reading} in {name}"
        yield HardCase(f"{case}, equal features", partial(_srgan_loss, reading, name, equal, equal, equal))
        yield HardCase(
            f"{case}, one sample of each source",
            partial(_srgan_loss, reading, name, equal[:1], 2 * equal[:1], 3 * equal[:1]),
        )
        yield HardCase(
            f"{case}, fake features of {far:g}", partial(_srgan_loss, reading, name, equal, equal, far * equal)
        )
    for contrast in _CONTRASTS:
        yield HardCase(
            f"losses: contrast {contrast} in {name}, unbounded features",
            partial(_contrast_slope, contrast, name, far),
            right=lambda slope: (
                float(slope) <= 0.1 * (1.0 + _HALF[name])
            ),  # w_F times a slope of at most one, shared out
        )


def _srgan_loss(reading: str, name: str, labeled: Float64, unlabeled: Float64, fake: Float64) -> list[Any]:
    """Both losses and the gradients of all features."""
    import torch

    from foretouch.learning.training import losses

    config = losses.SrganLossConfig(reading=reading)
    parts = [torch.from_numpy(one).to(getattr(torch, name)).requires_grad_() for one in (labeled, unlabeled, fake)]
    discriminator = losses.discriminator_loss(torch.tensor(0.5), losses.Features(*parts), config)
    total = discriminator.total + losses.generator_loss(parts[2], parts[1].detach(), config).total
    total.backward()  # type: ignore[no-untyped-call]
    return [total, discriminator.numbers(), *(one.grad for one in parts if one.grad is not None)]


def _contrast_slope(contrast: str, name: str, far: float) -> Any:
    """Sum of the slopes of the discriminator's loss in the fake features."""
    import torch

    from foretouch.learning.training import losses

    config = losses.SrganLossConfig(contrast=contrast, weight_unlabeled=0.0)
    zeros = torch.zeros(5, 4, dtype=getattr(torch, name))
    fake = torch.full_like(zeros, far).requires_grad_()
    loss = losses.discriminator_loss(torch.tensor(0.0), losses.Features(zeros, zeros, fake), config)
    loss.total.backward()  # type: ignore[no-untyped-call]
    return torch.as_tensor(fake.grad).double().abs().sum()


# --- metrics ----------------------------------------------------------------------------------------------------


def metric_cases() -> Iterator[HardCase]:
    """Errors, skills and intervals."""
    labels = 2500.0 + 100.0 * np.random.default_rng(0).normal(size=(6, TOUCH_SIZE))
    mean = np.broadcast_to(labels.mean(axis=0), labels.shape)
    constant = np.full((6, TOUCH_SIZE), 2500.0)
    yield HardCase("metrics: perfect", lambda: _scores(labels, labels, mean), right=_all_scores(0.0, 1.0))
    yield HardCase(
        "metrics: the mean", lambda: _scores(mean, labels, mean), right=lambda s: abs(s["PDC_TH"][2]) < 1e-12
    )
    undefined = "the training mean is exact, so the skill is undefined"
    yield HardCase("metrics: constant labels", lambda: _scores(constant + 1, constant, constant), undefined)
    yield HardCase("metrics: one sample, its own mean", lambda: _scores(labels[:1], labels[:1], labels[:1]), undefined)
    yield HardCase(
        "metrics: one sample", lambda: _scores(labels[:1], labels[:1], mean[:1]), right=_all_scores(0.0, 1.0)
    )
    yield HardCase("metrics: no sample", lambda: _scores(*[np.empty((0, TOUCH_SIZE))] * 3), "S of at least 1")
    for value in (math.nan, math.inf):
        yield HardCase(f"metrics: a prediction of {value}", partial(_scores, constant * value, labels, mean), "finite")
    yield HardCase("metrics: predictions of 1e200", lambda: _scores(constant * 1e200, labels, mean), "exceeds")
    yield HardCase("metrics: residuals of 1e-200", lambda: _scores(labels, labels, labels + 1e-200), undefined)
    yield HardCase("metrics: zero range", lambda: _ranges((5.0, 5.0)), "low < high")
    yield HardCase("metrics: range reversed", lambda: _ranges((6.0, 5.0)), "low < high")
    yield HardCase("metrics: range of NaN", lambda: _ranges((math.nan, 5.0)), "not finite|low < high|finite")
    yield HardCase("metrics: range of one denormal", lambda: _ranges((0.0, 5e-324)), "high - low is not between")
    yield HardCase("metrics: infinite range", lambda: _ranges((-1e308, 1e308)), "high - low is not between")
    yield from _comparisons(labels)


def _scores(predicted: Float64, actual: Float64, reference: Float64) -> dict[str, list[float]]:
    from foretouch.learning.evaluation.metrics import score

    return {name: [one.rmse, one.nrmse, one.skill] for name, one in score(predicted, actual, reference).items()}


def _all_scores(rmse: float, skill: float) -> Any:
    return lambda found: all(row == [rmse, rmse, skill] for row in found.values())


def _ranges(limits: tuple[float, float]) -> list[Any]:
    from foretouch.tactile import TactileRanges

    ranges = TactileRanges(pdc_th=limits)
    return [ranges.scale(np.full(TOUCH_SIZE, 2500.0)), ranges.unscale(np.full(TOUCH_SIZE, 0.5))]


def _comparisons(labels: Float64) -> Iterator[HardCase]:
    squares = (labels - 2500.0) ** 2

    def compare(objects: int, ours: Float64, reference: Float64) -> Any:
        from foretouch.learning.evaluation.metrics import BootstrapConfig, ObjectErrors
        from foretouch.learning.evaluation.metrics import compare as compared

        one, other = (
            ObjectErrors(tuple("abcdefgh"[:objects]), np.ones(objects), rows[:objects], reference[:objects])
            for rows in (ours, squares)
        )
        return [str(row) for row in compared(one, other, BootstrapConfig(draws=100))]

    yield HardCase("metrics: comparison of one object", lambda: compare(1, squares, squares))
    yield HardCase("metrics: comparison of equal predictors", lambda: compare(6, squares, squares))
    yield HardCase(
        "metrics: comparison with an exact mean", lambda: compare(6, squares, 0.0 * squares), "exact|undefined|mean"
    )


# --- preparation ------------------------------------------------------------------------------------------------


def preparation_cases() -> Iterator[HardCase]:
    """Clouds and grasps on their way into a network."""
    rng = np.random.default_rng(4)
    many = rng.normal(size=(750, 3)) * 0.03 + [0.0, 0.0, 1.0]
    colours = rng.integers(0, 255, (750, 3), dtype=np.uint8)
    yield HardCase("preparation: unit sphere of no point", lambda: _sphere(many[:0]), "N > 0")
    yield HardCase("preparation: unit sphere of one point", lambda: _sphere(many[:1]), "all 1 points coincide")
    yield HardCase("preparation: unit sphere of equal points", lambda: _sphere(many[[0] * 40]), "points coincide")
    yield HardCase("preparation: unit sphere of two points", lambda: _sphere(many[:2]), right=_unit)
    yield HardCase("preparation: unit sphere of 1 nm", lambda: _sphere(1e-9 * many), "coincide")
    yield HardCase("preparation: unit sphere of 1e29 m", lambda: _sphere(1e29 * many), right=_unit)
    yield HardCase("preparation: unit sphere of 1e300 m", lambda: _sphere(1e300 * many), "exceeds 1e.30 m")
    for value in (math.nan, math.inf):
        yield HardCase(f"preparation: unit sphere with {value}", partial(_sphere, many * value), "not finite")
    for count in (0, 1, 31):
        yield HardCase(f"preparation: {count} points", partial(_prepared, many[:count]), "fewer than 32")
    yield HardCase("preparation: 32 points as 750", lambda: _prepared(many[:32]), right=_shaped(750, 3))
    yield HardCase("preparation: equal points", lambda: _prepared(many[[0] * 40]), "in one place")
    yield HardCase(
        "preparation: 750 x 6 with colours", lambda: _prepared(many, colours, "xyz+rgb"), right=_shaped(750, 6)
    )
    yield HardCase("preparation: 750 x 6 without colours", lambda: _prepared(many, None, "xyz+rgb"), "has no rgb")
    yield HardCase("preparation: 750 x 6 normals", lambda: _prepared(many, None, "xyz+normals"), right=_shaped(750, 6))
    line = np.stack([np.linspace(0.0, 0.1, 40), np.zeros(40), np.ones(40)], axis=1)
    yield HardCase(
        "preparation: normals of a line", lambda: _prepared(line, None, "xyz+normals"), right=_shaped(750, 6)
    )
    for sampler in ("random", "voxel", "farthest"):
        yield HardCase(
            f"preparation: {sampler} sampling of two places",
            partial(_prepared, many[[0, 1] * 400], None, "xyz", sampler),
            right=_shaped(750, 3),
        )


def _sphere(points: Float64) -> Float64:
    from foretouch.cloud.geometry.sampling import UnitSphereFrame

    return UnitSphereFrame.fit(points).apply_points(points)


def _unit(points: Float64) -> bool:
    return bool(abs(np.linalg.norm(points, axis=1).max() - 1.0) < 1e-9)


def _prepared(points: Float64, rgb: Any = None, channels: str = "xyz", sampler: str = "random") -> Any:
    from foretouch.models.network.config import ModelConfig
    from foretouch.models.network.preparation import prepare_cloud

    config = ModelConfig(n_points=750, channels=channels, sampler=sampler)
    return prepare_cloud(Cloud(points.astype(np.float32), rgb), config).points


def _shaped(*shape: int) -> Any:
    return lambda points: points.shape == shape


# --- calibration ------------------------------------------------------------------------------------------------


def calibration_cases() -> Iterator[HardCase]:
    """Covariances and intervals from held-out predictions, and their adaptation to touches."""
    rng = np.random.default_rng(5)
    labels = 2500.0 + 100.0 * rng.normal(size=(12, TOUCH_SIZE))
    constant = np.full((12, TOUCH_SIZE), 2500.0)
    noisy = labels + 10.0 * rng.normal(size=labels.shape)
    objects = ["a", "a", "a", "b", "b", "b", "c", "c", "c", "d", "d", "d"]
    for name, predicted, actual, names in (
        ("zero residuals", labels, labels, objects),
        ("constant labels, zero residuals", constant, constant, objects),
        ("constant labels", noisy, constant, objects),
        ("constant predictions", constant, labels, objects),
        ("one object", noisy, labels, ["a"] * 12),
        ("one object a sample", noisy, labels, list("abcdefghijkl")),
        ("one object a sample, zero residuals", labels, labels, list("abcdefghijkl")),
        ("residuals of 1e-12", labels + 1e-12, labels, objects),
        ("one value off by 4000", labels + 4000.0 * np.eye(12, TOUCH_SIZE), labels, objects),
        ("the same residual everywhere", labels + 50.0, labels, objects),
    ):
        yield HardCase(f"calibration: {name}", partial(_calibrated, predicted, actual, names))
    yield HardCase("calibration: one sample", lambda: _calibrated(noisy[:1], labels[:1], ["a"]))
    yield HardCase("calibration: no sample", lambda: _calibrated(noisy[:0], labels[:0], []), "no sample")
    for value in (math.nan, math.inf):
        yield HardCase(
            f"calibration: a residual of {value}", partial(_calibrated, noisy * value, labels, objects), "finite"
        )
    yield HardCase("calibration: residuals of 1e9", lambda: _calibrated(labels + 1e9, labels, objects), "exceeds")


def _calibrated(predicted: Float64, labels: Float64, names: list[str]) -> list[Any]:
    """Adapted predictions and half widths for 0 to 100 touches, of a calibration that was written and read."""
    from foretouch.learning.evaluation.prequential import Recording, predict_after
    from foretouch.learning.training.calibration import HeldOutPredictions, make_calibration
    from foretouch.models.calibration import Calibration

    held_out = HeldOutPredictions(predicted, labels, np.array(names, np.str_), np.array(names, np.str_))
    made, _ = make_calibration(np.full(TOUCH_SIZE, 2500.0), {"known": held_out, "new": held_out})
    calibration = Calibration.from_tensors(made.to_tensors())
    every = Recording(np.arange(1, 1 + len(labels)), held_out.objects, labels, predicted)
    found: list[Any] = []
    for count in (0, 1, 100):
        found += predict_after(
            calibration, every.take(np.zeros(count, np.intp)), every.take(np.arange(len(labels))[:3])
        )
    return found


# --- contact ----------------------------------------------------------------------------------------------------


def contact_cases() -> Iterator[HardCase]:
    """Contact of a pad with a surface, by all three solvers."""
    for level in ("hertz", "winkler", "layer"):
        for kind, value in (("force_n", 0.0), ("depth_m", 0.0), ("depth_m", -1.0)):
            yield HardCase(
                f"contact: {level}, {kind} {value:g}", partial(_force, level, kind, value), right=nearly(0.0)
            )
        for kind in ("force_n", "depth_m"):
            for value in (5e-324, 1e-300, 1e300, math.inf, math.nan):
                yield HardCase(f"contact: {level}, {kind} {value:g}", partial(_force, level, kind, value), kind)
        yield HardCase(f"contact: {level}, 1e-30 N", partial(_force, level, "force_n", 1e-30), right=nearly(1e-30))
        yield HardCase(
            f"contact: {level}, 1e30 N", partial(_force, level, "force_n", 1e30), "compressed by|window is wide"
        )
        yield HardCase(
            f"contact: {level}, 1 m deep", partial(_force, level, "depth_m", 1.0), "compressed by|window is wide"
        )
    for name, gap, reason in (
        ("no surface", np.full((24, 24), np.inf), "nowhere in the window"),
        ("NaN", np.full((24, 24), np.nan), "holds NaN"),
        ("no cell", np.zeros((0, 0)), "is not .N, N."),
        ("not square", np.zeros((3, 4)), "is not .N, N."),
        ("overlapping", np.full((24, 24), -1.0), "least value"),
    ):
        yield HardCase(f"contact: a gap of {name}", partial(_pressed, "winkler", "force_n", 1.0, gap), reason)
    for level, reason in (("hertz", "too close|is flat|cuts"), ("winkler", ""), ("layer", "")):
        one = np.full((24, 24), np.inf)
        one[12, 12] = 0.0
        yield HardCase(
            f"contact: {level}, a needle of one cell", partial(_pressed, level, "force_n", 0.01, one), reason
        )
        yield HardCase(
            f"contact: {level}, a flat", partial(_pressed, level, "force_n", 0.5, np.zeros((24, 24))), reason
        )


def _force(level: str, kind: str, value: float) -> float:
    offset = (np.arange(24) - 11.5) * 5e-4
    gap = (offset[:, None] ** 2 + offset**2) / 0.02
    return _pressed(level, kind, value, gap - gap.min())


def _pressed(level: str, kind: str, value: float, gap: Float64) -> float:
    """Force of a contact [N]; its pressure must be finite and at least 0."""
    from foretouch.simulation.contact import Command, ContactProblem, Layer, solve_contact

    skin = Layer(modulus_pa=1.552e6, poisson=0.316, thickness_m=0.0015)
    solution = solve_contact(ContactProblem(gap, 5e-4, (skin,)), Command(**{kind: value}), level)  # type: ignore[arg-type]
    if not (np.isfinite(solution.pressure).all() and solution.pressure.min() >= 0.0):
        raise DatasetError("the pressure is not finite or negative")
    return solution.force_n
