# SPDX-License-Identifier: Apache-2.0
"""`color/image` beside depth: the colours of the same stamp reach the points, and no image of it costs or changes an answer."""

import array
import io
import time

import numpy as np
import pytest
from calibrated_models import save_small_network
from numpy.testing import assert_array_equal
from PIL import Image as Pillow
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from benchmarks.random_scenes import random_scene
from foretouch.cloud.messages import decode_objects
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.nodes import NODES
from foretouch.types import ASSUMED_TABLE
from foretouch_msgs.msg import Status, TouchPredictionArray

pytestmark = pytest.mark.ros
FRAME = "camera_depth_optical_frame"
MS = 1_000_000
FRAME_OF_SCENE = random_scene(np.random.default_rng(3), width=320, height=240, n_objects=2).render()


def _image(rows, stamp_ms, encoding, frame=FRAME, padding=0):
    """An image of (H, W) or (H, W, C), with bytes behind each row."""
    height, width = rows.shape[:2]
    data = np.pad(np.ascontiguousarray(rows).view(np.uint8).reshape(height, -1), ((0, 0), (0, padding)))
    message = Image(header=header_to_msg(frame, stamp_ms * MS), height=height, width=width, encoding=encoding)
    message.step, message.data = data.shape[1], array.array("B", data.tobytes())
    return message


def _compressed(pixels, stamp_ms, kind, **options):
    content = io.BytesIO()
    Pillow.fromarray(pixels).save(content, kind, **options)
    message = CompressedImage(
        header=header_to_msg(FRAME, stamp_ms * MS), format=f"rgb8; {kind.lower()} compressed bgr8"
    )
    message.data = array.array("B", content.getvalue())
    return message


class Driver:
    """A camera with colours, and perception with what it answers."""

    def __init__(self, graph, model, *, looked_at=True, kind=Image, remap=(), **parameters):
        self.graph = graph
        options = {"cli_args": ["--ros-args", *remap]} if remap else {}
        overrides = graph.parameters(model=model, **parameters)
        self.node = NODES.load("perception")(parameter_overrides=overrides, **options)
        graph.serve(self.node)
        self.node.autostart()
        self.heard = graph.listen(TouchPredictionArray, "touch")
        self.points = graph.listen(PointCloud2, "object_cloud") if looked_at else []
        topic = remap[-1].partition(":=")[2] if remap else "color/image"
        self.images, self.colours = graph.talk(Image, "depth/image"), graph.talk(kind, topic)
        infos = graph.talk(CameraInfo, "depth/camera_info")
        graph.matched("depth/image", infos.topic_name, "touch", *([topic, "object_cloud"] if looked_at else []))
        k, (height, width) = FRAME_OF_SCENE.K.ravel().tolist(), FRAME_OF_SCENE.depth_mm.shape
        info = CameraInfo(header=header_to_msg(FRAME, 1), width=width, height=height, distortion_model="plumb_bob")
        info.d, info.k = [0.0] * 5, k
        infos.publish(info)

    def colour(self, message):
        """Publish a colour image, and wait until it has come."""
        count = self.counts().get("received", 0)
        self.colours.publish(message)
        self.graph.until(lambda: self.counts().get("received", 0) > count)

    def depth(self, stamp_ms):
        """Publish the depth image; the answer to it."""
        answers = len(self.heard)
        self.images.publish(_image(FRAME_OF_SCENE.depth_mm, stamp_ms, "16UC1"))
        self.graph.until(lambda: len(self.heard) > answers)
        return self.heard[-1]

    def coloured(self):
        """The colours of the points that were published last, and those of the picture at their pixels."""
        self.graph.until(lambda: len(self.points) == len(self.heard))
        (target, *_) = decode_objects(self.points[-1], ASSUMED_TABLE)
        rows, columns = np.divmod(target.pixels, target.image_shape[1])
        return target.cloud.rgb, FRAME_OF_SCENE.rgb[rows, columns]

    def warnings(self):
        return [text for text in self.node.reported().warnings if text.startswith("color/image")]

    def counts(self):
        values = self.node.reported().values
        return {key.removeprefix("color."): int(n) for key, n in values.items() if key.startswith("color.")}


def _readings(answer):
    return np.array([[*prediction.scalars, *prediction.values] for prediction in answer.predictions])


def test_points_have_the_colours_of_their_stamp_in_every_encoding_and_answers_are_the_same(graph, model_card):
    driver, rgb = Driver(graph, model_card), FRAME_OF_SCENE.rgb
    plain = driver.depth(10)
    assert plain.status == Status.OK, plain.reason
    assert driver.coloured()[0] is None
    alpha = np.full((*rgb.shape[:2], 1), 7, np.uint8)
    cases = {
        "rgb8": (rgb, 0),
        "bgr8": (rgb[..., ::-1], 5),
        "rgba8": (np.concatenate([rgb, alpha], axis=-1), 0),
        "bgra8": (np.concatenate([rgb[..., ::-1], alpha], axis=-1), 3),
    }
    for stamp, (encoding, (pixels, padding)) in enumerate(cases.items(), 20):
        driver.colour(_image(pixels, stamp, encoding, padding=padding))
        answer = driver.depth(stamp)
        assert_array_equal(*driver.coloured())
        assert_array_equal(_readings(answer), _readings(plain))
    assert driver.counts() == {"received": 4, "paired": 4}


def test_a_depth_image_waits_for_its_colours_and_takes_the_nearest_within_the_tolerance(graph, model_card):
    driver, rgb = Driver(graph, model_card, color_wait_s=1.0, color_tolerance_s=0.02), FRAME_OF_SCENE.rgb
    driver.colour(_image(rgb * 0, 900, "rgb8"))
    driver.images.publish(_image(FRAME_OF_SCENE.depth_mm, 1000, "16UC1"))
    time.sleep(0.2)
    assert not driver.heard
    driver.colour(_image(rgb, 1000, "rgb8"))  # of its stamp
    graph.until(lambda: driver.heard)
    assert_array_equal(*driver.coloured())
    for stamp, pixels in ((2012, rgb), (2031, rgb * 0)):  # no later one can be nearer
        driver.colour(_image(pixels, stamp, "rgb8"))
    driver.depth(2000)
    assert_array_equal(*driver.coloured())
    driver.colour(_image(rgb, 3030, "rgb8"))
    driver.depth(3000)
    assert driver.coloured()[0] is None
    assert driver.counts() == {"received": 5, "paired": 2, "unpaired": 1}
    rule = "color/image: no image is within 0.02 s of the depth image: the nearest is 0.03 s away"
    assert driver.warnings() == [rule]


def test_colours_of_another_size_frame_or_kind_are_named_and_the_depth_is_answered(graph, model_card):
    driver, rgb = Driver(graph, model_card), FRAME_OF_SCENE.rgb
    cases = [
        (_image(rgb[:120], 1, "rgb8"), "320x120 pixels are not those of the depth image, 320x240: align it"),
        (_image(rgb, 2, "rgb8", frame="camera_color_optical_frame"), "header.frame_id: 'camera_color_optical_frame' is not that of the depth image, 'camera_depth_optical_frame'"),
        (_image(rgb.astype(np.uint16), 3, "rgb16"), "encoding: 'rgb16' is not one of rgb8, bgr8, rgba8, bgra8"),
        (_image(rgb[..., 0], 4, "mono8"), "encoding: 'mono8' is not one of"),
        (_image(FRAME_OF_SCENE.depth_mm, 5, "16UC1"), "encoding: '16UC1' is not one of"),
        (_image(rgb[:, :160], 6, "rgb8"), "160x240 pixels are not"),
    ]  # fmt: skip
    for number, (message, rule) in enumerate(cases, 1):
        driver.colour(message)
        assert driver.depth(number).status == Status.OK
        (warning,) = driver.warnings()
        assert rule in warning
    assert driver.counts() == {"received": 6, "refused": 6}


def test_compressed_colours_are_read_by_a_remap_alone(graph, model_card):
    topic = "/cam/color/image_raw/compressed"
    driver = Driver(graph, model_card, kind=CompressedImage, remap=("-r", f"color/image:={topic}"))
    driver.colour(_compressed(FRAME_OF_SCENE.rgb, 1, "PNG"))
    driver.depth(1)
    assert_array_equal(*driver.coloured())
    driver.colour(_compressed(FRAME_OF_SCENE.rgb, 2, "JPEG", quality=95))
    driver.depth(2)
    found, expected = driver.coloured()
    assert np.abs(found.astype(int) - expected).mean() < 8.0
    cut = _compressed(FRAME_OF_SCENE.rgb, 3, "JPEG")
    cut.data = cut.data[: len(cut.data) // 2]
    driver.colour(cut)
    assert driver.depth(3).status == Status.OK
    assert "data: is truncated or damaged" in driver.warnings()[0]
    assert driver.counts() == {"received": 3, "paired": 2, "refused": 1}


def test_a_model_that_takes_colours_gets_them_where_nobody_else_looks(graph, tmp_path):
    card = save_small_network(tmp_path, "coloured", np.linspace(1700.0, 3300.0, 50), channels="xyz+rgb")
    driver = Driver(graph, card, looked_at=False)
    graph.matched("color/image")
    refused = driver.depth(1).predictions[0]
    assert (refused.status, refused.reason) == (
        Status.REFUSED,
        "channels: the model needs xyz+rgb and the cloud has no rgb",
    )
    readings = []
    for stamp, pixels in ((2, FRAME_OF_SCENE.rgb), (3, 255 - FRAME_OF_SCENE.rgb), (4, FRAME_OF_SCENE.rgb)):
        driver.colour(_image(pixels, stamp, "rgb8"))
        readings.append(_readings(driver.depth(stamp)))
    assert_array_equal(readings[0], readings[2])
    assert (readings[0] != readings[1]).any()


def test_colours_that_nobody_looks_at_are_not_received(graph, model_card):
    driver = Driver(graph, model_card, looked_at=False, color_wait_s=1.0)
    assert driver.depth(50).status == Status.OK
    assert driver.colours.get_subscription_count() == 0
    points = []
    subscription = graph.probe.create_subscription(PointCloud2, "object_cloud", points.append, 10)
    graph.until(lambda: driver.colours.get_subscription_count() == 1)
    driver.colour(_image(FRAME_OF_SCENE.rgb, 51, "rgb8"))
    driver.depth(51)
    graph.until(lambda: points)
    assert driver.counts() == {"received": 1, "paired": 1}
    graph.probe.destroy_subscription(subscription)
    graph.until(lambda: driver.colours.get_subscription_count() == 0)
    assert driver.depth(52).status == Status.OK
    assert not driver.warnings()
