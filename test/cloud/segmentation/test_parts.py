# SPDX-License-Identifier: Apache-2.0
"""Objects that touch, in images of solids whose labels are known exactly."""

from collections.abc import Sequence

import numpy as np
import pytest
from counted_work import calls_at_most
from kernels.references import split as reference
from safetensors.numpy import load_file

from benchmarks.random_scenes import Primitive
from foretouch.cloud.segmentation import parts
from foretouch.cloud.segmentation.parts import SPLIT_COUNTS
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.types import AnyArray, Cloud, Float32, Float64
from foretouch.types.scene import Scene
from foretouch_lab.simulation.depth_scene import CameraView

_H, _W = 360, 480
_EYE = np.array([0.0, -0.6, 0.65])  # above the table z = 0, which is seen at 47 degrees
_AXES = np.array([[1.0, 0.0, 0.0], [0.0, -0.735, -0.678], [0.0, 0.678, -0.735]])  # of the camera: right, down, forward
_MATRIX = np.array([[500.0, 0.0, (_W - 1) / 2], [0.0, 500.0, (_H - 1) / 2], [0.0, 0.0, 1.0]])
_VIEW = CameraView(_W, _H, _MATRIX, _EYE, _AXES.T)
_NO_SPLIT = SegmentationConfig().updated({"split.angle_deg": 180.0})
_Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def _box(low: AnyArray, high: AnyArray) -> Primitive:
    return Primitive("box", np.subtract(high, low), np.mean([low, high], axis=0))


def _can(foot: tuple[float, float, float], radius: float, top: float) -> Primitive:
    height = top - foot[2]
    return Primitive("cylinder", np.array([2 * radius, 2 * radius, height]), np.add(foot, [0.0, 0.0, height / 2]))


def _bowl_hit(rays: Float64, centre: AnyArray, radius: float) -> Float64:
    """Depth of the lower half of a hollow ball: the first wall below its rim."""
    a, b = (rays * rays).sum(-1), rays @ (_EYE - centre)
    root = np.sqrt(np.maximum(b * b - a * ((_EYE - centre) @ (_EYE - centre) - radius**2), 0.0))
    walls = [np.where(_EYE[2] + t * rays[..., 2] < centre[2], t, np.inf) for t in ((-b - root) / a, (-b + root) / a)]
    return np.where(root > 0.0, np.minimum(*walls), np.inf)


_Ball = tuple[tuple[float, float, float], float]  # centre and radius; a bowl is the lower half of one
_Can = tuple[tuple[float, float, float], float, float]  # foot, radius, height of its top


def _scene(
    boxes: Sequence[_Box] = (),
    balls: Sequence[_Ball] = (),
    noise: float = 0.0005,
    cans: Sequence[_Can] = (),
    bowls: Sequence[_Ball] = (),
    table: Float64 | None = None,
) -> tuple[Float32, AnyArray]:
    """(H, W, 3) points and (H, W) true labels, the table 0: z = 0, or the depth of each ray (inf for none)."""
    rays = _VIEW.directions()
    hits = [-_EYE[2] / rays[..., 2] if table is None else table]
    solids = [_box(low, high) for low, high in boxes]
    solids += [Primitive("ball", np.full(3, 2 * radius), np.array(centre)) for centre, radius in balls]
    solids += [_can(foot, radius, top) for foot, radius, top in cans]
    hits += [solid.cast(_EYE, rays) for solid in solids]
    hits += [_bowl_hit(rays, np.array(centre), radius) for centre, radius in bowls]
    depth = np.min(hits, axis=0) + np.random.default_rng(0).normal(0.0, noise, (_H, _W))
    xyz = rays @ _VIEW.R_world_camera * depth[..., None]
    return xyz.astype(np.float32), np.argmin(hits, axis=0)


def _iou(found: Scene, truth: AnyArray) -> list[float]:
    """Of each true object with the one that has most of it."""
    result = []
    for k in range(1, int(truth.max()) + 1):
        ids, sizes = np.unique(found.labels[truth == k], return_counts=True)
        best = ids[np.argmax(np.where(ids > 0, sizes, -1))]
        result.append(((found.labels == best) & (truth == k)).sum() / ((found.labels == best) | (truth == k)).sum())
    return result


_LOW: _Box = ((-0.08, -0.05, 0.0), (0.08, 0.09, 0.06))
_TOUCHING = {
    "one on another": ([_LOW, ((-0.04, -0.01, 0.06), (0.04, 0.06, 0.12))], []),
    "a ball on a box": ([_LOW], [((0.0, 0.02, 0.1), 0.04)]),
    "two balls": ([], [((-0.04, 0.0, 0.04), 0.04), ((0.04, 0.0, 0.04), 0.04)]),
    "a ball beside a box": ([_LOW], [((0.125, 0.02, 0.045), 0.045)]),
}


@pytest.mark.parametrize("name", _TOUCHING)
def test_solids_that_touch_are_parts(name: str) -> None:
    xyz, truth = _scene(*_TOUCHING[name])
    clusters = 2 if name == "a ball on a box" else 1  # the far side of the lid lies behind the ball
    assert len(segment(Cloud(xyz), _NO_SPLIT).objects) == clusters
    found = segment(Cloud(xyz))
    assert len(found.objects) == 2
    assert min(_iou(found, truth)) > 0.85
    assert (found.counts["clusters"], found.counts["parts"]) == (clusters, 2)


@pytest.mark.parametrize("solid", [([_LOW], []), ([], [((0.0, 0.0, 0.06), 0.06)])])
def test_one_convex_solid_is_not_processed(
    solid: tuple[list[_Box], list[tuple[tuple[float, float, float], float]]],
) -> None:
    found = segment(Cloud(_scene(*solid)[0]))
    assert len(found.objects) == 1
    assert found.counts["clusters"] == found.counts["parts"] == 0


def test_a_box_on_both_sides_of_a_nearer_one_is_one_and_two_of_other_heights_are_two() -> None:
    post: _Box = ((-0.03, -0.12, 0.0), (0.03, -0.06, 0.2))
    whole = segment(Cloud(_scene([((-0.13, 0.02, 0.0), (0.13, 0.08, 0.08)), post])[0]))
    assert (len(whole.objects), whole.counts["joined_hidden"]) == (2, 1)
    other: list[_Box] = [((-0.13, 0.02, 0.0), (-0.01, 0.08, 0.08)), ((0.01, 0.05, 0.0), (0.13, 0.11, 0.11)), post]
    assert len(segment(Cloud(_scene(other)[0])).objects) == 3


_BODY: _Can = ((0.0, 0.0, 0.0), 0.045, 0.1)


def test_a_neck_belongs_to_its_bottle_and_a_can_beside_the_axis_or_on_a_box_does_not() -> None:
    neck: _Can = ((0.0, 0.0, 0.1), 0.022, 0.16)
    assert len(segment(Cloud(_scene(cans=[_BODY, neck])[0])).objects) == 1
    for name, scene in {
        "beside": _scene(cans=[_BODY, ((0.015, 0.0, 0.1), 0.022, 0.16)]),
        "on a box": _scene([((-0.05, -0.05, 0.0), (0.05, 0.05, 0.1))], cans=[neck]),
        "on a narrower one": _scene(cans=[((0.0, 0.0, 0.0), 0.04, 0.12), ((0.01, 0.0, 0.12), 0.055, 0.18)]),
        "a box on it": _scene([((-0.01, -0.03, 0.1), (0.05, 0.03, 0.16))], cans=[_BODY]),
    }.items():
        found = segment(Cloud(scene[0]))
        assert len(found.objects) == 2, name
        assert min(_iou(found, scene[1])) > 0.8, name


def test_a_bowl_that_is_seen_into_is_one_and_two_are_two() -> None:
    bowl: _Ball = ((0.0, 0.0, 0.075), 0.07)
    whole = segment(Cloud(_scene(bowls=[bowl])[0]))
    assert len(whole.objects) == 1
    assert whole.counts["joined_border"] >= 1
    two, truth = _scene(bowls=[((-0.075, 0.0, 0.075), 0.07), ((0.075, 0.0, 0.075), 0.07)])
    found = segment(Cloud(two))
    assert len(found.objects) == 2
    assert min(_iou(found, truth)) > 0.85


def test_without_a_table_or_with_two_or_its_edge_before_the_objects() -> None:
    solids = _TOUCHING["one on another"]
    rays = _VIEW.directions()
    floor = -_EYE[2] / rays[..., 2]
    behind = (_EYE + floor[..., None] * rays)[..., 1]
    higher = (0.25 - _EYE[2]) / rays[..., 2]  # a second table, beyond the first
    beyond = (_EYE + higher[..., None] * rays)[..., 1] > 0.35
    edge = np.where(behind > -0.06, floor, (-0.7 - _EYE[2]) / rays[..., 2])  # 1 cm before the objects
    for name, table, count in (
        ("no table", np.full((_H, _W), np.inf), None),
        ("two", np.where(beyond, higher, floor), 2),
        ("edge", edge, 2),
    ):
        xyz, truth = _scene(*solids, table=table)
        found = segment(Cloud(xyz))
        assert all(np.isfinite(object_.cloud.xyz).all() for object_ in found.objects), name
        if count is None:
            assert found.status == "ok" or found.reason, name
        else:
            assert min(_iou(found, truth)) > 0.85, name


@pytest.mark.slow
def test_the_kernel_finds_the_parts_of_its_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    config = SegmentationConfig()
    handle: _Box = ((0.08, 0.0, 0.02), (0.093, 0.015, 0.04))
    post: _Box = ((-0.03, -0.12, 0.0), (0.03, -0.06, 0.2))
    images = {name: _scene(*solids)[0] for name, solids in _TOUCHING.items()} | {
        "a handle": _scene([_LOW, handle])[0],
        "two clusters": _scene([_LOW, ((0.086, 0.0, 0.0), (0.15, 0.1, 0.1))])[0],
        "a neck": _scene(cans=[_BODY, ((0.0, 0.0, 0.1), 0.022, 0.16)])[0],
        "a bowl": _scene(bowls=[((0.0, 0.0, 0.075), 0.07)])[0],
        "behind a post": _scene([((-0.13, 0.02, 0.0), (0.13, 0.08, 0.08)), post])[0],
    }
    trees = load_file(parts.TREES)["trees"][:-1]  # no multiple of those that the kernel walks at a time
    known = parts.Trees.of(trees)
    monkeypatch.setattr(parts, "_trees", lambda: known)
    ours = {name: segment(Cloud(xyz), config) for name, xyz in images.items()}
    monkeypatch.setattr(parts, "split_window", lambda *window: reference.split_window(*window, trees))
    for name, xyz in images.items():
        one, other = ours[name], segment(Cloud(xyz), config)
        assert len(one.objects) == len(other.objects), name
        assert one.counts["clusters"] == other.counts["clusters"], name
        assert one.counts["parts"] == other.counts["parts"], (
            name
        )  # of which fragments they are joined, rounding decides
        assert ((one.labels > 0) == (other.labels > 0)).mean() > 0.9999, name
        least = 0.95 if name == "two balls" else 0.98  # a tiny fragment between two equal balls may be of either
        assert min(_iou(one, other.labels)) > least, name
        pairs = zip(one.objects, other.objects, strict=True)
        apart = [abs(a.confidence - b.confidence) for a, b in pairs]
        assert max(apart, default=0.0) < (0.2 if name == "two balls" else 0.02), (name, apart)
    rules = {rule: sum(our.counts[rule] for our in ours.values()) for rule in SPLIT_COUNTS[2:]}
    assert all(rules.values()), rules


def test_hard_images_give_finite_parts_in_time() -> None:
    xyz, _ = _scene(*_TOUCHING["one on another"])
    border = xyz.copy()
    border[:40] = border[-40:] = border[:, :40] = border[:, -40:] = np.nan
    steps = xyz / xyz[..., 2:] * (np.rint(xyz[..., 2:] / 0.005) * 0.005)
    plane = _scene([], noise=0.0)[0]
    v, u = np.indices((_H, _W))
    depth = np.where((v % 16 < 11) & (u % 20 < 14), 0.77, 0.8)  # 540 objects, seen from above
    many = _VIEW.directions() @ _VIEW.R_world_camera * depth[..., None]
    for name, image, count in (
        ("border", border, 2),
        ("steps", steps, 2),
        ("plane", plane, 0),
        ("row", xyz[200:201], None),
        ("500", many, None),
    ):
        with calls_at_most(200_000):
            found = segment(Cloud(np.ascontiguousarray(image, np.float32)))
        assert count is None or len(found.objects) == count, name
        assert all(np.isfinite(object_.cloud.xyz).all() for object_ in found.objects)
        used = ("not_finite", "out_of_range", "off_ray", "background", "rejected", "flying", "objects")
        assert found.counts["received"] == sum(found.counts[one] for one in used)


@pytest.mark.parametrize("name", _TOUCHING)
def test_a_list_of_points_that_is_no_image_has_the_same_parts(name: str) -> None:
    """Thinned, jittered, and merged with those of a second view that also saw some of the back, in any order."""
    rng = np.random.default_rng(1)
    xyz, truth = _scene(*_TOUCHING[name])
    flat, labels = xyz.reshape(-1, 3), truth.ravel()
    some = rng.permutation(len(flat))[:60_000]
    jittered = flat[some] + rng.normal(0.0, 0.0003, (len(some), 3)).astype(np.float32)
    object_points = np.flatnonzero(labels > 0)
    behind = flat[object_points] * np.float32(1.008)  # 6 mm behind the surface: another view's, or of the back
    lists = {
        "thinned": (flat[some], labels[some]),
        "jittered": (jittered, labels[some]),
        "merged": (np.concatenate([jittered, behind]), np.concatenate([labels[some], labels[object_points]])),
    }
    for kind, (points, of_each) in lists.items():
        order = rng.permutation(len(points))
        found = segment(Cloud(np.ascontiguousarray(points[order], np.float32)))
        assert len(found.objects) == 2, kind
        assert found.counts["parts"] == 2, kind
        assert min(_iou(found, of_each[order])) > 0.8, kind
        assert found.counts["received"] == len(points)
        again = segment(Cloud(np.ascontiguousarray(points[order], np.float32)), _NO_SPLIT)
        assert again.counts["parts"] == 0
