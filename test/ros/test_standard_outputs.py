# SPDX-License-Identifier: Apache-2.0
"""What programs read that do not know this package: labels and overlay as images, and objects as `vision_msgs`."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sensor_msgs.msg import Image, PointCloud2

from foretouch.cloud.io.mask_files import decode_mask
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.report.camera_figure import pixels_of
from foretouch.report.hand_figure import COLOURS
from foretouch.report.panels import FINGER_COLOURS
from foretouch.ros.messages.clouds import cloud_to_msg, labels_to_msg, overlay_to_msg
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.types import Cloud
from foretouch.types.scene import Scene
from foretouch_msgs.msg import ObjectArray

pytestmark = pytest.mark.ros


def rgb(image):
    assert (image.encoding, image.step, len(image.data)) == ("rgb8", 3 * image.width, 3 * image.width * image.height)
    return np.reshape(image.data, (image.height, image.width, 3)).astype(int)


def test_labels_and_overlay_show_the_objects_that_are_published(graph, scene_cloud):
    graph.add("segmentation", publish_labels=True, publish_overlay=True)
    kinds = {"objects": ObjectArray, "labels": Image, "overlay": Image}
    heard = {topic: graph.listen(kind, topic) for topic, kind in kinds.items()}
    points = graph.talk_matched(PointCloud2, "points")
    graph.matched(*kinds)
    points.publish(cloud_to_msg(scene_cloud(n_objects=3, width=848)))
    graph.until(lambda: all(heard.values()))
    objects, labels, overlay = (heard[topic][0] for topic in kinds)
    assert objects.header == labels.header == overlay.header
    assert (labels.encoding, labels.height, labels.width) == ("16UC1", objects.height, objects.width)
    pixels = decode_mask(labels)  # as the topic `mask` takes it
    assert {str(label) for label in np.unique(pixels)} == {"0", *(one.id for one in objects.objects)}
    assert (overlay.height, overlay.width) == (240, 424)  # of 480 x 848
    drawn = pixels[::2, ::2].ravel()
    colours, grey = rgb(overlay).reshape(-1, 3), drawn == 0
    assert (colours[grey].min(axis=1) == colours[grey].max(axis=1)).all()
    saturations = {}
    for one in objects.objects:
        assert (pixels.ravel()[one.indices] == int(one.id)).all()
        own = colours[drawn == int(one.id)]
        saturations[one.target] = float((own.max(axis=1) - own.min(axis=1)).mean())
    assert saturations[True] > saturations[False] > 20.0


def test_a_label_is_one_number_of_16_bits_and_never_0_for_an_object():
    labels = np.array([[0, 1, 65535], [65536, 131070, 131071]], np.int32)
    cloud = Cloud(np.ones((2, 3, 3), np.float32))
    scene = Scene("ok", "", cloud, None, (), (), np.empty((0, 3)), labels, {}, {})
    message = labels_to_msg(scene, header_to_msg("cam", 5))
    assert_array_equal(decode_mask(message), [[0, 1, 65535], [1, 65535, 1]])
    coloured = Scene(
        "ok", "", Cloud(cloud.xyz, np.full((2, 3, 3), 7, np.uint8)), None, (), (), np.empty((0, 3)), labels, {}, {}
    )
    assert rgb(overlay_to_msg(coloured, message.header))[0, 0].tolist() == [7, 7, 7]
    square = np.zeros((9, 9), np.int32)
    square[2:7, 2:7] = 1
    cloud = Cloud(np.ones((9, 9, 3), np.float32), np.full((9, 9, 3), 7, np.uint8))
    scene = Scene("ok", "", cloud, None, (), (), np.empty((0, 3)), square, {}, {})
    outlined = (rgb(overlay_to_msg(scene, message.header)) == (0, 166, 214)).all(axis=2)  # the colour of id 1
    inner = np.zeros_like(outlined)
    inner[3:6, 3:6] = True
    assert_array_equal(outlined, (square == 1) & ~inner)
    nothing = Scene("no_plane", "", Cloud(np.full((2, 3, 3), np.nan, np.float32)), None, (), (), np.empty((0, 3)),
                    np.zeros((2, 3), np.int32), {}, {})  # fmt: skip
    assert not rgb(overlay_to_msg(nothing, message.header)).any()


def test_the_overlay_shows_the_ids_and_the_first_grasp_with_its_hand(scene_cloud):
    pipeline = Pipeline(PipelineConfig().updated({"hand.name": "robotiq_2f140"}))
    scene = pipeline.segment(scene_cloud(n_objects=3, width=848))
    grasp = pipeline.plan(scene.objects[0]).grasps[0]
    bare, drawn = (rgb(overlay_to_msg(scene, header_to_msg("cam", 5), one)) for one in (None, grasp))
    ends = (pixels_of(scene.cloud, np.stack([grasp.g1, grasp.g2])) / 2.0).round().astype(int)
    colours = [tuple(int(text[k : k + 2], 16) for k in (1, 3, 5)) for text in FINGER_COLOURS[:2]]
    for (column, row), colour in zip(ends, colours, strict=True):
        near = drawn[row - 3 : row + 4, column - 3 : column + 4]
        assert (near == colour).all(axis=2).any(), colour
    grey = [int(COLOURS["palm"][k : k + 2], 16) for k in (1, 3, 5)]
    assert (drawn == grey).all(axis=2).sum() > (bare == grey).all(axis=2).sum()
    for one in scene.objects:  # the id is white on its object
        row, column = (int(np.median(places)) // 2 for places in np.divmod(one.pixels, 848))
        assert (bare[row - 8 : row + 9, column - 8 : column + 9] > 220).all(axis=2).any(), one.id


def test_objects_are_detections_in_the_frame_of_the_results_where_their_package_is_installed(graph, scene_cloud):
    try:
        from vision_msgs.msg import Detection3DArray
    except ImportError:
        (node,) = graph.add("segmentation", publish_detections=True)
        assert node.failure == (
            "vision_msgs/Detection3DArray: vision_msgs is not installed; source the workspace that holds it"
        )
        pytest.skip("vision_msgs is not installed")
    pose = [0.5, -0.2, 1.4, 1.0, 0.0, 0.0, 0.0]  # half a turn about x
    graph.add("segmentation", publish_detections=True, output_frame="base_link", camera_pose=pose)
    heard, objects = graph.listen(Detection3DArray, "detections"), graph.listen(ObjectArray, "objects")
    points = graph.talk_matched(PointCloud2, "points")
    graph.matched("detections", "objects")
    points.publish(cloud_to_msg(scene_cloud(n_objects=3, width=848)))
    graph.until(lambda: heard and objects)
    assert heard[0].header == objects[0].header
    assert heard[0].header.frame_id == "base_link"
    for detection, one in zip(heard[0].detections, objects[0].objects, strict=True):
        low, high = (np.array([corner.x, corner.y, corner.z]) for corner in (one.minimum, one.maximum))
        centre, size = detection.bbox.center.position, detection.bbox.size
        assert_allclose([centre.x, centre.y, centre.z], (low + high) / 2.0, atol=1e-9)
        assert_allclose([size.x, size.y, size.z], high - low, atol=1e-9)
        (result,) = detection.results
        assert (detection.id, result.hypothesis.class_id) == (one.id, "object")
        assert result.hypothesis.score == pytest.approx(one.confidence, abs=1e-6)
        assert result.pose.pose.position == one.centroid
    points.publish(cloud_to_msg(Cloud(np.full((4, 4, 3), np.nan, np.float32), frame_id="cam")))
    graph.until(lambda: len(heard) == 2)
    assert not heard[1].detections
