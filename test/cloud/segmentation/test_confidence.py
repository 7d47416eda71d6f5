# SPDX-License-Identifier: Apache-2.0
"""How sure segmentation is that a segment is one whole object, and the targets that are selected by it."""

from dataclasses import replace

import numpy as np
from every_case import every_case
from scene_builders import table_scene

from foretouch.cloud.segmentation.clusters import Clusters
from foretouch.cloud.segmentation.objects import CUT, TargetConfig, confidence, inputs, select_free, select_targets
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.pipeline import Pipeline
from foretouch.types import ASSUMED_TABLE, Cloud
from foretouch.types.scene import Object


def _window(*joins: tuple[float, float, float]) -> Clusters:
    rows = np.array([(np.nan,) * 3, *joins])
    return Clusters(np.zeros((1, 1), np.int32), np.zeros((1, 1), np.bool_), len(joins), joins=rows)


def test_large_segments_with_clear_borders_are_surer() -> None:
    """A refused join that was nearly one, an accepted one that nearly was not, and few cells each lower the confidence."""
    window = _window((-np.inf, np.inf, 1000.0), (0.5, np.inf, 1000.0), (-np.inf, 0.7, 1000.0), (-np.inf, np.inf, 60.0))
    alone, *others = (confidence(window, label, 1) for label in range(1, 5))
    assert alone is not None
    assert alone > 0.95
    for other in others:
        assert other is not None
        assert 0.0 < other < alone - 0.004


def test_a_segment_that_nothing_touches_has_the_cells_of_its_points() -> None:
    whole = Clusters(np.zeros((1, 1), np.int32), np.zeros((1, 1), np.bool_), 1, pixels_per_cell=9.0)
    assert confidence(whole, 1, 9000) == confidence(_window((-np.inf, np.inf, 1000.0)), 1, 5)
    assert inputs(whole._replace(pixels_per_cell=0.0), 1, 9000) is None
    assert confidence(whole._replace(pixels_per_cell=0.0), 1, 9000) is None


def test_what_is_not_segmented_or_cannot_be_split_has_no_confidence() -> None:
    xyz = table_scene()
    found = segment(Cloud(xyz))
    assert all(one.confidence is not None and 0.0 < one.confidence < 1.0 for one in found.objects)
    assert f"whole with probability {found.objects[0].confidence:.2f}" in repr(found.objects[0])
    whole = segment(Cloud(xyz), SegmentationConfig().updated({"split.angle_deg": 180.0}))
    masked = Pipeline().segment(Cloud(xyz), mask=found.labels)
    given = Object.of("1", found.objects[0].cloud, ASSUMED_TABLE)
    for one in (*whole.objects, *masked.objects, given):
        assert one.confidence is None


def test_a_list_of_the_points_is_as_sure_as_their_image() -> None:
    xyz = table_scene()
    image = segment(Cloud(xyz)).objects
    points = xyz.reshape(-1, 3)[np.isfinite(xyz.reshape(-1, 3)).all(axis=1)]
    some = points[np.random.default_rng(0).permutation(len(points))[: len(points) // 2]]
    listed = segment(Cloud(some)).objects  # half of them are no image
    assert len(listed) == len(image) > 0
    for one, other in zip(image, listed, strict=True):
        assert abs(one.confidence - other.confidence) < 0.1


def _object(number: int, depth_m: float, sure: float | None, *flags: str) -> Object:
    xyz = np.random.default_rng(number).uniform(-0.02, 0.02, (100, 3)) + np.array([0.06 * number, 0.0, depth_m])
    return replace(Object.of(str(number), Cloud(xyz.astype(np.float32)), ASSUMED_TABLE), confidence=sure, flags=flags)


def test_the_nearest_of_the_surest_is_selected() -> None:
    near, sure, surer = _object(1, 0.6, 0.7), _object(2, 0.7, 0.95), _object(3, 0.8, 0.99)
    cut, unknown = _object(4, 0.5, 0.99, CUT), [_object(1, 0.6, None), _object(2, 0.7, None)]

    def check(objects: list[Object], rule: dict[str, object], chosen: str) -> None:
        assert [one.id for one in select_targets(objects, TargetConfig(**rule))[0]] == [chosen]

    cases = {
        "within the margin": ([near, sure, surer], {}, "2"),
        "a wider margin": ([near, sure, surer], {"confidence_margin": 0.3}, "1"),
        "cut by the image": ([cut, near, sure], {}, "2"),
        "all cut": ([cut], {}, "4"),
        "not known": (unknown, {}, "1"),
        "by another rule": ([near, sure, surer], {"mode": "point", "point": tuple(near.centroid)}, "1"),
    }
    every_case(cases, check)


def test_the_target_of_a_stream_stays_though_its_confidence_falls_below_the_margin() -> None:
    near, far = _object(1, 0.6, 0.91), _object(2, 0.8, 0.99)
    config = TargetConfig()
    assert select_targets([near, far], config)[0] == [far]
    assert select_targets([near, far], config, near.centroid)[0] == [near]
    fallen = replace(near, confidence=0.85)
    assert select_targets([fallen, far], config, near.centroid)[0] == [far]


def test_of_free_objects_the_surest_come_first() -> None:
    near, sure, cut = _object(1, 0.6, 0.5), _object(2, 0.8, 0.99), _object(3, 0.5, 0.99, CUT)
    free, blocked = (0.0, ""), (1.0, "is blocked by object 9")
    for losses, chosen in (({}, "2"), ({"2": blocked}, "3"), ({"2": blocked, "3": blocked}, "1")):
        found, _ = select_free(
            [cut, near, sure], TargetConfig(mode="free"), lambda one, of=losses: of.get(one.id, free)
        )
        assert [one.id for one in found] == [chosen]
