# SPDX-License-Identifier: Apache-2.0
"""points -> touch through perception, over DDS."""

import math

import numpy as np
import pytest
from every_case import every_case
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from foretouch import reading
from foretouch.cloud.messages import decode_plane
from foretouch.grasp.messages import decode_grasp
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.types import Cloud, stamp_ns
from foretouch_msgs.msg import GraspArray, ObjectArray, Status, TablePlane, TouchPredictionArray

pytestmark = pytest.mark.ros

OUTPUTS = {"objects": ObjectArray, "table": TablePlane, "object_cloud": PointCloud2, "grasps": GraspArray,
           "touch": TouchPredictionArray}  # fmt: skip
START = 1_700_000_000_000_000_000


class Chain:
    """Perception with a publisher of clouds, and lists of what it publishes."""

    def __init__(self, graph, model):
        self.graph = graph
        (self.node,) = graph.add("perception", model=model)
        self.heard = {topic: graph.listen(kind, topic) for topic, kind in {**OUTPUTS, "markers": MarkerArray}.items()}
        self.publisher = graph.talk(PointCloud2, "points")
        graph.matched("points", *OUTPUTS)
        graph.matched("markers", publishers=2)

    def send(self, cloud):
        """Publish a cloud, or its message, and wait for all answers to it."""
        before = len(self.heard["touch"])
        self.publisher.publish(cloud_to_msg(cloud) if isinstance(cloud, Cloud) else cloud)
        self.graph.until(lambda: all(len(self.heard[topic]) > before for topic in OUTPUTS))
        return {topic: self.heard[topic][-1] for topic in OUTPUTS}


@pytest.fixture
def chain(graph, model_card):
    return Chain(graph, model_card)


def values(prediction):
    return np.array([*prediction.scalars, *prediction.values])


def test_nodes_and_command_line_give_the_same_bits_in_the_frame_and_stamp_of_the_cloud(chain, scene_cloud, model_card):
    chain.graph.set(chain.node, hand__approach_m=0.3)  # so far that other objects stand in the way of some grasps
    pipeline, blocked = Pipeline(PipelineConfig(model=model_card).updated({"hand.approach_m": 0.3})), 0
    for seed in range(4):
        cloud = scene_cloud(seed, stamp_ns=START + 1 + seed)
        found = chain.send(cloud)
        for topic, message in found.items():
            stamped = stamp_ns(message.header.stamp), message.header.frame_id
            assert stamped == (START + 1 + seed, "camera_depth_optical_frame"), topic
        (felt,) = pipeline.run(cloud).targets
        blocked += felt.plan.counts["n_blocked"]
        table, obstacles = found["table"], pipeline.segment(cloud).obstacles
        np.testing.assert_array_equal(decode_plane(table.plane).coefficients, felt.target.plane.coefficients)
        np.testing.assert_array_equal(np.reshape(table.obstacles, (-1, 3)).astype(np.float32), obstacles.xyz)
        assert {str(one) for one in table.obstacle_ids} == {object_.id for object_ in found["objects"].objects}
        (chosen,) = [object_ for object_ in found["objects"].objects if object_.target]
        grasps = found["grasps"].grasps
        assert [one.object_id for one in grasps] == [chosen.id] * len(felt.plan.grasps)  # ids of a stream are its own
        np.testing.assert_array_equal(chosen.indices, felt.target.pixels)
        for message, grasp in zip(grasps, felt.plan.grasps, strict=True):
            received = decode_grasp(message)
            for name in ("g1", "g2", "rotation"):
                np.testing.assert_array_equal(getattr(received, name), getattr(grasp, name))
        for message, prediction in zip(found["touch"].predictions, felt.predictions, strict=True):
            np.testing.assert_array_equal(values(message), prediction.value.values.astype(np.float32))
            assert {*prediction.flags, "late"} <= set(message.flags)  # the stamp is years old
            assert (message.header, message.model, len(message.model_sha256)) == (found["touch"].header, "small", 64)
            assert math.isnan(reading(message)["PDC"].lower[0])
        assert found["touch"].predictions[0].grasp.id == grasps[0].id
    assert blocked > 0


def test_the_target_and_the_grasp_of_a_still_scene_are_kept(chain, scene_cloud):
    chain.graph.set(chain.node, target__margin_m=1.0)  # both objects are equally near
    chain.graph.set(chain.node, grasp_hold=5.0)  # far more than the noise of the score
    cloud, rng, grasps = scene_cloud(3), np.random.default_rng(5), []
    for number in range(6):
        noise = rng.normal(0.0, 1e-4, cloud.xyz.shape).astype(np.float32)
        found = chain.send(Cloud(cloud.xyz + noise, None, cloud.frame_id, cloud.stamp_ns + number))
        (prediction,) = found["touch"].predictions
        assert "ambiguous_target" in prediction.flags
        assert found["grasps"].reason.startswith("ambiguous_target: objects 1 and 2 are equally near to the camera")
        if number:
            assert "was the target before" in found["grasps"].reason
        grasps.append(decode_grasp(found["grasps"].grasps[0]))
    for grasp in grasps[1:]:
        np.testing.assert_array_equal(np.stack([grasp.g1, grasp.g2]), np.stack([grasps[0].g1, grasps[0].g2]))


def test_a_bad_cloud_is_answered_with_the_reason_and_the_next_one_is_served(chain, scene_cloud):
    good = scene_cloud()

    def cloud(*xyz):
        return cloud_to_msg(Cloud(np.stack(xyz, axis=-1).astype(np.float32), frame_id="cam", stamp_ns=7))

    def changed(change):
        message = cloud_to_msg(good)
        change(message)
        return message

    def check(reason, status, message):
        found = chain.send(message)
        assert found["object_cloud"].width == 0
        for topic, entries in (("objects", "objects"), ("grasps", "grasps"), ("touch", "predictions")):
            assert found[topic].status == status, (topic, found[topic].reason)
            assert reason in found[topic].reason
            assert found[topic].reason
            assert len(getattr(found[topic], entries)) == 0
        assert chain.send(scene_cloud(stamp_ns=99))["touch"].predictions

    nowhere, place = np.full((240, 424), np.nan), np.full(5000, 0.7)
    rows, columns = np.mgrid[0:240, 0:424]
    cases = [
        ("row_step", Status.BAD_CLOUD, changed(lambda m: setattr(m, "width", m.width + 3))),
        ("z is missing", Status.BAD_CLOUD, changed(lambda m: setattr(m, "fields", m.fields[:2]))),
        ("frame_id: is empty", Status.UNKNOWN_FRAME, changed(lambda m: setattr(m.header, "frame_id", ""))),
        ("holds no point", Status.EMPTY_CLOUD, cloud([], [], [])),
        ("none of 101760 points is finite", Status.EMPTY_CLOUD, cloud(nowhere, nowhere, nowhere)),
        ("", Status.NO_PLANE, cloud(place, place, place)),
        ("nothing stands", Status.NO_OBJECT, cloud((columns - 212) / 400, (rows - 120) / 400, np.ones((240, 424)))),
    ]
    every_case(cases, check)


def test_targets_limits_and_lateness_are_parameters(chain, scene_cloud):
    graph = chain.graph
    graph.set(chain.node, target__mode="all", grasp__count=3, late_after_s=60.0)
    found = chain.send(scene_cloud(n_objects=3, stamp_ns=graph.probe.get_clock().now().nanoseconds))
    ids, grasps = [object_.id for object_ in found["objects"].objects], [grasp.id for grasp in found["grasps"].grasps]
    assert len(ids) == 3
    assert {grasp.object_id for grasp in found["grasps"].grasps} == set(ids)
    assert [p.grasp.id for p in found["touch"].predictions] == grasps
    assert len(set(grasps)) == len(grasps)
    for prediction in found["touch"].predictions:
        assert ("late" in prediction.flags, prediction.input_age.sec < 60) == (False, True)
    graph.set(chain.node, limits__max_extent_m=0.03)
    found = chain.send(scene_cloud())
    for topic in ("grasps", "touch"):
        assert found[topic].status == Status.NO_GRASP
        assert "more than max_extent_m 0.03" in found[topic].reason
    graph.set(chain.node, target__mode="point", target__point=[0.0, 0.0, 9.0])
    found = chain.send(scene_cloud())
    assert (found["touch"].status, "no object within" in found["touch"].reason) == (Status.NO_TARGET, True)
    assert len(found["objects"].objects) == 2  # still published, only not chosen


def test_markers_show_all_and_those_that_fail_do_not_answer_a_second_time(chain, scene_cloud, monkeypatch):
    chain.send(scene_cloud())
    wanted = {"objects", "object_ids", "contacts", "hand", "thumb", "middle_finger"}
    chain.graph.until(lambda: {marker.ns for array in chain.heard["markers"] for marker in array.markers} >= wanted)

    def fail(*_, **__):
        raise FloatingPointError("overflow")

    for step, name in (("segmentation", "object_markers"), ("touch", "touch_markers")):
        monkeypatch.setattr(f"foretouch.ros.steps.{step}.{name}", fail)
    found = chain.send(scene_cloud(stamp_ns=98))
    assert found["touch"].status == found["objects"].status == Status.OK
    chain.graph.until(lambda: chain.node.internal_errors.counts()["markers"] == 2)
    chain.send(scene_cloud(stamp_ns=99))
    assert len(chain.heard["touch"]) == len(chain.heard["objects"]) == 3
