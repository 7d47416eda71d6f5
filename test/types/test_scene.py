# SPDX-License-Identifier: Apache-2.0
import numpy as np
from scene_builders import scene_cloud

from foretouch.pipeline import Pipeline
from foretouch.types.scene import Object


def test_an_object_with_a_name_of_its_own_is_no_obstacle_for_itself() -> None:
    pipeline = Pipeline()
    scene = pipeline.segment(scene_cloud(1, objects=3, width=320))
    assert len(scene.objects) > 1
    for target in scene.objects:
        others = sorted({int(object_.id) for object_ in scene.objects} - {int(target.id)})
        for cloud in (target.cloud, target.cloud.take(np.arange(0, target.n_points, 2))):
            named = Object.of("mug", cloud, target.plane, obstacles=scene.obstacles)
            assert sorted(set(scene.obstacles.without(named).object_ids.tolist())) == others
        named = Object.of("mug", target.cloud, target.plane, obstacles=scene.obstacles)
        np.testing.assert_array_equal(pipeline.plan(named).grasps.g1, pipeline.plan(target).grasps.g1)
    both = np.concatenate([object_.cloud.xyz for object_ in scene.objects[:2]])
    joined = Object.of("pair", type(scene.cloud)(both), scene.table, obstacles=scene.obstacles)
    assert not set(scene.obstacles.without(joined).object_ids.tolist()) & {1, 2}
    empty = Object.of("nothing", type(scene.cloud)(both[:0]), scene.table)
    assert len(scene.obstacles.without(empty).xyz) == len(scene.obstacles.xyz)
