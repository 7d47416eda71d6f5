# SPDX-License-Identifier: Apache-2.0
"""Depth topics as drivers publish them: the answer of the pipeline to the same image, and one named refusal for each fault."""

import array

import numpy as np
import pytest
from depth_builders import compressed, png, rvl
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.nodes import NODES
from foretouch.types import Cloud
from foretouch_msgs.msg import Status, TouchPredictionArray

pytestmark = pytest.mark.ros
FRAME = "camera_depth_optical_frame"


def image(depth, stamp, *, encoding="16UC1", frame=FRAME, padding=0, **changes):
    rows = np.zeros((depth.shape[0], depth.shape[1] * depth.itemsize + padding), np.uint8)
    rows[:, : depth.shape[1] * depth.itemsize] = np.ascontiguousarray(depth).view(np.uint8)
    message = Image(header=header_to_msg(frame, stamp), height=depth.shape[0], width=depth.shape[1], encoding=encoding)
    message.step, message.data = rows.shape[1], array.array("B", rows.tobytes())
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def info(width, height, k, frame=FRAME):
    message = CameraInfo(header=header_to_msg(frame, 1), width=width, height=height, distortion_model="plumb_bob")
    message.d, message.k = [0.0] * 5, [k[0], 0.0, k[2], 0.0, k[1], k[3], 0.0, 0.0, 1.0]
    return message


@pytest.fixture(scope="module")
def depth(scene_cloud):
    """(H, W) uint16 [mm] of a scene, and fx, fy, cx, cy of its camera."""
    cloud = scene_cloud()
    z = cloud.xyz[..., 2].astype(np.float64)
    row, column = np.indices(z.shape)
    known = np.isfinite(z)
    fx, cx = (
        np.polynomial.polynomial.Polynomial.fit((cloud.xyz[..., 0] / z)[known], column[known], 1).convert().coef[::-1]
    )
    fy, cy = np.polynomial.polynomial.Polynomial.fit((cloud.xyz[..., 1] / z)[known], row[known], 1).convert().coef[::-1]
    return np.nan_to_num(z * 1000.0).round().astype(np.uint16), tuple(map(float, (fx, fy, cx, cy)))


class Camera:
    """A driver, and perception with what it answers."""

    def __init__(self, graph, model, kind=Image, topic="depth/image", reliable=True, remap=()):
        self.graph = graph
        options = {"cli_args": ["--ros-args", *remap]} if remap else {}
        self.node = NODES.load("perception")(parameter_overrides=graph.parameters(model=model), **options)
        graph.serve(self.node)
        self.node.autostart()
        self.heard = graph.listen(TouchPredictionArray, "touch")
        self.images = graph.talk(kind, topic, reliable=reliable)
        self.infos = graph.talk(CameraInfo, topic.removesuffix("/compressedDepth").rpartition("/")[0] + "/camera_info")
        graph.matched(topic, self.infos.topic_name, "touch")

    def send(self, message):
        """Publish an image; the answer to it."""
        count = len(self.heard)
        self.images.publish(message)
        self.graph.until(lambda: len(self.heard) > count)
        return self.heard[-1]

    def answered(self):
        """The number of answers by status, as /diagnostics has it."""
        values = self.node.reported().values
        return {key.removeprefix("answered."): int(n) for key, n in values.items() if key.startswith("answered.")}

    def say(self, message):
        """Publish an info, and wait until it is known."""
        before = self.node._camera._infos._known.copy()
        self.infos.publish(message)
        self.graph.until(lambda: self.node._camera._infos._known != before)


def readings(answer):
    return np.array([[*prediction.scalars, *prediction.values] for prediction in answer.predictions])


def test_the_graph_answers_an_image_as_the_pipeline_does_whatever_its_encoding(graph, depth, model_card):
    mm, k = depth
    (felt,) = Pipeline(PipelineConfig(model=model_card)).run(Cloud.from_depth(mm, k, frame_id=FRAME)).targets
    expected = felt.predictions.value.astype(np.float32)
    camera = Camera(graph, model_card, reliable=False)
    camera.say(info(mm.shape[1], mm.shape[0], k))
    metres = mm.astype(np.float32) * np.float32(0.001)
    metres[mm == 0] = np.nan
    big = image(mm.astype(">u2"), 3, is_bigendian=1)
    for message in (image(mm, 1), image(mm, 2, padding=6), big, image(mm, 4, encoding="mono16")):
        answer = camera.send(message)
        assert (answer.header, answer.status) == (message.header, Status.OK), answer.reason
        np.testing.assert_array_equal(readings(answer), expected)
    assert camera.send(image(metres, 5, encoding="32FC1")).status == Status.OK
    summary = camera.node.statistics.summary()
    assert (summary.received, dict(summary.dropped)) == (5, {})


def test_compressed_depth_beside_its_info_is_decoded_by_a_remap_alone(graph, depth, model_card):
    mm, k = depth
    remap = ("-r", "depth/image:=/cam/depth/image_rect_raw/compressedDepth")
    topic = "/cam/depth/image_rect_raw/compressedDepth"
    camera = Camera(graph, model_card, CompressedImage, topic, remap=remap)
    camera.say(info(mm.shape[1], mm.shape[0], k))
    answers = []
    for stamp, data in enumerate((png(mm), rvl(mm)), 1):
        given = compressed(data, f"16UC1; compressedDepth {'png' if stamp == 1 else 'rvl'}")
        message = CompressedImage(header=header_to_msg(FRAME, stamp), format=given.format)
        message.data = array.array("B", given.data)
        answers.append(camera.send(message))
    assert [answer.status for answer in answers] == [Status.OK] * 2
    np.testing.assert_array_equal(*map(readings, answers))
    message.header.stamp.nanosec, message.data = 3, array.array("B", given.data[:-80])
    answer = camera.send(message)
    assert (answer.status, len(answer.predictions)) == (Status.BAD_CLOUD, 0)
    assert answer.reason.startswith("data: the RVL is truncated or damaged")
    assert camera.answered() == {"ok": 2, "bad_cloud": 1}


def test_an_image_waits_for_the_first_info_and_without_one_it_is_refused_by_name(graph, depth, model_card):
    mm, k = depth
    camera = Camera(graph, model_card)
    answer = camera.send(image(mm, 1))
    assert answer.status == Status.BAD_CLOUD
    assert answer.reason.startswith("no_camera_info: /foretouch/depth/camera_info: none for 3.")
    camera.images.publish(image(mm, 2))
    camera.say(info(mm.shape[1], mm.shape[0], k))
    graph.until(lambda: len(camera.heard) > 1)
    assert camera.send(image(mm, 3)).status == Status.OK


def test_each_fault_of_an_image_or_an_info_is_one_named_refusal_and_the_next_image_is_answered(
    graph, depth, model_card
):
    mm, k = depth
    size, camera = (mm.shape[1], mm.shape[0]), Camera(graph, model_card)
    camera.say(info(*size, k))
    good = image(mm, 1)
    cases = [
        ("encoding: '8UC1' is no depth image", image(mm.astype(np.uint8), 2, encoding="8UC1")),
        ("other_size: ", image(mm[::2, ::2], 3)),
        ("other_frame: ", image(mm, 4, frame="elsewhere")),
        ("frame_id: is empty", image(mm, 5, frame="")),
        ("size: 30000x30000 is not between", image(mm, 8, height=30_000, width=30_000)),
        (
            "for millimetres pass scale=0.001",
            image(mm.astype(np.float32), 10, encoding="32FC1"),
        ),  # millimetres as metres
    ]
    for text, message in cases:
        answer = camera.send(message)
        assert (answer.status not in (Status.OK, Status.INITIAL_POINTS), len(answer.predictions)) == (True, 0), text
        assert text in answer.reason
    for stamp in (50, 20):  # that go back
        good.header.stamp.nanosec = stamp
        assert camera.send(good).status == Status.OK
    camera.say(info(*size, (0.0, 0.0, 0.0, 0.0)))
    answer = camera.send(image(mm, 60))
    assert answer.reason.startswith("bad_camera_info: ")
    for factor in (1, 2, 1):  # of two publishers
        camera.say(info(*size, (k[0] * factor, *k[1:])))
    assert "two_camera_infos: " in camera.send(image(mm, 61)).reason
    summary = camera.node.statistics.summary()
    assert summary.received == summary.used + sum(summary.dropped.values()) == len(camera.heard)
    assert camera.answered() == {"ok": 2, "bad_cloud": 7, "unknown_frame": 1}


def test_clouds_that_are_remapped_but_not_received_are_told(graph, model_card, capfd):
    options = {"cli_args": ["--ros-args", "-r", "points:=/camera/points"]}
    node = NODES.load("perception")(parameter_overrides=graph.parameters(model=model_card), **options)
    graph.serve(node)
    node.autostart()
    assert "/camera/points is not received: input is depth; set input:=points" in capfd.readouterr().err
