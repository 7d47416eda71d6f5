# SPDX-License-Identifier: Apache-2.0
"""Clouds, tables and hands for which there is hardly a grasp: each is planned or refused with a reason, without a warning."""

import math
import warnings
from collections.abc import Iterator

import numpy as np
import pytest
from every_case import every_case, every_refusal
from seen_solids import Camera, ball, box, can

from foretouch.errors import ConfigError
from foretouch.grasp import GeoGraspConfig, HandConfig, plan_grasps
from foretouch.grasp.pose import check_rotation
from foretouch.grasp.reach import check_reach
from foretouch.types import Cloud, Float64, Plane, assumed_table

CAMERA = Camera(55.0)
CONFIG = GeoGraspConfig(count=3)


@pytest.fixture(autouse=True)
def warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def seen(solid, **where) -> Float64:
    xyz = CAMERA.see(solid, **where).xyz.reshape(-1, 3)
    return xyz[np.isfinite(xyz).all(axis=1)].astype(np.float64)


def outcome(xyz: Float64, plane: Plane, hand: HandConfig = HandConfig()) -> str:  # noqa: B008
    """The status of the plan, after checks of all that it holds."""
    cloud = Cloud(np.asarray(xyz, np.float32))
    plan = plan_grasps(cloud, plane, CONFIG, hand=hand)
    assert plan.reason
    assert (plan.status == "no_grasp") == (not plan.grasps)
    assert plan.status in ("ok", "no_grasp")
    for grasp in plan.grasps:
        assert math.isfinite(grasp.score)
        assert 0.001 <= grasp.width_m <= hand.opening_m + 1e-9
        check_rotation(grasp.rotation)
        check_reach(grasp, cloud.xyz, hand.opening_m + 1e-9, 0.1)
    for value in (plan.axis, plan.centroid, plan.initial_points, plan.axis_ratio):
        assert value is None or np.isfinite(value).all()
    return plan.status if plan.grasps else plan.reason


def test_clouds_that_are_hardly_an_object(rng: np.random.Generator) -> None:
    brick = seen(box(0.06, 0.09, 0.05), yaw=0.3)
    flat = rng.uniform(-0.05, 0.05, (800, 3)) * [1.0, 1.0, 0.0]
    line = np.outer(np.linspace(-0.05, 0.05, 300), [1.0, 0.3, 0.0])
    over = np.array([0.0, 0.0, 0.05])
    table = CAMERA.table()

    def placed(xyz: Float64) -> Float64:
        return CAMERA.to_camera(xyz + over)

    def check(xyz: Float64, expected: str) -> None:
        found = outcome(xyz, table)
        assert expected in ("", found) or expected in found, found

    cases = {
        "ten equal points": (np.tile(brick[:1], (10, 1)), ""),
        "an upright plane": (placed(flat[:, [0, 2, 1]]), ""),
        "an upright line": (placed(line[:, [2, 1, 0]]), ""),
        "a sheet": (seen(box(0.08, 0.08, 0.0005)), "no"),
        "a sheet thinner than the noise": (placed(flat - over + rng.normal(0.0, [0.0, 0.0, 0.002], flat.shape)), ""),
        "larger than the opening": (seen(box(0.15, 0.2, 0.1)), "wider than hand.opening_m 0.1"),
        "half out of the picture": (seen(can(0.033, 0.12), at=(0.0, 0.46)), ""),
        "behind another": (brick[brick[:, 0] > np.quantile(brick[:, 0], 0.6)], ""),
        "with a hole": (brick[np.linalg.norm(brick - brick.mean(axis=0), axis=1) > 0.015], ""),
        "of points far apart": (placed(rng.uniform(-0.25, 0.25, (40, 3))), ""),
    }
    every_case(cases, check)


def test_tables_that_are_hardly_one() -> None:
    brick, table = seen(box(0.06, 0.09, 0.05), yaw=0.3), CAMERA.table()

    def check(plane: Plane, expected: str) -> None:
        assert expected in outcome(brick, plane)

    up = table.normal
    every_case(
        {
            "above the object": (Plane(up, table.offset - 0.2), "ok"),
            "through the object": (Plane(up, table.offset - 0.025), "ok"),
            "far below": (Plane(up, table.offset + 0.5), ""),
            "none: the assumed one": (assumed_table(Cloud(brick.astype(np.float32))), ""),
            "a wall": (Plane.from_coefficients([1.0, 0.0, 0.0, 0.5]), ""),
        },
        check,
    )


def test_hands_that_hold_nothing() -> None:
    table = CAMERA.table()

    def check(solid, hand: HandConfig, expected: str) -> None:
        assert expected in outcome(seen(solid), table, hand)

    small = ball(0.012)
    every_case(
        {
            "tips as large as the object": (small, HandConfig(tip_radius_m=0.012), "ok"),
            "hardly open": (box(0.08, 0.08, 0.05), HandConfig(opening_m=0.005), ""),
            "above the object": (small, HandConfig(clearance_m=0.1), "no"),
            "no way in": (small, HandConfig(approach_m=0.0), "ok"),
        },
        check,
    )


def test_openings_that_are_none_are_refused_by_name() -> None:
    cases = [
        (rf"hand\.yaml: opening_m: .*{said}", {"opening_m": value})
        for value, said in ((0, "0.005"), (-0.1, "0.005"), (float("nan"), "nan"), (2.0, "1"), ("wide", "wide"))
    ]
    every_refusal(ConfigError, cases, lambda mapping: HandConfig.from_mapping(mapping, "hand.yaml"))


def test_the_method_that_was_replaced_is_refused_with_the_new_one() -> None:
    said = "method: 'stable' was replaced by 'completed', which is the default"
    with pytest.raises(ConfigError) as caught:
        GeoGraspConfig(method="stable")
    assert str(caught.value) == said
    with pytest.raises(ConfigError) as caught:
        GeoGraspConfig.from_mapping({"method": "stable"}, "settings.yaml")
    assert str(caught.value) == f"settings.yaml: {said}"
    with pytest.raises(ConfigError, match=r"method: .*stabel.*completed.*original"):
        GeoGraspConfig(method="stabel")
