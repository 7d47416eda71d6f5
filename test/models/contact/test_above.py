# SPDX-License-Identifier: Apache-2.0
"""What a camera above the table would see, from what a tilted one has seen of a ball."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from foretouch.models.contact.above import seen_from_above, upper_side
from foretouch.models.contact.features import FEATURES, HandFrameFeatures
from foretouch.types import ASSUMED_TABLE, Grasp, Plane

RADIUS, DISTANCE = 0.04, 0.8


def ball_seen(tilt_deg: float) -> tuple[np.ndarray, Plane, np.ndarray]:
    """The visible half of a ball on a table, (N, 3) in the frame of a tilted camera; the table; and the vertical there."""
    rng = np.random.default_rng(0)
    surface = rng.normal(size=(8000, 3))
    surface *= RADIUS / np.linalg.norm(surface, axis=1)[:, None]
    seen = surface[surface[:, 2] < -0.05 * RADIUS] + [0.0, 0.0, DISTANCE]  # towards the camera
    tilt = np.radians(tilt_deg)
    up = np.array([0.0, -np.sin(tilt), -np.cos(tilt)])
    return seen, Plane(up, RADIUS - float(up @ [0.0, 0.0, DISTANCE])), up


def test_a_camera_straight_above_sees_what_it_sees() -> None:
    points, _, _ = ball_seen(0.0)
    for table in (None, ASSUMED_TABLE):
        found, turn, view = seen_from_above(points, points.mean(axis=0), table)
        assert_array_equal(found, points)
        assert_array_equal(turn, np.eye(3))
        assert_allclose(view, [0.0, np.linalg.norm(points.mean(axis=0))], atol=2e-3)


@pytest.mark.parametrize("tilt_deg", [40.0, 60.0])
def test_the_upper_side_of_a_ball_is_completed(tilt_deg: float) -> None:
    points, table, up = ball_seen(tilt_deg)
    found, turn, (tilt, _) = seen_from_above(points, points.mean(axis=0), table)
    assert tilt == pytest.approx(np.radians(tilt_deg), abs=2e-3)
    assert_allclose(turn @ up, [0.0, 0.0, -1.0], atol=1e-12)
    centre = turn @ [0.0, 0.0, DISTANCE]
    assert_allclose(np.linalg.norm(found - centre, axis=1), RADIUS, atol=0.01)
    # The whole footprint is there, whose far part the ball hides from the camera.
    low, high = np.quantile(found[:, :2] - centre[:2], (0.02, 0.98), axis=0)
    assert_allclose([-low, high], RADIUS, atol=0.006)


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 40.0, 60.0])
def test_the_upper_side_of_a_box_is_its_top_wherever_the_camera_is(tilt_deg: float) -> None:
    edges, spacing = np.array([0.09, 0.05, 0.07]), 0.001
    x, y, z = (np.arange(-edge / 2.0, edge / 2.0, spacing) for edge in edges)
    top = np.stack(np.meshgrid(x, y, -edges[2] / 2.0), axis=-1).reshape(-1, 3)
    wall = np.stack(np.meshgrid(x, -edges[1] / 2.0, z), axis=-1).reshape(-1, 3)  # towards a camera that comes down
    camera = Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix()
    points = np.concatenate([top, wall]) @ camera.T + [0.0, 0.0, DISTANCE]
    up = camera @ [0.0, 0.0, -1.0]
    table = Plane(up, edges[2] / 2.0 - float(up @ [0.0, 0.0, DISTANCE]))
    _, turn, (tilt, _) = seen_from_above(points, points.mean(axis=0), table)
    upper = upper_side(points, turn, tilt)
    height = upper[:, 2] - (turn @ [0.0, 0.0, DISTANCE])[2]
    assert np.quantile(np.abs(height + edges[2] / 2.0), 0.95) < 0.003
    assert_allclose(np.ptp(upper[:, :2], axis=0), edges[:2], atol=0.006)  # along x, by cells of 5 mm


def test_features_of_a_ball_are_about_those_from_above() -> None:
    """Widths and sizes in the table's frame; `rise` and `approach` are of the table, not of the camera."""
    rows = []
    for tilt_deg in (0.0, 40.0):
        points, table, up = ball_seen(tilt_deg)
        x = np.array([1.0, 0.0, 0.0])
        ball = np.array([0.0, 0.0, DISTANCE])
        grasp = Grasp(ball + RADIUS * x, ball - RADIUS * x, np.stack([-up, np.cross(x, -up), x], axis=1))
        rows.append(HandFrameFeatures(points, table).describe([grasp])[0])
    above, tilted = rows
    for name, tolerance in {"width": 1e-9, "rise": 1e-9, "approach": 1e-9, "extent_3": 0.008, "offset": 0.015}.items():
        k = FEATURES.index(name)
        assert tilted[k] == pytest.approx(above[k], abs=tolerance), name
