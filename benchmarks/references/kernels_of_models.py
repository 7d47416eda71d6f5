# SPDX-License-Identifier: Apache-2.0
"""References of the kernels of the models: features, regressors, novelty, calibration, networks, losses, scores."""

import mpmath
import numpy as np
import torch

from benchmarks.references.reference import (
    EPS32,
    Exact,
    Float64,
    covariance,
    eigen,
    exact,
    exp,
    far_or_round,
    float32_cloud,
    gap,
    kernel,
    norm,
    real,
    relative_gap,
    rotation,
    span,
    spread_points,
    sqrt,
)
from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.models.contact.features import FEATURES, HandFrameFeatures
from foretouch.models.contact.regressors import KernelRegression
from foretouch.models.network.length_check import grasp_lengths
from foretouch.models.network.preparation import PreparedCloud
from foretouch.models.object_shape import object_sizes
from foretouch.tactile import BIOTAC, MODALITIES
from foretouch.types import Grasp
from foretouch_lab.learning.network.pointnet import batch_affine
from foretouch_lab.learning.training.calibration import HeldOutPredictions, _quantile_by_object, _shrunk, fit_group
from foretouch_lab.learning.training.losses import SrganLossConfig, matching_loss

_COLUMN = {name: k for k, name in enumerate(FEATURES)}


def _scene(t: float, rng: np.random.Generator) -> tuple[Float64, Grasp]:
    """An object far away, or with two nearly equal eigenvalues, and a grasp on it."""
    far, difference = far_or_round(t, rng, 1e4)
    shape = spread_points(rng, 40, [0.008, 0.03 * (1.0 - difference), 0.03])
    place = far * np.array([0.1, -0.1, 1.0])
    points = float32_cloud(shape @ rotation(rng).T + place).astype(np.float64)
    hand = rotation(rng)
    middle = points.mean(axis=0) + 0.005
    return points, Grasp(middle + 0.03 * hand[:, 2], middle - 0.03 * hand[:, 2], hand)


def _sizes(points: Float64) -> tuple[Exact, Exact, Float64]:
    """Mean, eigenvectors and eigenvalues."""
    mean, spread = covariance(exact(points))
    values, vectors = eigen(spread)
    return mean, vectors, real(values)


def _quantile(values: Exact, share: float) -> Exact:
    ordered = np.sort(values)
    at = exact(share) * (len(ordered) - 1)
    k = min(int(at), len(ordered) - 2)
    return ordered[k] + (at - k) * (ordered[k + 1] - ordered[k])


@kernel("features: lengths")
def _lengths(t: float, rng: np.random.Generator) -> tuple[float, float]:
    points, grasp = _scene(t, rng)
    row, sizes = HandFrameFeatures(points).describe([grasp])[0], object_sizes(points)
    mean, _, values = _sizes(points)
    p, hand, size = exact(points), exact(grasp.rotation), np.sqrt(values[2])
    away = norm(p - mean)
    middle = (exact(grasp.g1) + exact(grasp.g2)) / 2
    _, exact_values = covariance(p)
    spreads = sqrt(eigen(exact_values)[0])
    sign = -1.0 if grasp.rotation[2, 0] < 0.0 else 1.0  # the hand's X points away from the camera
    centre = (mean - middle) @ hand * exact(np.array([sign, sign, 1.0]))
    wanted: dict[str, Exact] = {
        **{f"spread_{k + 1}": value for k, value in enumerate(spreads)},
        **{f"radius_q{round(100 * q)}": _quantile(away, q) for q in (0.25, 0.5, 0.75)},
        **{f"centre_hand_{axis}": centre[k] for k, axis in enumerate("xyz")},
        "width": norm(exact(grasp.g1) - exact(grasp.g2)),
        "offset": norm(middle - mean),
        "distance": norm(mean),
    }
    kappa = float(np.abs(points).max()) / size * np.sqrt(values[2] / values[0])
    errors = [gap(row[_COLUMN[name]], value) for name, value in wanted.items()]
    lengths = [*(p[:, k].max() - p[:, k].min() for k in range(3)), *spreads, away.max()]
    errors += [gap(found, value) for found, value in zip(sizes[:-1], lengths, strict=True)]
    return kappa, max(errors) / size


@kernel("kernel regression")
def _regression(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Rows farther and farther from the training rows, down to kernel values of 1e-300."""
    centre, scale = rng.normal(size=6), rng.uniform(0.1, 2.0, 6)
    known = rng.normal(size=(10, 6)).astype(np.float32)
    weight = rng.normal(size=(10, 3)).astype(np.float32)
    row = centre + scale * span(t, 1.0, 600.0) * rng.uniform(0.5, 1.0, 6)
    decay = 1.2
    found = KernelRegression(centre, scale, known, weight, np.array(decay)).predict(row[None])[0]
    z = (exact(row) - exact(centre)) / exact(scale)
    exponent = exact(decay) / 6 * np.abs(z - exact(known)).sum(axis=1)
    k = exp(-exponent)
    size = k @ np.abs(exact(weight))
    return 1.0 + float(exponent.max()), float(np.max(np.abs(exact(found) - k @ exact(weight)) / size))


@kernel("calibration: W, slope, spread")
def _fit(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Readings that vary less and less about 3000 counts: they are centred first."""
    sessions = np.repeat(["a", "b", "c"], 4)
    noise = span(t, 100.0, 8.0)  # below, the floor of 0.29 counts of rounding takes over
    predicted = 3000.0 + noise * rng.normal(size=(12, 50))
    labels = predicted + noise * (0.3 * rng.normal(size=(12, 50)))
    group = fit_group(HeldOutPredictions(predicted, labels, sessions, sessions, BIOTAC))
    x, y = exact(predicted), exact(labels)
    spread = ((y - x) ** 2).sum(axis=0) / 12
    for k in range(3):
        mine = slice(4 * k, 4 * k + 4)
        x[mine], y[mine] = (v[mine] - v[mine].sum(axis=0) / 4 for v in (x, y))
    unit = sqrt((y**2).sum(axis=0) / 12)
    slope = exact(np.empty(50))
    for name in MODALITIES:
        column = BIOTAC.columns([name])
        a, b = x[:, column] / unit[column], y[:, column] / unit[column]
        slope[column] = min((a * b).sum() / (a * a).sum(), mpmath.mpf(1))
    within = ((y - slope * x) ** 2).sum(axis=0) / 9
    error = max(
        relative_gap(group.within, within),
        relative_gap(group.difference_shrinkage, slope),
        relative_gap(group.spread, spread),
    )
    return 1.0, error


@kernel("calibration: B")
def _between(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Moments of 25 pairs of values: from covariances to what has a negative eigenvalue, or almost no variance."""
    diagonal = rng.uniform(0.5, 1.0, (25, 2)) * span(t, 1.0, 1e-9) * 1e4
    product = rng.uniform(-1.0, 1.0, 25) * (0.5 + 2.0 * t) * np.sqrt(diagonal.prod(axis=1))
    within, shrinkage = rng.uniform(50.0, 500.0, 50), 0.2
    order = rng.permutation(50).reshape(25, 2)
    moments = np.zeros((50, 50))
    for (i, j), (a, b), c in zip(order, diagonal, product, strict=True):
        moments[i, i], moments[j, j], moments[i, j], moments[j, i] = a, b, c, c
    found = _shrunk(moments, within, shrinkage)
    error = 0.0
    for pair in order:
        part = exact(moments[np.ix_(pair, pair)])
        deviation = sqrt(np.maximum(np.diag(part), exact(0.05) * exact(within[pair])))
        values, vectors = eigen(part / np.outer(deviation, deviation))
        clipped = (vectors * np.maximum(values, exact(0.0))) @ vectors.T
        size = sqrt(np.maximum(np.diag(clipped), exact(1.0)))
        correlation = exact(shrinkage) * clipped / np.outer(size, size)
        np.fill_diagonal(correlation, exact(1.0).item())
        error = max(error, gap(exact(found[np.ix_(pair, pair)]) / np.outer(deviation, deviation), correlation))
    return 1.0, error


@kernel("conformal quantile")
def _conformal(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Objects with very different numbers of samples, at the level where the weights add up exactly."""
    counts = np.sort(rng.integers(1, int(span(t, 3.0, 300.0)), 4))
    names = np.repeat(list("abcd"), counts)
    scores = rng.random((len(names), 1))
    weight = exact(1.0) / (4 * exact(np.repeat(counts, counts)))
    order = np.argsort(scores[:, 0])
    reached = np.cumsum(weight[order])
    k = int(rng.integers(0, len(order)))
    level = float(reached[k])  # a tie up to its own rounding
    found = int(np.flatnonzero(scores[order, 0] == _quantile_by_object(scores, names, level))[0])
    below = reached[found - 1] if found else mpmath.mpf(0)
    # The score is the quantile of all levels above the weight below it, up to the weight with it.
    return len(order), float(max(below - level, level - reached[found], mpmath.mpf(0)))


@kernel("batch norm by moments")
def _batch_norm(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Inputs that vary less and less about their mean, down to 3e-4 of it: they are centred first."""
    x = torch.from_numpy((1.0 + span(t, 1.0, 3e-4) * rng.normal(size=(4, 40, 3))).astype(np.float32))
    torch.manual_seed(int(rng.integers(1 << 30)))
    linear, norm_ = torch.nn.Linear(3, 5), torch.nn.BatchNorm1d(5, eps=1e-12)
    weight, bias = batch_affine(x, linear, norm_)
    with torch.no_grad():
        wide = x.double().flatten(0, 1)
        z = wide @ linear.weight.double().T + linear.bias.double()
        deviation = (z.var(dim=0, unbiased=False) + 1e-12).sqrt()
        wanted = linear.weight.double() / deviation[:, None]
        wanted_bias = (linear.bias.double() - z.mean(dim=0)) / deviation
    pairs = ((weight.detach(), wanted), (bias.detach(), wanted_bias))
    return 1.0, max(float((found.double() - one).abs().max() / one.abs().max()) for found, one in pairs)


@kernel("feature matching (eqs. 3, 5)")
def _matching(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Batches whose mean features agree more and more."""
    a = rng.uniform(0.5, 1.0, (8, 16)).astype(np.float32)
    b = (a + span(t, 0.5, 1e-4) * rng.uniform(0.5, 1.0, a.shape)).astype(np.float32)
    config = SrganLossConfig(loss_variant="srgan")
    found = float(matching_loss(torch.from_numpy(a), torch.from_numpy(b), config))
    delta = (exact(a) - exact(b)).sum(axis=0) / 8
    wanted = np.abs(delta).sum() / 16
    return float(np.abs(b).max() / float(np.abs(delta).min())), relative_gap(found, wanted)


@kernel("gap of the range check")
def _range_gap(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """A contact nearer and nearer to a point of the cloud."""
    cloud = float32_cloud(rng.uniform(-0.05, 0.05, (30, 3)))
    frame = UnitSphereFrame.fit(cloud)
    points = frame.apply_points(cloud).astype(np.float32)
    g1 = points[0] * frame.scale + frame.centre + span(t, 0.5, 1e-6) * frame.scale * rotation(rng)[0]
    grasp = Grasp(g1, g1 + 1e-9, np.eye(3))
    found = grasp_lengths(PreparedCloud(points, frame), [grasp])[0, 4] / frame.scale
    targets = (exact(np.stack([grasp.g1, grasp.g2])) - exact(frame.centre)) / exact(frame.scale)
    wanted = norm(targets[:, None] - exact(points)[None]).min(axis=1).max()
    size = 1.0 + float((targets**2).sum(axis=1).max())
    return min(size / float(wanted), np.sqrt(size / EPS32)), gap(found, wanted)
