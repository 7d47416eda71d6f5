# SPDX-License-Identifier: Apache-2.0
"""Which plane is the table, in scenes whose table is known, and which is doubted."""

import numpy as np
import pytest
from every_case import every_case

from foretouch.cloud.segmentation.plane import PlaneConfig, fit_plane
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.cloud.segmentation.table import find_table
from foretouch.errors import ConfigError
from foretouch.types import Cloud


def _level(rng: np.random.Generator, side_m: float, depth_m: float, count: int) -> np.ndarray:
    """A square with 1 mm noise, seen from straight above."""
    return np.column_stack([rng.uniform(-side_m / 2, side_m / 2, (count, 2)), depth_m + rng.normal(0.0, 0.001, count)])


def test_a_table_above_a_larger_floor_carries_things_and_the_top_of_a_box_does_not(rng: np.random.Generator) -> None:
    def check(side_m: float, expected_m: float) -> None:
        floor = _level(rng, 2.0, 1.5, 7000)
        floor = floor[np.abs(floor[:, :2]).max(axis=1) > side_m / 2 / 0.9 * 1.5]  # what the table does not hide
        points = np.concatenate([floor[:6000], _level(rng, side_m, 0.9, len(floor[:6000]) * 2 // 3)])
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
    for wrong, name in (
        ({"table": "point"}, "point"),
        ({"point": (0.0, 0.0, 1.0)}, "point"),
        ({"table": "given", "coefficients": (0.0, 0.0, 1.0)}, "coefficients"),
        ({"coefficients": (0.0, 0.0, 1.0, -1.0)}, "coefficients"),
    ):
        with pytest.raises(ConfigError, match=f"^{name}: . numbers: table"):
            PlaneConfig(**wrong)


def test_a_table_close_to_the_camera_is_found_among_many_things(rng: np.random.Generator) -> None:
    table, things = _level(rng, 0.3, 0.4, 3000), _level(rng, 0.3, 0.39, 4500)
    things[:, 2] -= rng.uniform(0.0, 0.02, len(things))  # 10 to 30 mm high
    plane, noise_per_m, _ = find_table(np.concatenate([table, things]).astype(np.float32), PlaneConfig())
    assert plane is not None
    assert abs(plane.offset - 0.4) < 0.001
    assert noise_per_m * 0.4**2 < 0.002


def _frame(rng: np.random.Generator, side_m: float, depth_m: float, count: int) -> np.ndarray:
    """The rim of a bin: a square frame of 4 cm, seen from straight above."""
    points = _level(rng, side_m, depth_m, 12 * count)
    return points[np.abs(points[:, :2]).max(axis=1) > side_m / 2 - 0.04][:count]


def _offset(points: list[np.ndarray], **changes: object) -> tuple[float, str]:
    """The distance of the table from the camera, and why it is doubted."""
    plane, _, reason = find_table(np.concatenate(points).astype(np.float32), PlaneConfig(**changes))
    assert plane is not None
    return plane.offset, reason


def test_a_rim_is_seen_through_and_the_floor_below_it_is_the_table(rng: np.random.Generator) -> None:
    """A wide rim above a larger floor, and one with most points of all."""

    def check(of_rim: int, of_floor: int) -> None:
        distance, reason = _offset([_frame(rng, 0.8, 0.7, of_rim), _level(rng, 0.7, 0.95, of_floor)])
        assert (abs(distance - 0.95) < 0.003, reason) == (True, "")

    every_case([(3000, 7000), (5000, 4000), (7000, 4000)], check)


def test_what_a_second_camera_sees_below_a_table_does_not_speak_against_it(rng: np.random.Generator) -> None:
    points = np.concatenate([_level(rng, 0.8, 0.7, 6000), _level(rng, 0.7, 0.95, 2000)]).astype(np.float32)
    assert abs(find_table(points, PlaneConfig())[0].offset - 0.95) < 0.003
    table, _, reason = find_table(points, PlaneConfig(), one_view=False)
    assert (abs(table.offset - 0.7) < 0.003, reason) == (True, "")


def test_the_top_of_a_box_that_fills_the_image_is_no_table(rng: np.random.Generator) -> None:
    table, top, clutter = _level(rng, 1.2, 1.0, 20_000), _level(rng, 0.4, 0.7, 4000), _level(rng, 1.2, 0.9, 4000)
    table = table[np.abs(table[:, :2]).max(axis=1) > 0.23 / 0.7][:3500]  # the box hides the rest
    clutter[:, 2] += rng.uniform(-0.1, 0.05, len(clutter))
    clutter = clutter[np.abs(clutter[:, :2]).max(axis=1) > 0.23 / 0.7][:1500]
    assert abs(_offset([table, top, clutter])[0] - 1.0) < 0.003
    thing = _level(rng, 0.05, 0.65, 100)
    assert abs(_offset([table, top, clutter, thing])[0] - 0.7) < 0.003  # a stool that something stands on


def _bin(tilt: float, turn: float, slope: float, size: int = 120) -> tuple[np.ndarray, float]:
    """The points of a bin with sloping walls, seen from a tilted camera within its walls, and the distance of its floor."""
    rays = np.stack(np.meshgrid(*[np.linspace(-0.62, 0.62, size)] * 2), axis=-1).reshape(-1, 2)
    rays = np.column_stack([rays, np.ones(len(rays))])
    turned = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    tilted = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    to_bin = turned @ tilted
    # Inside of the bin n p < d for its floor at z = 0.55 and four walls around it; the camera is at the origin.
    walls = [(np.cos(a), np.sin(a), slope) for a in np.arange(4) * np.pi / 2]
    normals = np.array([(0.0, 0.0, 1.0), *walls])
    ends = np.array([0.55, *[0.15 + 0.55 * slope] * 4])
    along = rays @ to_bin.T @ normals.T
    reach = np.min(np.where(along > 1e-9, ends / np.maximum(along, 1e-9), np.inf), axis=1)
    return rays * reach[:, None], 0.55


def test_the_floor_of_a_bin_is_preferred_to_its_larger_walls(rng: np.random.Generator) -> None:
    def check(tilt: float, turn: float, slope: float) -> None:
        points, floor_m = _bin(tilt, turn, slope)
        points = points + rng.normal(0.0, 0.0008, points.shape)
        assert abs(_offset([points])[0] - floor_m) < 0.004

    every_case(
        [(tilt, turn, slope) for tilt in (0.0, 0.15, -0.2) for turn in (0.0, 0.4) for slope in (0.4, 0.6)], check
    )


def _pile_without_floor(rng: np.random.Generator) -> np.ndarray:
    """An image (H, W, 3) of a full bin: balls that hide its floor, within a rim."""
    h, w = 240, 320
    rays = np.stack(
        [*np.meshgrid((np.arange(w) - w / 2) / 260.0, (np.arange(h) - h / 2) / 260.0), np.ones((h, w))], axis=-1
    )
    depth = np.full((h, w), 0.9)
    for x, y in np.stack(np.meshgrid(np.arange(-6, 7), np.arange(-5, 6)), axis=-1).reshape(-1, 2) * 0.07:
        centre, radius = np.array([x, y, 0.88 + rng.uniform(-0.06, 0.06)]), 0.062
        half = rays @ centre / (rays * rays).sum(axis=-1)
        root = half**2 - (centre @ centre - radius**2) / (rays * rays).sum(axis=-1)
        depth = np.where(root > 0.0, np.minimum(depth, half - np.sqrt(np.maximum(root, 0.0))), depth)
    at = rays[..., :2] * 0.7
    rim = (np.abs(at) > np.array([0.37, 0.27])).any(axis=-1)
    depth = np.where(rim, 0.7, depth) + rng.normal(0.0, 0.0008, (h, w))
    return (rays * depth[..., None]).astype(np.float32)


def test_a_pile_without_floor_is_refused_unless_the_plane_is_given(rng: np.random.Generator) -> None:
    cloud = Cloud(_pile_without_floor(rng))
    doubted = segment(cloud)
    assert doubted.status == "doubtful_plane"
    assert (len(doubted.objects), doubted.table is None) == (0, False)
    for name in ("segmentation.plane.table", "plane.point", "plane.coefficients"):
        assert name in doubted.reason
    given = segment(
        cloud, SegmentationConfig().updated({"plane.table": "given", "plane.coefficients": (0, 0, -2, 1.92)})
    )
    assert given.status == "ok"
    np.testing.assert_allclose(given.table.coefficients, (0, 0, -1, 0.96))
    assert (len(given.objects) > 5, len(given.background), len(given.outline)) == (True, 0, 0)


def test_a_given_plane_is_used_as_it_is_with_the_noise_of_the_points_on_it(rng: np.random.Generator) -> None:
    points = np.concatenate([_level(rng, 0.9, 0.9, 8000), _level(rng, 0.1, 0.8, 500)]).astype(np.float32)
    for sign in (1.0, -1.0):
        plane, noise_per_m, reason = find_table(
            points, PlaneConfig(table="given", coefficients=(0.0, 0.0, sign, -0.901 * sign))
        )
        np.testing.assert_allclose(plane.coefficients, (0.0, 0.0, -1.0, 0.901))  # towards the camera
        assert reason == ""
        assert abs(noise_per_m * 0.81 - np.hypot(0.001, 0.001)) < 2e-4  # 1 mm of noise, and 1 mm off


def test_a_table_of_two_levels_is_fitted_in_a_thinner_slab_and_a_rough_one_is_doubted(rng: np.random.Generator) -> None:
    board, table = _level(rng, 0.9, 0.94, 6000), _level(rng, 0.9, 0.958, 5000)
    board[:, 0] -= 0.45
    table[:, 0] += 0.45
    points, most = np.concatenate([board, table]).astype(np.float32), 0.01 / (2.5 * 0.948**2)
    assert fit_plane(points, PlaneConfig())[1] > most
    _, noise_per_m, reason = find_table(points, PlaneConfig())
    assert (noise_per_m < most, reason) == (True, "")
    rough = _level(rng, 0.9, 0.95, 6000)
    rough[:, 2] += rng.uniform(-0.012, 0.012, len(rough))
    _, reason = _offset([rough])
    assert "more than 10 mm (segmentation.plane.max_noise_m)" in reason
    assert _offset([rough], max_noise_m=0.02)[1] == ""
    assert _offset([rough], table="point", point=(0.0, 0.0, 0.95))[1] == ""
