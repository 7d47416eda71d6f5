# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from foretouch.errors import CloudError
from foretouch.grasp import GeoGraspConfig
from foretouch.grasp.ranking import (
    ContactSide,
    GraspPlane,
    SurfacePoints,
    _contact_radius,
    find_grasp_plane,
    initial_score,
    rank_pairs,
)

CONFIG = GeoGraspConfig(method="original")
Y = np.array([0.0, 1.0, 0.0])
CENTROID = np.zeros(3)
GRASP_PLANE = GraspPlane(origin=CENTROID, normal=Y, first=0, second=1, n_points=2, width_m=0.1)


def test_initial_points_are_the_extremes_near_the_plane():
    toward = np.array([0.0, 0.0, 1.0])
    xyz = np.array([[-9, 0.02, 1], [-1, 0.001, 1], [0, 0, 1], [2, -0.006, 1], [5, 0.0071, 1]], np.float32)
    grasp_plane = find_grasp_plane(xyz, toward, Y, 0, 0.007)
    assert (grasp_plane.first, grasp_plane.second, grasp_plane.n_points) == (1, 3, 3)
    assert grasp_plane.width_m == pytest.approx(np.hypot(3.0, 0.007))
    xyz = np.array([[0, 0, 1], [1, 0, 1], [1, 0.001, 1], [0, 0.001, 1]], np.float32)
    grasp_plane = find_grasp_plane(xyz, toward, Y, 0, 0.007)
    assert (grasp_plane.first, grasp_plane.second) == (0, 1)  # the first of equal extremes counts
    xyz = np.array([[0, 0.1, 1], [1, -0.1, 1]], np.float32)
    with pytest.raises(CloudError, match=r"no point within 7 mm .* spans -0.100 ... 0.100 m"):
        find_grasp_plane(xyz, toward, Y, 0, 0.007)
    with pytest.raises(CloudError, match="the 1 points near the grasp plane leave no two contacts"):
        find_grasp_plane(np.ones((1, 3), np.float32), np.ones(3), Y, 0, 0.007)
    for width, radius in ((0.2, 0.05), (0.1, 0.035), (0.06, 0.021)):  # the two spheres of candidates stay apart
        assert _contact_radius(width, CONFIG) == pytest.approx(radius)


def _points(points, curvature, side):
    points = np.array(points, float)
    return SurfacePoints(points, np.tile([side, 0.0, 0.0], (len(points), 1)), np.array(curvature, float))


def _sides():
    """Three candidates a side of an object 100 mm wide; the first are the best, flat and on the plane."""
    a = _points([[-0.051, 0.0, 0.0], [-0.052, 0.01, 0.0], [-0.053, 0.02, 0.0]], [0.0, 0.1, 0.2], -1.0)
    b = _points([[0.051, 0.0, 0.0], [0.052, 0.01, 0.0], [0.053, 0.02, 0.0]], [0.0, 0.1, 0.2], 1.0)
    p1 = _points([[-0.05, 0.0, 0.0]], [0.05], -1.0)
    p2 = _points([[0.05, 0.0, 0.0]], [0.05], 1.0)
    return ContactSide(a, p1, 3), ContactSide(b, p2, 3)


def test_pairs_score_as_worked_by_hand_and_initial_points_without_a_score_have_a_reason():
    ranking = rank_pairs(_sides(), GRASP_PLANE, CENTROID)
    # pd = k = 0 but for 1e-8 over the range; u across the axis: R1 = 2 + 10 · 0.2 = 4; c = 1: R2 = 2 + 2 = 4.
    assert (ranking[0][0], ranking[1][0]) == (0, 0)
    assert ranking[2][0] == pytest.approx(1.5 * 4.0 + 4.0, abs=1e-4)
    pair = np.flatnonzero((ranking[0] == 1) & (ranking[1] == 1))[0]
    # pd = k = 0.5 on both sides: R1 = 4 - 1, R2 = 4 - 1.
    assert ranking[2][pair] == pytest.approx(1.5 * 3.0 + 3.0, abs=1e-4)
    # Equal pairs keep the order of the loops.
    mirrored = [(a, b) for a, b in zip(ranking[0], ranking[1], strict=True) if {a, b} == {0, 1}]
    assert mirrored == [(0, 1), (1, 0)]
    score, reason = initial_score(_sides(), GRASP_PLANE, CENTROID)
    # pd = 0, k = 0.25: R1 = 4, R2 = 4 - 0.5.
    assert (reason, score) == ("", pytest.approx(1.5 * 4.0 + 3.5, abs=1e-4))
    a, b = _sides()
    xyz, normal, curvature = a.candidates.xyz[:1], a.candidates.normal[:1], a.candidates.curvature[:1]
    one = a._replace(candidates=SurfacePoints(xyz, normal, curvature))
    score, reason = initial_score((one, b), GRASP_PLANE, CENTROID)
    assert np.isnan(score)
    assert reason == "no score: the candidates of the first side do not differ (1 of them)"
    b.initial.curvature[0] = np.nan
    score, reason = initial_score((a, b), GRASP_PLANE, CENTROID)
    assert np.isnan(score)
    assert "the second initial point" in reason


def test_candidates_that_are_inside_without_a_normal_or_along_the_axis_never_rank():
    a, b = _sides()
    a.candidates.xyz[0] = [-0.03, 0.0, 0.0]
    ranking = rank_pairs((a, b), GRASP_PLANE, CENTROID)
    assert 0 not in ranking[0]
    assert ranking[3]["n_pairs_inside"] == 3
    a, b = _sides()
    a.candidates.normal[0], a.candidates.curvature[0] = np.nan, np.nan
    ranking = rank_pairs((a, b), GRASP_PLANE, CENTROID)
    assert 0 not in ranking[0]
    assert ranking[3]["n_pairs_unknown"] == 3
    assert np.isfinite(ranking[2]).all()
    along = GraspPlane(CENTROID, np.array([1.0, 0.0, 0.0]), 0, 1, 2, 0.1)
    ranking = rank_pairs(_sides(), along, CENTROID)
    assert len(ranking[2]) == 0
    assert ranking[3]["n_pairs_low"] > 0
    a, b = _sides()  # the second side has two percent of slack
    # Distances to the centroid span 40 ... 60 mm, so p2, at 50 mm, is at 0.5 of them and the limit at 0.49, or 49.8 mm.
    for x, kept in ((0.0499, True), (0.0497, False)):
        others = _points([[x, 0.0, 0.0], [0.04, 0.0001, 0.0], [0.06, 0.0002, 0.0]], [0.0, 0.1, 0.2], 1.0)
        assert (0 in rank_pairs((a, b._replace(candidates=others)), GRASP_PLANE, CENTROID)[1]) == kept
