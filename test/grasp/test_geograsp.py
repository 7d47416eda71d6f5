# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from foretouch.errors import CloudError, ConfigError, GraspError
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.types import Cloud, Plane

CONFIG = GeoGraspConfig(method="original")


def test_a_box_is_taken_across_its_long_axis(box_cloud, top_view):
    plan = plan_grasps(box_cloud, top_view, CONFIG)
    assert plan.status == "ok"
    assert abs(plan.axis[1]) > 0.99
    best = plan.grasps[0]
    assert best.g1[0] < -0.02 < 0.02 < best.g2[0]  # the side of least x comes first
    assert abs(best.g1[1] - best.g2[1]) < 0.01
    np.testing.assert_allclose(np.abs(best.rotation[:, 2]), [1.0, 0.0, 0.0], atol=0.2)


def test_candidates_come_best_first_and_points_are_counted_those_that_are_not_finite_too(box_cloud, top_view):
    plan = plan_grasps(box_cloud, top_view, GeoGraspConfig(method="original", count=10))
    counts, ms = plan.counts, plan.ms
    scores = [grasp.score for grasp in plan.grasps]
    assert len(scores) == min(10, counts["n_pairs_ranked"])
    assert scores == sorted(scores, reverse=True)
    three = plan_grasps(box_cloud, top_view, GeoGraspConfig(method="original", count=3))
    assert [grasp.score for grasp in three.grasps] == scores[:3]
    assert counts["n_pairs"] == counts["n_fv"] * counts["n_sv"]
    dropped = sum(counts[name] for name in ("n_pairs_inside", "n_pairs_unknown", "n_pairs_low"))
    assert counts["n_pairs"] == dropped + counts["n_pairs_ranked"]
    assert counts["n_points"] >= counts["n_filtered"] >= counts["n_plane"]
    assert list(ms) == ["outliers", "axis", "slab", "candidates", "ranking", "pose", "total"]
    assert ms["total"] == pytest.approx(sum(ms.values()) - ms["total"])
    bad = np.array([[np.nan, 0, 1], [0, np.inf, 1], [np.nan] * 3], np.float32)
    plan = plan_grasps(Cloud(np.concatenate([bad, box_cloud.xyz])), top_view, CONFIG)
    assert plan.counts["n_dropped"] == 3
    assert plan.counts["n_points"] == box_cloud.size + 3
    assert plan.grasps[0].score == plan_grasps(box_cloud, top_view, CONFIG).grasps[0].score


def test_a_slide_moves_the_contacts_along_the_axis(box_cloud, top_view, rng):
    still = plan_grasps(box_cloud, top_view, CONFIG)
    for slide_m in (-0.03, 0.02):
        slid = plan_grasps(box_cloud, top_view, CONFIG, slide_m=slide_m)
        assert slid.slide_m == slide_m
        moved = (slid.initial_points.mean(axis=0) - still.centroid) @ still.axis
        assert moved == pytest.approx(slide_m, abs=CONFIG.slab_half_width_m)
        np.testing.assert_array_equal(slid.axis, still.axis)
    beyond = plan_grasps(box_cloud, top_view, CONFIG, slide_m=0.5)
    assert beyond.status == "no_grasp"
    assert "no point within 7 mm of the grasp plane" in beyond.reason
    assert beyond.axis is not None
    assert beyond.counts["n_filtered"] > 0
    with pytest.raises(GraspError, match=r"slide_m, rng: a slide of 0.01 m and a random one exclude each other"):
        plan_grasps(box_cloud, top_view, CONFIG, slide_m=0.01, rng=rng)
    with pytest.raises(GraspError, match="slide_m: nan is not finite"):
        plan_grasps(box_cloud, top_view, CONFIG, slide_m=float("nan"))


def test_pixels_that_do_not_fit_are_refused(box_cloud, top_view, rng):
    with pytest.raises(CloudError, match="does not match 1800 points"):
        plan_grasps(box_cloud, top_view, CONFIG, pixels=np.arange(3), image_shape=(480, 640))
    with pytest.raises(CloudError, match="pixels, image_shape: one is given without the other"):
        plan_grasps(box_cloud, top_view, CONFIG, pixels=np.arange(box_cloud.size))
    image = Cloud(box_cloud.xyz.reshape(60, 30, 3))
    with pytest.raises(CloudError, match="pixels: not allowed for an organised cloud"):
        plan_grasps(image, top_view, CONFIG, pixels=np.arange(box_cloud.size), image_shape=(60, 30))
    twice = plan_grasps(box_cloud, top_view, CONFIG, pixels=np.zeros(1800, int), image_shape=(30, 60))
    assert (twice.status, twice.reason) == ("no_grasp", "pixels: an index occurs twice")
    # Wrong ones cannot change the plan of a cloud that is not downsampled.
    plan = plan_grasps(box_cloud, top_view, CONFIG, pixels=rng.permutation(1800), image_shape=(30, 60))
    assert plan.counts == plan_grasps(box_cloud, top_view, CONFIG).counts


def test_a_dense_cloud_is_thinned_counted_and_grasped_as_before(rng: np.random.Generator) -> None:
    # A can that fills a large part of a depth image: 150 x 90 pixels.
    rows, columns = np.mgrid[0:150, 0:90]
    x, y = (columns - 44.5) / 1200.0, (rows - 74.5) / 1200.0
    z = 0.8 - np.sqrt(np.maximum(0.04**2 - x**2, 0.0))
    xyz = np.stack([x * z / 0.8, y * z / 0.8, z], axis=-1) + rng.normal(0.0, 2e-4, (150, 90, 1)) * [0.0, 0.0, 1.0]
    cloud, plane = Cloud(xyz.reshape(-1, 3).astype(np.float32)), Plane.from_coefficients([0.0, 0.0, 1.0, -0.85])

    def plan(max_points: int, shift: tuple[int, int] = (0, 0), shape: tuple[int, int] = (150, 90)):
        pixels = ((rows + shift[0]) * shape[1] + columns + shift[1]).reshape(-1)
        return plan_grasps(
            cloud, plane, GeoGraspConfig(method="original", max_points=max_points), pixels=pixels, image_shape=shape
        )

    whole, thin = plan(0), plan(4000)
    assert (whole.counts["n_thinned"], thin.counts["n_thinned"]) == (0, 13_500 - 75 * 45)
    np.testing.assert_allclose(thin.initial_points, whole.initial_points, atol=0.01)  # points within 7 mm of the plane
    there = plan(4000, (7, 13), (480, 848))  # where in the image the object lies does not matter
    assert thin.counts == there.counts
    np.testing.assert_array_equal(thin.grasps[0].g1, there.grasps[0].g1)
    listed = rng.uniform([-0.03, -0.08, 0.7], [0.03, 0.08, 0.76], (9000, 3)).astype(np.float32)  # by order
    assert (
        plan_grasps(Cloud(listed), plane, GeoGraspConfig(method="original", max_points=3000)).counts["n_thinned"]
        == 6000
    )


def test_the_method_that_was_replaced_is_refused_with_the_new_one() -> None:
    said = "settings.yaml: method: 'stable' was replaced by 'completed', which is the default"
    with pytest.raises(ConfigError) as caught:
        GeoGraspConfig.from_mapping({"method": "stable"}, "settings.yaml")
    assert str(caught.value) == said
