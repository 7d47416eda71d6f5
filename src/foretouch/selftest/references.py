# SPDX-License-Identifier: Apache-2.0
"""Kernels against references in exact or double arithmetic, and invariances of the pipeline.

A few of each, for the user's machine: other libraries or instructions of the processor show here.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.selftest.case import HardCase
from foretouch.selftest.clouds import across, bar, scene
from foretouch.types import TOUCH_SIZE, Cloud, Float32, Float64, Grasp

_STEP, _UNITS = 10, 4096.0  # spacing of the points, in units of 2^-12 m


def exact_cloud() -> Cloud:
    """Top and front of a tilted box of 68 x 71 x 95 mm: 1876 points, the same bits on every machine.

    Its sizes are those of the objects that the released models know, so that they do not answer with their mean.
    """
    width, depth, height = np.arange(28), np.arange(29), np.arange(1, 39)
    tops, fronts = np.meshgrid(width, depth), np.meshgrid(width, height)
    x = np.concatenate([one[0].ravel() for one in (tops, fronts)])
    y = np.concatenate([tops[1].ravel(), 0 * fronts[1].ravel()])
    z = np.concatenate([0 * tops[1].ravel(), fronts[1].ravel()])
    turned = np.stack([13 * x, 5 * y - 12 * z, 12 * y + 5 * z], axis=1) * _STEP // 13
    return Cloud(((turned + np.array([0, 0, 4700])) / _UNITS).astype(np.float32))


def exact_grasps() -> list[Grasp]:
    """Three grasps of `exact_cloud`."""
    middle = np.array([140.0, -60.0, 4820.0]) / _UNITS
    aside = np.array([0.0, 40.0, 40.0]) / _UNITS
    return [across(288 / _UNITS, middle, 0), across(288 / _UNITS, middle + aside, 0), across(256 / _UNITS, middle, 1)]


# --- references -------------------------------------------------------------------------------------------------


def reference_cases() -> Iterator[HardCase]:
    """Each case returns the error of a kernel over its bound."""
    for name, bound, error in _ERRORS:
        yield HardCase(f"reference: {name}", partial(_ratio, error, bound), right=lambda ratio: bool(ratio <= 1.0))


def _ratio(error: Callable[[], float], bound: float) -> float:
    return error() / bound


def _table() -> float:
    """Normal and distance of a table tilted by 0.6 rad, against the plane that made it."""
    from foretouch.cloud.segmentation.segment import segment

    found = segment(Cloud(scene(0.6))).plane
    if found is None:
        raise AssertionError("no table is found")
    true = np.array([0.0, math.sin(0.6), math.cos(0.6), -0.9 * math.cos(0.6)])
    coefficients = np.asarray(found.coefficients)
    return float(min(np.abs(sign * coefficients - true).max() for sign in (1.0, -1.0)))


def _normals() -> float:
    """Normals by summed moments, against eigenvectors of each neighbourhood's covariance about its mean."""
    from foretouch.cloud.geometry.pcl_filters import normals_and_curvature

    xyz = exact_cloud().xyz
    query = np.arange(0, len(xyz), 97)
    normals, curvature = normals_and_curvature(xyz, query)
    worst = 0.0
    for k, found, bent in zip(query, normals, curvature, strict=True):
        near = xyz[((xyz - xyz[k]).astype(np.float64) ** 2).sum(axis=1) < 0.03**2].astype(np.float64)
        values, vectors = np.linalg.eigh(np.cov(near.T, bias=True))
        sine = float(np.linalg.norm(np.cross(vectors[:, 0], found)))
        worst = max(worst, sine, abs(float(bent) - float(values[0] / values.sum())))
    return worst


def _centroid() -> float:
    """Centroid and radius of the unit sphere, against sums of fractions."""
    from foretouch.cloud.geometry.sampling import UnitSphereFrame

    points = (bar()[:300] + np.array([0.0, 0.0, 1000.0])).astype(np.float32)
    frame = UnitSphereFrame.fit(points)
    zero = Fraction(0)
    exact = [sum((Fraction(float(x)) for x in column), zero) / len(points) for column in points.T]
    squares = [sum(((Fraction(float(x)) - m) ** 2 for x, m in zip(row, exact, strict=True)), zero) for row in points]
    radius = math.sqrt(max(squares))
    errors = [abs(Fraction(float(c)) - m) / abs(m) for c, m in zip(frame.centre, exact, strict=True) if abs(m) > 1]
    return float(max(*errors, Fraction(abs(frame.scale - radius) / radius)))


def _hertz() -> float:
    """Force of a ball of 10 mm on a half-space by the layer solver, against Hertz."""
    from foretouch.simulation.contact import Command, ContactProblem, Layer, solve_layer

    depth, radius, n = 1e-4, 0.01, 48
    body = Layer(modulus_pa=1e6, poisson=0.3)
    step = 2.6 * math.sqrt(radius * depth) / n
    offset = (np.arange(n) - (n - 1) / 2.0) * step
    gap = (offset[:, None] ** 2 + offset**2) / (2.0 * radius)
    force = solve_layer(ContactProblem(gap - gap.min(), step, (body,)), Command(depth_m=depth)).force_n
    expected = 4.0 / 3.0 * body.plane_modulus_pa * math.sqrt(radius) * depth**1.5
    return float(abs(force / expected - 1.0))


def _scores() -> float:
    """Error and skill, against fractions."""
    from foretouch.learning.evaluation.metrics import score

    rng = np.random.default_rng(9)
    predicted, actual, mean = rng.integers(1, 4096, (3, 5, TOUCH_SIZE)).astype(np.float64)
    found = score(predicted, actual, mean)["PDC_TH"]
    error, reference = (
        sum((Fraction(float(a)) - Fraction(float(b))) ** 2 for a, b in zip(one[:, 0], actual[:, 0], strict=True)) / 5
        for one in (predicted, mean)
    )
    return max(abs(found.rmse / math.sqrt(error) - 1.0), abs(found.skill - float(1 - error / reference)))


def _adaptation() -> float:
    """Adaptation to touches with independent values, against b r / (b + w / n)."""
    from foretouch.models.state_space import TrackerParameters
    from foretouch.models.tracker import SensorTracker

    rng = np.random.default_rng(10)
    between, within, residual = rng.uniform(1.0, 4e3, (3, TOUCH_SIZE))
    zeros, ones = np.zeros(TOUCH_SIZE), np.ones(TOUCH_SIZE)
    parameters = TrackerParameters.from_calibration((np.diag(between),) * 2, (within,) * 2, (ones,) * 2, np.ones(4))
    tracker = SensorTracker(replace(parameters, alarm=np.full_like(parameters.alarm, 1e6)))
    for _ in range(3):
        tracker.add_touch(1, residual, zeros)
    found = tracker.predict(1, zeros[None])[0][0]
    exact = np.array(
        [
            float(Fraction(b) * Fraction(r) / (Fraction(b) + Fraction(w) / 3))
            for b, w, r in zip(between.tolist(), within.tolist(), residual.tolist(), strict=True)
        ]
    )
    return float(np.abs(found / exact - 1.0).max())


def _impedance() -> float:
    """Impedance of an electrode, against fractions."""
    from foretouch.tactile.readings import to_kohm

    counts = np.arange(1.0, 4095.0)
    exact = np.array([float((Fraction(4095, int(n)) - 1) * 10) for n in counts])
    return float(np.abs(to_kohm(counts) / exact - 1.0).max())


def _loss() -> float:
    """Root mean square loss in float32, against fractions."""
    import torch

    from foretouch.learning.training.losses import labeled_loss

    rows = np.random.default_rng(11).normal(size=(20, 24)).astype(np.float32)
    found = float(labeled_loss(torch.from_numpy(rows), torch.zeros(20, 24), [24]))
    exact = math.sqrt(sum(Fraction(float(x)) ** 2 for x in rows.ravel()) / rows.size)
    return abs(found / exact - 1.0)


def _network() -> float:
    """The released network, folded and in float32, against its layers in float64 [counts]."""
    import torch

    from foretouch.models.network.checkpoint import load_network
    from foretouch.models.network.folding import fold
    from foretouch.models.network.preparation import prepare_cloud, prepare_grasps
    from foretouch.models.registry import find_card

    net, _ = load_network(find_card("touchnet-v1"))
    prepared = prepare_cloud(exact_cloud(), net.config)
    points = torch.from_numpy(prepared.points)[None]
    grasps = torch.from_numpy(prepare_grasps(exact_grasps(), prepared.frame, net.config))
    with torch.inference_mode():
        folded = fold(net)
        found = folded.regress(folded.features(points[0]), grasps)
        exact = net.double().counts(points.double().expand(len(grasps), -1, -1), grasps.double())
    return float((found.double() - exact).abs().max())


_ERRORS: tuple[tuple[str, float, Callable[[], float]], ...] = (
    ("plane of a table [m, 1]", 1e-4, _table),
    ("normals and curvature [1]", 1e-9, _normals),
    ("centroid and radius 1 km away [relative]", 1e-12, _centroid),
    ("Hertz by the layer solver [relative]", 0.01, _hertz),
    ("error and skill [relative]", 1e-12, _scores),
    ("adaptation to touches [relative]", 1e-12, _adaptation),
    ("impedance [relative]", 1e-12, _impedance),
    ("loss in float32 [relative]", 1e-5, _loss),
    ("released network in float32 [counts]", 0.1, _network),
)
"""Kernel with its unit, bound of its error, and function that returns the error."""


# --- invariances ------------------------------------------------------------------------------------------------


def invariance_cases() -> Iterator[HardCase]:
    """What must not change an answer, to the bit."""
    for name in ("contact-v1", "touchnet-v1"):
        yield HardCase(f"invariance: {name}, grasps alone or together", partial(_alone, name), right=_zero)
        yield HardCase(f"invariance: {name}, the same call twice", partial(_twice, name), right=_zero)
        yield HardCase(f"invariance: {name}, order of grasps", partial(_reordered, name), right=_zero)
    yield HardCase("invariance: order of points, grasps", _shuffled_grasps, right=_zero)
    yield HardCase("invariance: order of points, contact-v1", _shuffled_touch, right=lambda worst: bool(worst <= 1e-6))
    yield HardCase("invariance: segmentation, the same call twice", _segmented_twice, right=_zero)


def _zero(difference: float) -> bool:
    return difference == 0.0


@lru_cache(maxsize=2)
def _model(name: str) -> Any:
    from foretouch.models import load_model

    return load_model(name)


def _counts(name: str, grasps: list[Grasp], cloud: Cloud | None = None) -> Float64:
    predictions = _model(name).predict(exact_cloud() if cloud is None else cloud, grasps)
    return np.array([[part.vector() for part in (one.value, one.lower, one.upper)] for one in predictions])


def _alone(name: str) -> float:
    grasps = exact_grasps()
    alone = np.concatenate([_counts(name, [one]) for one in grasps])
    return float(np.abs(_counts(name, grasps) - alone).max())


def _twice(name: str) -> float:
    return float(np.abs(_counts(name, exact_grasps()) - _counts(name, exact_grasps())).max())


def _reordered(name: str) -> float:
    return float(np.abs(_counts(name, exact_grasps()) - _counts(name, exact_grasps()[::-1])[::-1]).max())


def _shuffled() -> Float32:
    return np.random.default_rng(12).permutation(exact_cloud().xyz)


def _shuffled_grasps() -> float:
    """Largest move of a contact of any grasp, by the method of the live nodes [m]."""
    from foretouch.grasp import GeoGraspConfig, plan_grasps
    from foretouch.types import ASSUMED_TABLE

    config = GeoGraspConfig(method="stable")
    one, other = (plan_grasps(Cloud(xyz), ASSUMED_TABLE, config).grasps for xyz in (exact_cloud().xyz, _shuffled()))
    if len(one) != len(other) or not one:
        raise AssertionError(f"{len(one)} and {len(other)} grasps")
    return max(float(np.abs([a.g1 - b.g1, a.g2 - b.g2]).max()) for a, b in zip(one, other, strict=True))


def _shuffled_touch() -> float:
    """Largest difference [counts]."""
    ours, theirs = _counts("contact-v1", exact_grasps()), _counts("contact-v1", exact_grasps(), Cloud(_shuffled()))
    return float(np.abs(ours - theirs).max())


def _segmented_twice() -> float:
    """Largest difference of the objects' points [m]."""
    from foretouch.cloud.segmentation.segment import segment

    clouds: list[npt.NDArray[np.float32]] = []
    for _ in range(2):
        found = segment(Cloud(scene()))
        clouds.append(np.concatenate([one.cloud.xyz for one in found.objects]))
    return float(np.abs(clouds[0] - clouds[1]).max())
