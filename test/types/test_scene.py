# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
from every_case import every_refusal
from scene_builders import scene_cloud

from foretouch.errors import CloudError
from foretouch.pipeline import Pipeline
from foretouch.types import ASSUMED_TABLE, Cloud
from foretouch.types.scene import Object, Obstacles, Scene


def test_an_object_with_a_name_of_its_own_is_no_obstacle_for_itself() -> None:
    pipeline = Pipeline()
    scene = pipeline.segment(scene_cloud(1, objects=3, width=320))
    assert len(scene.objects) > 1
    for target in scene.objects:
        others = sorted({int(object_.id) for object_ in scene.objects} - {int(target.id)})
        for cloud in (target.cloud, target.cloud.take(np.arange(0, target.n_points, 2))):
            named = Object.of("mug", cloud, target.plane, obstacles=scene.obstacles)
            assert sorted(set(scene.obstacles.without(named).object_ids.tolist())) == others
        named = replace(target, id="mug")
        np.testing.assert_array_equal(pipeline.plan(named).grasps.g1, pipeline.plan(target).grasps.g1)
    both = np.concatenate([object_.cloud.xyz for object_ in scene.objects[:2]])
    joined = Object.of("pair", type(scene.cloud)(both), scene.table, obstacles=scene.obstacles)
    assert not set(scene.obstacles.without(joined).object_ids.tolist()) & {1, 2}
    empty = Object.of("nothing", type(scene.cloud)(both[:0]), scene.table)
    assert len(scene.obstacles.without(empty).xyz) == len(scene.obstacles.xyz)


def test_fields_of_wrong_types_are_named_with_what_they_must_be() -> None:
    cloud = Cloud(np.ones((4, 3)))
    one = Object.of("1", cloud, ASSUMED_TABLE)
    scene = Scene("ok", "", cloud, None, (one,), (), np.empty((0, 3)), np.zeros(4, np.int32), {}, {})
    of_objects = [
        ("id: 1 is not a text", {"id": 1}),
        ("cloud: ndarray is not a Cloud", {"cloud": cloud.xyz}),
        ("plane: tuple is not a Plane, such as Plane.from_coefficients", {"plane": (0, 0, 1, 1)}),
        ("centroid: above is not of numbers", {"centroid": "above"}),
        (r"bounds: shape \(3,\) is not \(2, 3\); Object.of", {"bounds": np.zeros(3)}),
        ("pixels: list is not an array", {"pixels": [1, 2]}),
        ("flags: cut is not a tuple of texts", {"flags": "cut"}),
        ("flags: 3 is not a text", {"flags": (3,)}),
        ("confidence: high is not a number", {"confidence": "high"}),
        ("obstacles: list is not Obstacles", {"obstacles": []}),
    ]
    of_scenes = [
        ("table: tuple is not a Plane", {"table": (0, 0, 1, 1)}),
        ("objects: list is not a tuple of objects", {"objects": [one]}),
        ("targets: holds str, not Object", {"targets": ("1",)}),
        (r"labels: shape \(3,\) is not \(4,\), of the cloud", {"labels": np.zeros(3, np.int32)}),
        ("counts: 5 is not numbers by name", {"counts": 5}),
    ]
    every_refusal(CloudError, of_objects, lambda changes: replace(one, **changes))
    every_refusal(CloudError, of_scenes, lambda changes: replace(scene, **changes))
    every_refusal(CloudError, [("obstacles: shapes", np.zeros((3, 3)), np.zeros(2))], Obstacles)
