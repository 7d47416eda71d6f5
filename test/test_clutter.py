# SPDX-License-Identifier: Apache-2.0
"""The benchmark of objects that touch: its scores by hand and by a second formulation, its piles by their geometry."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from benchmarks.clutter import piles
from benchmarks.clutter.metrics import f_of_best, score
from benchmarks.clutter.models import hull
from benchmarks.clutter.scenes import load_scenes
from benchmarks.random_scenes import DepthScene, Primitive
from foretouch_lab.experiments.peers import has_lccp, lccp
from foretouch_lab.simulation.depth_scene import CameraView


def test_scores_of_an_example_worked_by_hand() -> None:
    true = np.repeat(np.array([[1, 2]], np.int32), 10, axis=1)  # 10 pixels each
    predicted = np.repeat(np.array([[7, 3]], np.int32), (15, 5), axis=1)
    # F of the pairs 1-7, 1-3, 2-7, 2-3: 20/25, 0, 10/25, 10/15; the best sum is that of 1-7 and 2-3, with 15 pixels
    result = score(predicted, true)
    assert (result.precision, result.recall, result.f) == (0.75, 0.75, 0.75)
    assert (result.n_true, result.n_found) == (2, 1)
    assert (result.n_merged, result.n_cut) == (0, 1)  # 7 has all of 1 and just half of 2; 2 is in halves
    joined = score(np.ones_like(true), true)
    assert (joined.precision, joined.n_found, joined.n_merged, joined.n_cut) == (0.5, 0, 2, 0)  # F of 20/30 each
    perfect = score(true * 5, true)
    assert (perfect.f, perfect.n_found, perfect.n_merged, perfect.n_cut) == (1.0, 2, 0, 0)


def test_what_is_no_object_counts_and_what_is_not_scored_does_not() -> None:
    true = np.array([[1] * 10 + [0] * 10 + [-1] * 10], np.int32)
    predicted = np.array([[5] * 9 + [8] * 2 + [9] * 9 + [7] * 10], np.int32)  # 8 is half on 1, 9 is on nothing
    result = score(predicted, true)
    assert (result.n_true, result.n_found, result.n_none) == (1, 1, 1)
    assert result.precision == pytest.approx(9 / 20)  # of 5, 8 and 9
    assert f_of_best(predicted == 5, true) == pytest.approx(2 * 9 / 19)
    assert f_of_best(predicted == 9, true) == 0.0
    assert f_of_best(predicted == 5, np.zeros_like(true)) == 0.0


def test_an_image_as_a_driver_publishes_it_is_read_with_its_lens(tmp_path: Path) -> None:
    depth = np.array([[0, 1000], [500, 2000]], np.uint16)
    np.savez(tmp_path / "cam_1.npz", depth_mm=depth, K=(2.0, 4.0, 1.0, 0.0), label=np.array([[0, 1], [-1, 2]], np.int8))
    (scene,) = load_scenes(tmp_path)
    assert scene.kind == "cam"
    np.testing.assert_array_equal(scene.labels, [[0, 1], [-1, 2]])
    np.testing.assert_allclose(
        scene.cloud.xyz, [[[np.nan] * 3, [0, 0, 1]], [[-0.25, 0.125, 0.5], [0, 0.5, 2]]], atol=1e-6
    )


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_piles_rest_touch_and_agree_with_their_depth(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    models, shapes = piles.prepare(tmp_path, None)
    for kind, (build, holds) in piles.KINDS.items():
        pile = next(
            one
            for one in (build(models, np.random.default_rng(seed)) for seed in range(60))
            if piles.at_rest(one) and holds(one)
        )
        count = len(pile.objects)
        solids = [vertices(object_) for object_ in pile.objects]
        low = [points.min(axis=0)[2] for points in solids]
        assert min(low) > -1e-3  # on the table, not within it
        assert min(low) < 1e-3
        gaps = np.array(
            [[np.inf if i == j else gap(solids[i], pile.objects[j]) for j in range(count)] for i in range(count)]
        )
        assert gaps.min() > -3e-3, kind  # nothing is deep within another object
        assert gaps.min() < 3e-3  # something touches
        seen = piles.look(pile, shapes, kind, (40.0, 0.9), piles.SampleKey(0, 0))
        view = CameraView.towards_table(640, 480, 0.9, np.radians(40.0), 55.0)
        points, depth = view.to_world(seen.xyz.astype(np.float64)), np.isfinite(seen.xyz[..., 2])
        table = depth & (seen.labels == 0) & (np.abs(points[..., :2]) < 0.25).all(axis=-1)
        assert np.median(np.abs(points[table][:, 2])) < 2e-3
        for label, object_ in enumerate(pile.objects, 1):
            shown = points[depth & (seen.labels == label)]
            if len(shown) > piles._FEWEST_PX:
                assert np.median(np.abs(beyond(shown, object_))) < 3e-3, (kind, object_.model.name)


def vertices(one: piles.Placed) -> np.ndarray:
    """Points on the surface of an object, in the world."""
    local = np.concatenate(one.model.parts) if one.model.parts else piles.Body(one.model.shape, 0, one.model.size, np.zeros(3), np.eye(3)).mesh.vertices * one.model.size  # fmt: skip
    return one.position + local @ one.rotation.T


def beyond(points: np.ndarray, one: piles.Placed) -> np.ndarray:
    """How far points are outside of an object that is a union of convex parts, negative inside, by its half spaces [m]."""
    local = (points - one.position) @ one.rotation
    parts = one.model.parts or [vertices(piles.Placed(one.model, np.zeros(3), np.eye(3)))]
    facets = (ConvexHull(hull(part)[0]).equations for part in parts)
    return np.min([(local @ each[:, :3].T + each[:, 3]).max(axis=1) for each in facets], axis=0)


def gap(points: np.ndarray, one: piles.Placed) -> float:
    """Least distance of points from an object, negative inside; too small by a little off its edges."""
    near = np.linalg.norm(points - one.position, axis=1) < np.linalg.norm(one.model.size) / 2.0 + 0.01
    return float(beyond(points[near], one).min()) if near.any() else np.inf


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_same_seed_gives_the_same_piles_and_a_file_keeps_them(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    for name in ("one", "other"):
        piles.write_piles(tmp_path / name, 2, 5, None)
    first, second = (list(load_scenes(tmp_path / name)) for name in ("one", "other"))
    assert [one.kind for one in first] == ["leaning", "touching"]
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.cloud.xyz, other.cloud.xyz)
        np.testing.assert_array_equal(one.labels, other.labels)
        for label in range(1, one.labels.max() + 1):
            assert np.count_nonzero(np.isfinite(one.cloud.xyz[..., 2]) & (one.labels == label)) >= piles._FEWEST_PX


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_lccp_keeps_a_box_whole_and_parts_a_ball_from_it() -> None:
    if not has_lccp():
        pytest.skip("PCL or a compiler is absent")
    box = Primitive("box", np.array([0.12, 0.12, 0.1]), np.array([0.0, 0.0, 0.05]))
    ball = Primitive("ball", np.full(3, 0.1), np.array([0.1, 0.0, 0.05]))
    view = CameraView.towards_table(640, 480, 0.9, np.radians(40.0))
    images = [DepthScene(view, solids).render() for solids in ((box,), (box, ball))]
    clusters = [(image.labels > 1).astype(np.int32) for image in images]
    for count, image, given in zip((1, 2), images, clusters, strict=True):
        result = score(lccp(image.cloud(), given), np.maximum(image.labels - 1, 0))
        assert result.n_found == count
        assert result.f > 0.95


def test_the_confidence_is_fitted_and_judged_with_each_source_left_out() -> None:
    """Segments that are whole with the probability that a known rule says, but in a source where none is."""
    from benchmarks.clutter import confidence

    rng = np.random.default_rng(0)

    def scenes(name: str, source: str, odds: float) -> confidence.Segments:
        inputs = rng.uniform((3.0, -6.0, 0.0), (9.0, 1.0, 6.0), (400, 3))
        whole = rng.random(400) < 1.0 / (1.0 + np.exp(-(1.2 * inputs[:, 0] - 0.5 * inputs[:, 1] - 7.0 + odds)))
        return confidence.Segments(name, source, [], inputs, np.ones(400, np.bool_), whole)

    alike = [scenes("images", source, 0.0) for source in ("one", "another")] + [scenes("OSD", "OSD", 0.0)]
    np.testing.assert_allclose(confidence.fit(alike), (1.2, -0.5, 0.0, -7.0), atol=0.4)
    answers = list(confidence.left_out(alike))
    for row in confidence.rows(answers):
        assert row["Brier"] < row["Brier of a constant"]
    for row in confidence.reliability(answers):
        assert abs(float(row["mean, images"]) - float(row["whole, images"])) < 0.12
    strange = [*alike, scenes("images", "strange", -100.0)]
    of_strange = next(sure for one, sure, _ in confidence.left_out(strange) if one.source == "strange")
    assert of_strange.mean() > 0.3  # it does not know that none is whole there
