# SPDX-License-Identifier: Apache-2.0
"""Features in the hand's frame: what neither the camera nor the density of points changes, and what is known by hand."""

import numpy as np
import pytest
from contact_model_builders import HAND, cylinder, lines_sheets_and_repeated_points, moved, patch, sphere
from every_case import every_case, every_refusal
from hypothesis import assume, given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from foretouch.errors import CloudError
from foretouch.models.contact.features import CONDITIONS, FEATURES, HandFrameFeatures
from foretouch.types import Grasp

HERE = np.array([0.05, -0.02, 1.2])
SEEN = [name for name in FEATURES if name not in CONDITIONS]
"""The columns that predictions depend on."""


@pytest.fixture
def lump(rng: np.random.Generator) -> np.ndarray:
    """A box with three different sides and a bump, so that no axis is ambiguous."""
    box = rng.uniform(-0.5, 0.5, (1500, 3)) * [0.05, 0.09, 0.14]
    return HERE + np.concatenate([box, [0.02, 0.05, 0.05] + 0.01 * rng.normal(size=(200, 3))])


@pytest.fixture
def grasp() -> Grasp:
    return Grasp(here(0.025, 0.01, 0.01), here(-0.025, 0.01, 0.01), HAND)


def here(x: float, y: float, z: float) -> np.ndarray:
    return HERE + np.array([x, y, z])


def describe(points: np.ndarray, *grasps: Grasp) -> np.ndarray:
    return HandFrameFeatures(points).describe(grasps)


def named(rows: np.ndarray, *names: str) -> np.ndarray:
    return rows[..., [FEATURES.index(name) for name in names]]


def slopes(row: np.ndarray, contact: str = "g1") -> np.ndarray:
    """(3, 3): one slope a radius."""
    return named(row, *(name for name in FEATURES if name.startswith(f"{contact}_slope_"))).reshape(3, 3)


def test_plain_columns_are_what_their_names_say(lump, grasp) -> None:
    (row,) = describe(lump, grasp)
    centred = lump - lump.mean(axis=0)
    singular = np.linalg.svd(centred, compute_uv=False)[::-1] / np.sqrt(len(lump))
    assert_allclose(named(row, "spread_1", "spread_2", "spread_3"), singular)
    at = lump.mean(axis=0)
    assert_allclose(named(row, "width", "distance"), [0.05, np.linalg.norm(at)])
    assert_allclose(named(row, "tilt"), [np.arctan(np.hypot(*at[:2]) / at[2])])
    assert_allclose(named(row, "approach", "rise"), [1.0, 0.0], atol=1e-12)  # X is the camera's z, Z its x
    inside = (lump - grasp.midpoint) @ HAND
    assert_allclose(named(row, "centre_hand_x", "centre_hand_y", "centre_hand_z"), inside.mean(axis=0), atol=1e-12)
    assert_allclose(named(row, "spread_hand_x", "spread_hand_y", "spread_hand_z"), inside.std(axis=0))
    near = np.maximum(1.0 - (np.linalg.norm(lump - grasp.g1, axis=1) / 0.02) ** 2, 0.0)
    assert_allclose(named(row, "g1_share"), [near.mean()])
    weighted = (near[:, None] * (lump - grasp.g1)).sum(axis=0) / near.sum()
    closing = np.stack([HAND[:, 0], -HAND[:, 1], -HAND[:, 2]], axis=1)  # the first finger closes towards the second
    assert_allclose(named(row, "g1_pad_x", "g1_pad_y", "g1_pad_z"), weighted @ closing, atol=1e-12)


def test_neither_a_roll_nor_the_order_of_points_nor_points_without_depth_change_anything(lump, grasp, rng) -> None:
    wanted = describe(lump, grasp)
    for degrees in (90.0, 180.0, 33.0):
        R = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
        assert_allclose(describe(lump @ R.T, moved(grasp, R, np.zeros(3))), wanted, atol=1e-9)
    assert_allclose(describe(rng.permutation(lump), grasp), wanted, atol=1e-9)
    holes = lump.copy()
    holes[::7] = np.nan
    holes[3] = np.inf
    image = holes.reshape(17, 100, 3)
    assert_array_equal(describe(image, grasp), describe(holes[np.isfinite(holes).all(axis=1)], grasp))


def test_every_point_twice_changes_the_spacing_alone_and_thinning_only_within_the_noise(grasp, rng) -> None:
    lump = HERE + rng.uniform(-0.5, 0.5, (40_000, 3)) * [0.05, 0.09, 0.14]  # slopes need four points
    (before,), (after,) = describe(lump, grasp), describe(np.concatenate([lump, lump]), grasp)
    assert_allclose(named(after, *SEEN), named(before, *SEEN), atol=2e-3)  # quantiles between the same points
    assert_allclose(named(after, "spacing") / named(before, "spacing"), np.sqrt(0.5), rtol=0.01)
    (after,) = describe(lump[rng.random(len(lump)) < 0.5], grasp)
    sizes = [name for name in SEEN if not name.startswith(("g1_slope", "g2_slope", "oblique", "along"))]
    assert_allclose(named(after, *sizes), named(before, *sizes), atol=1.5e-3)


def test_slopes_of_planes_are_those_of_their_normals() -> None:
    """In the finger's frame x is the camera's z, y its y, z its -x; a flat patch shrinks its slope by its tilt."""

    def check(name: str, facing: np.ndarray, wanted: np.ndarray) -> None:
        contact = "g2" if facing[0] < 0.0 else "g1"
        grasp = Grasp(HERE, here(-0.3, 0.0, 0.0), HAND) if contact == "g1" else Grasp(here(0.3, 0.0, 0.0), HERE, HAND)
        found = slopes(describe(patch(facing, HERE), grasp)[0], contact)
        assert_allclose(found, -wanted[2] * np.tile(wanted, (3, 1)), atol=1e-6, err_msg=name)

    tilts = np.radians([0, 10, 25, 40])
    away = [np.array([np.cos(a), 0.0, -np.sin(a)]) for a in tilts]
    aside = [np.array([np.cos(b), np.sin(b), 0.0]) for b in np.radians([-30, 15])]
    cases = [("away", n, np.array([n[2], 0.0, -n[0]])) for n in away] + [
        ("aside", n, np.array([0.0, n[1], -n[0]])) for n in aside
    ]
    other = np.array([-np.cos(0.35), 0.0, -np.sin(0.35)])
    every_case([*cases, ("the other finger", other, np.array([other[2], 0.0, other[0]]))], check)


def test_slopes_of_a_cylinder_and_of_a_sphere_are_their_radii_and_do_not_jump_across_the_finger() -> None:
    def check(name: str, points: np.ndarray, out: np.ndarray, radius: float, atol: float) -> None:
        at = HERE + radius * out
        found = slopes(describe(points, Grasp(at, at - [0.3, 0.0, 0.0], HAND))[0])
        directions = found / np.linalg.norm(found, axis=1)[:, None]
        assert_allclose(directions, np.tile([out[2], out[1], -out[0]], (3, 1)), atol=atol, err_msg=name)

    # The smallest patch of the sphere holds about 80 of 8000 points, whose lattice is not symmetric: a degree or so.
    cases = [
        ("cylinder", cylinder(0.033, HERE), np.array([1.0, 0.0, 0.0]), 0.033, 1e-6),
        ("sphere", sphere(0.04, HERE), np.array([0.8, 0.36, -0.48]), 0.04, 0.04),
    ]
    every_case(cases, check)
    # Its normal's sign turns there; the column passes through zero.
    grasp = Grasp(HERE, here(-0.3, 0.0, 0.0), HAND)
    normals = (np.array([np.cos(angle), np.sin(angle), 0.0]) for angle in np.radians([89.9, 90.1]))
    one, other = (slopes(describe(patch(normal, HERE), grasp)[0]) for normal in normals)
    assert_allclose(one, other, atol=0.01)


def test_a_grasp_is_described_alike_alone_and_among_others(lump, rng) -> None:
    grasps = [Grasp(a, b, HAND) for a, b in HERE + rng.normal(0.0, 0.03, (20, 2, 3))]
    grasps += [Grasp(grasps[0].g1, grasps[1].g2, HAND)]  # shares its contacts
    together = describe(lump, *grasps)
    assert_array_equal(together, np.concatenate([describe(lump, one) for one in grasps]))
    assert describe(lump).shape == (0, len(FEATURES))


def test_a_contact_in_empty_space_is_described_by_zeros_and_what_shows_no_shape_is_refused(lump) -> None:
    (row,) = describe(lump, Grasp(here(1.0, 0.0, 0.0), here(0.5, 0.0, 0.0), HAND))
    assert_array_equal(slopes(row), np.zeros((3, 3)))
    assert_array_equal(named(row, "g1_share", "g1_roughness", "g1_pad_x", "g1_pad_y", "g1_pad_z"), np.zeros(5))
    assert np.isfinite(row).all()
    cases = (
        ("cloud: 0 finite points are fewer than 8", np.zeros((0, 3))),
        ("cloud: 3 finite points are fewer than 8", np.vstack([np.eye(3), np.full((9, 3), np.nan)])),
        ("cloud: all 20 finite points are in one place", np.ones((20, 3))),
    )
    every_refusal(CloudError, cases, HandFrameFeatures)


@settings(max_examples=60, deadline=None)
@given(case=lines_sheets_and_repeated_points(HERE))
def test_lines_sheets_and_repeated_points_are_finite(case: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    points, g1, g2 = case
    assume((points != points[0]).any())  # in one place, they are refused
    assert np.isfinite(describe(points, Grasp(g1, g2, HAND))).all()
