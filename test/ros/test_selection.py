# SPDX-License-Identifier: Apache-2.0
"""The topics `mask` and `clicked_point` of perception, over DDS."""

import numpy as np
import pytest
from geometry_msgs.msg import Point, PointStamped
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import stamp_to_msg
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
