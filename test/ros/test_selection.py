# SPDX-License-Identifier: Apache-2.0
"""The topics `mask` and `clicked_point` of perception, over DDS."""

import numpy as np
import pytest
from geometry_msgs.msg import Point, PointStamped
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

import foretouch as ft
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import stamp_to_msg
from foretouch.stream import Stream, StreamConfig
from foretouch.types import Cloud
from foretouch_msgs.msg import GraspArray, ObjectArray, Status, TouchPredictionArray

pytestmark = pytest.mark.ros

START = 1_700_000_000_000_000_000


class Table:
    """Perception with a camera, a mask and a person who clicks."""

    def __init__(self, graph, **parameters):
        self.graph = graph
        (self.node,) = graph.add("perception", input="points", **parameters)
        kinds = {"objects": ObjectArray, "grasps": GraspArray, "touch": TouchPredictionArray}
        self.heard = {topic: graph.listen(kind, topic) for topic, kind in kinds.items()}
        self.clouds, self.clicks = graph.talk(PointCloud2, "points"), graph.talk(PointStamped, "clicked_point")
        self.masks = graph.talk(Image, "mask")
        graph.matched("points", "clicked_point", *kinds)
        if parameters.get("mask"):
            graph.matched("mask")

    def send(self, cloud, mask=None, frame=None):
        before = len(self.heard["touch"])
        if mask is not None:
            self.masks.publish(image(mask, cloud.stamp_ns, cloud.frame_id if frame is None else frame))
        self.clouds.publish(cloud_to_msg(cloud))
        self.graph.until(lambda: all(len(found) > before for found in self.heard.values()))
        return {topic: found[-1] for topic, found in self.heard.items()}

    def click(self, point, frame, stamp_ns=0):
        before = self.node.reported().values.get("clicked_point")
        x, y, z = map(float, point)
        header = Header(frame_id=frame, stamp=stamp_to_msg(stamp_ns))
        self.clicks.publish(PointStamped(header=header, point=Point(x=x, y=y, z=z)))
        self.graph.until(lambda: self.node._segmentation._selection._click is not None)
        return before


def image(mask, stamp_ns, frame, encoding="mono8"):
    dtype = np.uint8 if encoding == "mono8" else np.uint16
    data = np.asarray(mask, dtype)
    height, width = data.shape
    header = Header(frame_id=frame, stamp=stamp_to_msg(stamp_ns))
    step = width * data.itemsize
    return Image(header=header, height=height, width=width, encoding=encoding, step=step, data=data.tobytes())


def test_a_clicked_object_is_the_target_until_another_is_clicked_and_bad_clicks_change_nothing(
    graph, model_card, scene_cloud
):
    table = Table(graph, model=model_card)
    cloud = scene_cloud(0, stamp_ns=START)
    frame = cloud.frame_id
    scene = Pipeline(PipelineConfig(model=model_card)).segment(cloud)
    nearest, other = (object_.id for object_ in scene.objects[:2])
    assert [grasp.object_id for grasp in table.send(cloud)["grasps"].grasps] == [nearest]
    for clicked, expected in ((1, other), (0, nearest), (1, other)):
        table.click(scene.objects[clicked].cloud.xyz[5], frame)
        found = table.send(cloud)
        assert {grasp.object_id for grasp in found["grasps"].grasps} == {expected}
        assert found["grasps"].reason == f"selected: object {expected} was clicked"
        assert "selected" in found["touch"].predictions[0].flags
        assert [str(object_.id) for object_ in found["objects"].objects if object_.target] == [expected]
    beyond = scene.objects[0].cloud.xyz[0] + np.float32([0.0, 0.0, 0.4])
    bad = [
        ((scene.objects[0].centroid, "map"), "refused: frame 'map' is not the frame of the clouds"),
        ((beyond, frame), "refused: point: no object within 0.03 m"),
        (([0.0, 0.0, np.nan], frame), "is not three finite numbers"),
        ((scene.objects[0].centroid, frame, START), "s old, more than click_age_s 10"),
    ]
    for arguments, text in bad:
        table.click(*arguments)
        assert {grasp.object_id for grasp in table.send(cloud)["grasps"].grasps} == {other}
        assert text in table.node.reported().values["clicked_point"]


def test_the_labels_of_a_mask_of_the_same_stamp_are_the_objects(graph, model_card, scene_cloud):
    table = Table(graph, model=model_card, mask="same_stamp", mask_wait_s=5.0)
    cloud = scene_cloud(0, stamp_ns=START)
    pipeline = Pipeline(PipelineConfig(model=model_card))
    labels = pipeline.segment(cloud).labels
    mask = np.where(labels == 2, 200, 0)
    found = table.send(cloud, mask)
    (result,) = pipeline.run(cloud, mask=mask).targets
    assert [object_.id for object_ in found["objects"].objects] == ["200"]
    np.testing.assert_array_equal(found["objects"].objects[0].indices, result.target.pixels)
    (grasp,) = found["grasps"].grasps
    assert (grasp.object_id, grasp.g1.x) == ("200", result.plan.grasps[0].g1[0])
    np.testing.assert_array_equal(
        np.float32(found["touch"].predictions[0].values), result.predictions.value[0, 2:].astype(np.float32)
    )
    other = table.send(scene_cloud(0, stamp_ns=START + 4), mask, "camera_color_optical_frame")
    assert other["touch"].status == Status.UNKNOWN_FRAME
    assert other["touch"].reason.startswith("mask: frame 'camera_color_optical_frame' is not the frame of the image")
    nameless = table.send(scene_cloud(0, stamp_ns=START + 5), mask, "")
    assert [object_.id for object_ in nameless["objects"].objects] == ["200"]
    small = table.send(scene_cloud(0, stamp_ns=START + 1), mask[:-1])
    assert (small["touch"].status, small["objects"].status) == (Status.BAD_REQUEST, Status.BAD_REQUEST)
    assert small["touch"].reason.startswith("mask: shape")
    empty = table.send(scene_cloud(0, stamp_ns=START + 2), 0 * mask)
    assert empty["touch"].reason == "mask: holds no label above 0"
    graph.set(table.node, mask_wait_s=0.0)
    missing = table.send(scene_cloud(0, stamp_ns=START + 3))
    assert missing["touch"].reason.startswith("mask: no mask of this stamp came within 0 s on ")


def test_the_answers_to_a_stream_are_those_of_the_library_through_clicks_and_other_settings(
    graph, scene_cloud, model_card
):
    """Ids, held grasps, the clicked object and `target.mode` free with the planner's own settings, to the bit."""
    given = {"grasp.count": 3, "grasp_hold": 0.3, "hand.name": "franka_hand", "limits.max_extent_m": 0.8}
    stream = Stream(StreamConfig().updated({"model": model_card, "target.mode": "free", **given}, "test"))
    table = Table(graph, model=model_card, **{"target.mode": "free", **given})
    rng = np.random.default_rng(2)
    still, answers = scene_cloud(1), []
    for number in range(6):
        xyz = still.xyz * (1.0 + rng.normal(0.0, 0.0005, (*still.xyz.shape[:2], 1)))
        cloud = Cloud(xyz.astype(np.float32), None, still.frame_id, START + number * 33_000_000)
        if number == 2:
            clicked = answers[-1].scene.objects[-1]
            table.click(clicked.cloud.xyz[5], cloud.frame_id)
            stream.select(clicked.id)
        if number == 4:
            graph.set(table.node, late_after_s=1.0)  # no part of it
        heard, found = table.send(cloud), stream.answer(cloud)
        answers.append(found)
        assert [str(object_.id) for object_ in heard["objects"].objects] == [one.id for one in found.scene.objects]
        planned = [grasp for one in found.targets for grasp in one.plan.grasps]
        assert planned
        assert [grasp.id for grasp in heard["grasps"].grasps] == [grasp.id for grasp in planned]
        assert [grasp.score for grasp in heard["grasps"].grasps] == [np.float32(grasp.score) for grasp in planned]
        contacts = [[grasp.g1.x, grasp.g1.y, grasp.g1.z] for grasp in heard["grasps"].grasps]
        np.testing.assert_array_equal(contacts, [grasp.g1 for grasp in planned])
        rows = ft.reading(heard["touch"])
        values = np.concatenate([one.predictions.value for one in found.targets])
        np.testing.assert_array_equal(rows.value.astype(np.float32), values.astype(np.float32))
        assert [set(own) - {"late"} for own in rows.flags] == [
            set(own) for one in found.targets for own in one.predictions.flags
        ]
        assert ("selected" in rows.flags[0]) == (number >= 2)
        assert all(len(set(own)) == len(own) for own in rows.flags)


def test_touch_comes_after_the_objects_and_grasps_that_it_refers_to_and_one_answer_for_each_stamp(
    graph, scene_cloud, model_card, monkeypatch
):
    """Also where publishing one of them fails: the others stay the answer to their cloud."""
    table = Table(graph, model=model_card)
    order = []
    for topic, publisher in (
        ("objects", table.node._segmentation._objects),
        ("grasps", table.node._planner._grasps),
        ("touch", table.node._touch._touch),
    ):
        real = publisher.publish
        monkeypatch.setattr(
            publisher, "publish", lambda message, real=real, topic=topic: (order.append(topic), real(message))
        )
    table.send(scene_cloud(0, stamp_ns=START))
    assert order == ["objects", "grasps", "touch"]

    def fail(*_: object) -> None:
        raise RuntimeError("no more")

    monkeypatch.setattr(type(table.node._planner), "publish", fail)
    found = table.send(scene_cloud(0, stamp_ns=START + 1))
    assert order[3:] == ["objects", "grasps", "touch"]
    assert (found["grasps"].status, found["touch"].status, found["objects"].status) == (
        Status.FAILED,
        Status.OK,
        Status.OK,
    )
