# SPDX-License-Identifier: Apache-2.0
"""The dominant plane: against known planes, against Open3D, and under rotation."""

import re
from itertools import product

import numpy as np
import pytest
from every_case import every_case

from foretouch.cloud.segmentation.plane import PlaneConfig, find_table, fit_plane
from foretouch.errors import ConfigError


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


def _level(rng: np.random.Generator, side_m: float, depth_m: float, count: int) -> np.ndarray:
    """A square with 1 mm noise, seen from straight above."""
    return np.column_stack([rng.uniform(-side_m / 2, side_m / 2, (count, 2)), depth_m + rng.normal(0.0, 0.001, count)])


def test_a_table_above_a_larger_floor_carries_things_and_the_top_of_a_box_does_not(rng: np.random.Generator) -> None:
    def check(side_m: float, expected_m: float) -> None:
        points = np.concatenate([_level(rng, 2.0, 1.5, 6000), _level(rng, side_m, 0.9, 4000)])
        plane, *_ = find_table(points.astype(np.float32), PlaneConfig())
        assert plane is not None
        assert abs(plane.offset - expected_m) < 0.003

    every_case({"table": (0.8, 0.9), "box": (0.3, 1.5)}, check)


def test_the_nearest_plane_and_the_one_at_a_point_are_chosen(rng: np.random.Generator) -> None:
    shelf, table, floor = _level(rng, 0.3, 0.7, 3000), _level(rng, 0.5, 0.9, 4000), _level(rng, 2.0, 1.5, 5000)
    points = np.concatenate([shelf, table, floor]).astype(np.float32)

    def check(rule: dict[str, object], expected_m: float) -> None:
        plane, *_ = find_table(points, PlaneConfig(**rule))
        assert plane is not None
        assert abs(plane.offset - expected_m) < 0.003

    cases = {
        "nearest": ({"table": "nearest"}, 0.7),
        "on the table": ({"table": "point", "point": (0.1, 0.0, 0.91)}, 0.9),
        "on the floor": ({"table": "point", "point": (0.9, 0.0, 1.49)}, 1.5),
    }
    every_case(cases, check)
    for wrong in ({"table": "point"}, {"point": (0.0, 0.0, 1.0)}):
        with pytest.raises(ConfigError, match="point"):
            PlaneConfig(**wrong)


def test_a_table_close_to_the_camera_is_found_among_many_things(rng: np.random.Generator) -> None:
    table, things = _level(rng, 0.3, 0.4, 3000), _level(rng, 0.3, 0.39, 4500)
    things[:, 2] -= rng.uniform(0.0, 0.02, len(things))  # 10 to 30 mm high
    plane, noise_per_m, _ = find_table(np.concatenate([table, things]).astype(np.float32), PlaneConfig())
    assert plane is not None
    assert abs(plane.offset - 0.4) < 0.001
    assert noise_per_m * 0.4**2 < 0.002
