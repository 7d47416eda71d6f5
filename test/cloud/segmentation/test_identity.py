# SPDX-License-Identifier: Apache-2.0
"""Ids of objects in a stream of clouds: noise, a hand, and a pile that falls apart."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from foretouch.cloud.segmentation.identity import ObjectIdentity
from foretouch.cloud.segmentation.segment import segment
from foretouch.types import Cloud, Float32
from foretouch.types.scene import Scene


def _table() -> Float32:
    """A table 0.8 m below the camera, 240 x 320 pixels."""
    return np.full((240, 320), 0.8, np.float32)


def _put(depth: Float32, row: int, column: int, *, size: int = 40, top: float = 0.7) -> Float32:
    depth[row : row + size, column : column + size] = top
    return depth


def _segmented(depth: Float32) -> Scene:
    v, u = np.indices(depth.shape)
    xyz = np.stack([(u - 159.5) / 307.5 * depth, (v - 119.5) / 307.5 * depth, depth], axis=-1)
    return segment(Cloud(xyz.astype(np.float32)))


def keep(identity: ObjectIdentity, scene: Scene) -> Scene:
    """The scene with the ids of a stream."""
    named = zip(scene.objects, identity.ids(scene), strict=True)
    return replace(scene, objects=tuple(replace(object_, id=name) for object_, name in named))


def _place(found: Scene, row: int, column: int) -> int:
    return int(found.labels[row, column])


def test_noisy_clouds_of_a_still_scene_keep_their_ids_though_the_order_by_distance_changes() -> None:
    rng = np.random.default_rng(0)
    identity, orders, ids = ObjectIdentity(), set(), set()
    for _ in range(150):
        depth = _put(_put(_put(_table(), 60, 60), 60, 220), 140, 140)
        raw = _segmented((depth + rng.normal(0.0, 0.001, depth.shape)).astype(np.float32))
        orders.add((_place(raw, 80, 80), _place(raw, 80, 240)))
        kept = keep(identity, raw)
        ids.add((_place(kept, 80, 80), _place(kept, 80, 240), _place(kept, 160, 160)))
        assert {int(object_.id) for object_ in kept.objects} == set(np.unique(kept.labels)) - {0}
    assert len(orders) == 2  # the test is one: without identity, ids change
    assert len(ids) == 1


def test_a_hand_takes_no_id_and_a_hidden_object_gets_its_id_back() -> None:
    identity = ObjectIdentity()
    scene = _put(_put(_table(), 60, 60), 60, 220)
    before = keep(identity, _segmented(scene))
    hand = _put(scene.copy(), 50, 50, size=70, top=0.5)  # nearer than the object, and all over it
    during = keep(identity, _segmented(hand))
    after = keep(identity, _segmented(scene))
    assert during.counts["new_ids"] <= 1
    assert _place(before, 80, 240) == _place(during, 80, 240) == _place(after, 80, 240)
    assert _place(after, 80, 80) == _place(before, 80, 80)


def test_a_list_of_points_is_compared_by_centroid() -> None:
    identity, rng = ObjectIdentity(), np.random.default_rng(1)
    depth = _put(_put(_table(), 60, 60), 60, 220)
    v, u = np.indices(depth.shape)
    xyz = np.stack([(u - 159.5) / 307.5 * depth, (v - 119.5) / 307.5 * depth, depth], axis=-1).reshape(-1, 3)
    clouds = [keep(identity, segment(Cloud(rng.permutation(xyz).astype(np.float32)))) for _ in range(5)]
    for one, other in pairwise(clouds):
        near = {obj.id: obj.centroid for obj in other.objects}
        assert len(one.objects) == len(other.objects) == 2
        assert all(np.linalg.norm(near[obj.id] - obj.centroid) < 1e-3 for obj in one.objects)
