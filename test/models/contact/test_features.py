# SPDX-License-Identifier: Apache-2.0
"""Features of a grasp: what turns with the camera and what does not, slopes known by hand, and the absurd."""

from __future__ import annotations

import numpy as np
import pytest
from contact_model_builders import HAND, cylinder, lines_sheets_and_repeated_points, moved, named, patch, sphere
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from foretouch.errors import CloudError
from foretouch.models.contact.features import FEATURES, SLOPE_FEATURES, ContactScene
from foretouch.models.novelty import OBJECT_FEATURES, SHAPE_FEATURES
from foretouch.types import Grasp

HERE = np.array([0.05, -0.02, 1.2])
ABOVE = np.array([0.0, 0.0, 1.0])
PADS = [name for name in FEATURES if name.startswith(("g1_pad", "g2_pad", "g1_share", "g2_share", "g1_gap", "g2_gap"))]
TURNING = [name for name in PADS if name.endswith(("pad_x", "pad_y"))]
"""What changes its sign with the finger's x and y."""
IN_HAND = [name for name in FEATURES if "hand_" in name]
SIZES = ["spread_1", "spread_2", "spread_3", "radius", "log_points", "radius_q25", "radius_q50", "radius_q75"]


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
    return ContactScene(points).describe(grasps)


def across(at: np.ndarray, width: float = 0.3) -> Grasp:
    """The first contact is at `at` and closes towards -x; the other is far."""
    return Grasp(at, at - [width, 0.0, 0.0], HAND)


def slopes(row: np.ndarray, contact: str = "g1") -> np.ndarray:
    """(3, 3): one slope a radius."""
    return named(row, *(name for name in SLOPE_FEATURES if name.startswith(contact))).reshape(3, 3)


def test_every_column_has_a_name_of_its_own(lump, grasp) -> None:
    assert describe(lump, grasp, grasp).shape == (2, len(FEATURES))
    assert len(set(FEATURES)) == len(FEATURES) == 88
    assert len(SLOPE_FEATURES) == 2 * 3 * 3
    assert ContactScene(lump).object_features.shape == (len(OBJECT_FEATURES),)
    assert_array_equal(describe(lump, grasp)[0, : len(OBJECT_FEATURES)], ContactScene(lump).object_features)
    assert set(SHAPE_FEATURES) == {"extent_x", "extent_y", "extent_z", *SIZES[:5]}


def test_plain_columns_are_what_their_names_say(lump, grasp) -> None:
    (row,) = describe(lump, grasp)
    centre = lump.mean(axis=0)
    assert_allclose(named(row, "x", "y", "z"), centre)
    assert_allclose(named(row, "extent_x", "extent_y", "extent_z"), np.ptp(lump, axis=0))
    singular = np.linalg.svd(lump - centre, compute_uv=False)[::-1] / np.sqrt(len(lump))
    assert_allclose(named(row, "spread_1", "spread_2", "spread_3"), singular)
    assert_allclose(named(row, "width", "offset"), [0.05, np.linalg.norm(grasp.midpoint - centre)])
    assert_allclose(named(row, *(f"r{i}{j}" for i in range(3) for j in range(3))), HAND.reshape(-1))
    assert_allclose(named(row, "g2_from_centre_x", "g2_from_centre_y", "g2_from_centre_z"), grasp.g2 - centre)
    inside = (lump - grasp.midpoint) @ HAND
    assert_allclose(named(row, "centre_hand_x", "centre_hand_y", "centre_hand_z"), inside.mean(axis=0))
    assert_allclose(named(row, "low_hand_y", "high_hand_y"), np.quantile(inside[:, 1], (0.01, 0.99)))
    near = np.linalg.norm(lump - grasp.g1, axis=1)
    assert_allclose(named(row, "g1_share", "g1_gap"), [(near < 0.02).mean(), near.min()])


def test_along_runs_from_end_to_end_of_the_object() -> None:
    rod = HERE + np.linspace(-0.1, 0.1, 2001)[:, None] * [0.0, 1.0, 0.0]
    ends = [Grasp(here(0.01, y, 0.0), here(-0.01, y, 0.0), HAND) for y in (-0.098, 0.0, 0.049, 0.098)]
    rows = describe(rod, *ends)
    assert_allclose([named(row, "along")[0] for row in rows], [-0.5, 0.0, 0.25, 0.5], atol=1e-9)
    assert_allclose([named(row, "along_abs")[0] for row in rows], [0.5, 0.0, 0.25, 0.5], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_turning_scene_and_hand_together_turns_the_camera_s_columns_only(lump, grasp, seed: int) -> None:
    R = Rotation.random(random_state=seed).as_matrix()
    (before,), (after,) = describe(lump, grasp), describe(lump @ R.T, moved(grasp, R, np.zeros(3)))
    same = [*SIZES, "width", "offset", "along_abs", *IN_HAND, *PADS, *SLOPE_FEATURES]
    assert_allclose(named(after, *same), named(before, *same), atol=1e-9)
    for place in ("", "g1_", "g2_", "mid_", "g1_from_centre_", "g2_from_centre_"):
        columns = [f"{place}{axis}" for axis in "xyz"]
        assert_allclose(named(after, *columns), R @ named(before, *columns), atol=1e-12)
    turned = named(after, *(f"r{i}{j}" for i in range(3) for j in range(3))).reshape(3, 3)
    assert_allclose(turned, R @ HAND, atol=1e-12)
    axes = [named(row, "axis_x", "axis_y", "axis_z") for row in (before, after)]
    assert abs(axes[1] @ R @ axes[0]) == pytest.approx(1.0)  # its sign is the camera's choice


def test_moving_away_changes_places_only(lump, grasp) -> None:
    t = np.array([0.0, 0.0, 0.4])
    (before,), (after,) = describe(lump, grasp), describe(lump + t, moved(grasp, np.eye(3), t))
    places = [name for name in FEATURES if name in ("z", "g1_z", "g2_z", "mid_z")]
    assert_allclose(named(after, *places) - named(before, *places), 0.4)
    others = [name for name in FEATURES if name not in places]
    assert_allclose(named(after, *others), named(before, *others), atol=1e-9)


def test_which_way_the_hand_s_x_is_told_does_not_matter_to_the_fingers(lump, grasp) -> None:
    other = Grasp(grasp.g1, grasp.g2, HAND * [-1.0, -1.0, 1.0])
    (before,), (after,) = describe(lump, grasp), describe(lump, other)
    assert_array_equal(named(after, *PADS, *SLOPE_FEATURES), named(before, *PADS, *SLOPE_FEATURES))


def test_seen_from_behind_the_finger_s_x_and_y_turn(lump, grasp) -> None:
    t = np.array([0.0, 0.0, -2.4])  # the camera is now on the object's other side
    (before,), (after,) = describe(lump, grasp), describe(lump + t, moved(grasp, np.eye(3), t))
    turning = [*TURNING, *(name for name in SLOPE_FEATURES if name.endswith(("_x", "_y")))]
    same = [name for name in (*PADS, *SLOPE_FEATURES) if name not in turning]
    assert_allclose(named(after, *turning), -named(before, *turning), atol=1e-9)
    assert_allclose(named(after, *same), named(before, *same), atol=1e-9)
    assert np.abs(named(before, *turning)).max() > 0.01


def test_order_of_points_does_not_matter(lump, grasp, rng) -> None:
    assert_allclose(describe(rng.permutation(lump), grasp), describe(lump, grasp), atol=1e-9)


def test_points_without_depth_are_left_out_and_an_image_is_a_cloud(lump, grasp) -> None:
    holes = lump.copy()
    holes[::7] = np.nan
    holes[3] = np.inf
    image = holes.reshape(17, 100, 3)
    assert_array_equal(describe(image, grasp), describe(holes[np.isfinite(holes).all(axis=1)], grasp))


def test_a_grasp_is_described_alike_alone_and_among_others(lump, rng) -> None:
    grasps = [Grasp(a, b, HAND) for a, b in HERE + rng.normal(0.0, 0.03, (20, 2, 3))]
    together = describe(lump, *grasps)
    assert_array_equal(together, np.concatenate([describe(lump, one) for one in grasps]))
    assert describe(lump).shape == (0, len(FEATURES))


@pytest.mark.parametrize("degrees", [0, 10, 25, 40])
def test_slope_of_a_plane_tilted_away_from_the_camera(degrees: int) -> None:
    a = np.radians(degrees)
    facing = np.array([np.cos(a), 0.0, -np.sin(a)])  # against the finger, which closes towards -x, and to the camera
    found = slopes(describe(patch(facing, HERE), across(HERE))[0])
    # In the finger's frame: x is the camera's z, y its y, z its -x.
    assert_allclose(found, np.tile([-np.sin(a), 0.0, -np.cos(a)], (3, 1)), atol=1e-9)


@pytest.mark.parametrize("degrees", [-30, 15])
def test_slope_of_a_plane_tilted_sideways(degrees: int) -> None:
    b = np.radians(degrees)
    found = slopes(describe(patch(np.array([np.cos(b), np.sin(b), 0.0]), HERE), across(HERE))[0])
    assert_allclose(found, np.tile([0.0, np.sin(b), -np.cos(b)], (3, 1)), atol=1e-9)


def test_slope_at_the_other_finger_is_told_in_its_own_frame() -> None:
    a = np.radians(20.0)
    facing = np.array([-np.cos(a), 0.0, -np.sin(a)])
    grasp = Grasp(here(0.3, 0.0, 0.0), HERE, HAND)
    found = slopes(describe(patch(facing, HERE), grasp)[0], "g2")
    assert_allclose(found, np.tile([-np.sin(a), 0.0, -np.cos(a)], (3, 1)), atol=1e-9)


@pytest.mark.parametrize("steps", [0, 5, -10])
def test_slope_of_a_cylinder_is_its_radius_at_the_contact(steps: int) -> None:
    angle = np.radians(2.0 * steps)  # a point of the cylinder, about which its points lie in symmetry
    out = np.array([np.cos(angle), 0.0, np.sin(angle)])
    found = slopes(describe(cylinder(0.033, HERE), across(HERE + 0.033 * out))[0])
    assert_allclose(found, np.tile([np.sin(angle), 0.0, -np.cos(angle)], (3, 1)), atol=1e-6)


def test_slope_of_a_sphere_is_its_radius_at_the_contact() -> None:
    out = np.array([0.8, 0.36, -0.48])
    found = slopes(describe(sphere(0.04, HERE), across(HERE + 0.04 * out))[0])
    # The smallest patch holds about 80 of 8000 points, whose lattice is not symmetric: a degree or so.
    assert_allclose(found, np.tile([-0.48, 0.36, -0.8], (3, 1)), atol=0.03)


def test_slopes_are_unit_vectors_against_the_finger_or_nothing(lump, rng) -> None:
    grasps = [Grasp(a, b, HAND) for a, b in HERE + rng.normal(0.0, 0.06, (200, 2, 3))]
    found = np.array([slopes(row, contact) for row in describe(lump, *grasps) for contact in ("g1", "g2")]).reshape(
        -1, 3
    )
    length = np.linalg.norm(found, axis=1)
    assert_allclose(length[length > 0.0], 1.0)
    assert 0 < (length == 0.0).sum() < len(length)
    assert (found[:, 2] <= 0.0).all()


def test_a_slope_takes_four_points() -> None:
    rest = HERE + [[0.1, 0.01 * k, 0.002 * k * k] for k in range(8)]
    square = HERE + 0.003 * np.array([[0.0, 1, 1], [0.0, -1, 1], [0.0, 1, -1], [0.0, -1, -1]])
    grasp = across(HERE, 0.5)
    assert_array_equal(slopes(describe(np.concatenate([square[:3], rest]), grasp)[0]), np.zeros((3, 3)))
    assert_allclose(slopes(describe(np.concatenate([square, rest]), grasp)[0]), np.tile([0.0, 0.0, -1.0], (3, 1)))


def test_a_contact_in_empty_space_tells_how_far_the_object_is(lump) -> None:
    far = here(1.0, 0.0, 0.0)
    (row,) = describe(lump, across(far, 0.5))
    assert_allclose(named(row, "g1_gap"), np.linalg.norm(lump - far, axis=1).min())
    assert_array_equal(named(row, *(name for name in PADS if name != "g1_gap" and name.startswith("g1"))), np.zeros(7))
    assert_array_equal(slopes(row), np.zeros((3, 3)))
    assert np.isfinite(row).all()


@settings(max_examples=60, deadline=None)
@given(found=lines_sheets_and_repeated_points(HERE))
def test_lines_sheets_and_repeated_points_are_finite(found: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    points, g1, g2 = found
    grasp = Grasp(g1, g2, HAND)
    assert np.isfinite(describe(points, grasp)).all()


@pytest.mark.parametrize(
    ("points", "rule"),
    [
        (np.zeros((0, 3)), "cloud: 0 finite points are fewer than 8"),
        (np.vstack([np.eye(3), np.full((9, 3), np.nan)]), "cloud: 3 finite points are fewer than 8"),
        (np.ones((20, 3)), "cloud: all 20 finite points are in one place"),
    ],
)
def test_what_shows_no_shape_is_refused(points: np.ndarray, rule: str) -> None:
    with pytest.raises(CloudError, match=rule):
        ContactScene(points)


@pytest.mark.real_data
def test_real_grasps_are_described_within_what_a_can_is(real_data) -> None:
    from foretouch.dataset.vision2tactile import read_sample, sample_folders

    samples = [read_sample(folder) for folder in sample_folders(real_data / "vision2tactile")[::20]]
    rows = np.array([describe(sample.cloud.xyz, sample.grasp)[0] for sample in samples])
    assert np.isfinite(rows).all()
    gaps = rows[:, [FEATURES.index("g1_gap"), FEATURES.index("g2_gap")]]
    assert np.median(gaps) < 0.005  # contacts were planned on the surface
    assert (np.array([named(row, "radius")[0] for row in rows]) < 0.3).all()
