# SPDX-License-Identifier: Apache-2.0
"""The dominant plane: against known planes, and what is none."""

import re
from itertools import product

import numpy as np
from every_case import every_case

from foretouch.cloud.segmentation.plane import PlaneConfig, fit_plane


def _scene(rng: np.random.Generator, normal: np.ndarray, distance: float, share: float, n: int = 20_000) -> np.ndarray:
    """A square of points with 1 mm noise on a plane, among uniform clutter."""
    normal = normal / np.linalg.norm(normal)
    side = np.linalg.svd(normal[None])[2][1:]
    on = rng.uniform(-0.5, 0.5, (int(n * share), 2)) @ side - distance * normal
    on += rng.normal(0.0, 0.001, (len(on), 1)) * normal
    clutter = rng.uniform(-0.7, 0.7, (n - len(on), 3)) - distance * normal
    return np.concatenate([on, clutter]).astype(np.float32)[rng.permutation(n)]


def test_a_known_plane_is_found_with_its_normal_towards_the_camera(rng: np.random.Generator) -> None:
    def check(direction: tuple[float, ...], share: float) -> None:
        plane, *_ = fit_plane(_scene(rng, np.array(direction, float), 1.1, share), PlaneConfig())
        assert plane is not None
        expected = np.append(np.array(direction) / np.linalg.norm(direction), 1.1)
        # 1 mm of noise over at least a thousand points and half a metre: 0.1 mm and 0.2 mrad, times five.
        np.testing.assert_allclose(plane.coefficients, expected, atol=1e-3)
        assert np.isclose(np.linalg.norm(plane.normal), 1.0)

    every_case(product([(0, 0, -1), (0, -0.6, -0.8), (0.5, -0.5, -0.7), (0, 1, 0)], [0.3, 0.6, 1.0]), check)


def test_what_is_no_plane_is_named(rng: np.random.Generator) -> None:
    def check(reason: str, points: np.ndarray) -> None:
        plane, _, why = fit_plane(points.astype(np.float32), PlaneConfig())
        assert plane is None
        assert re.search(reason, why)

    cases = [
        ("0 points span no plane", np.zeros((0, 3))),
        ("2 points span no plane", np.zeros((2, 3))),
        ("coincide or are collinear", np.ones((100, 3))),
        ("coincide or are collinear", np.linspace((0, 0, 1), (0, 0, 2), 100)),
        ("holds .* of the points, less than 20%", rng.uniform(-1, 1, (5000, 3))),
        ("mm wide, less than 20 mm", rng.normal(0, 0.005, (5000, 3))),
        ("a blob", rng.normal((0, 0, 0.8), 0.03, (5000, 3))),
    ]
    every_case(cases, check)
