# SPDX-License-Identifier: Apache-2.0
"""points -> touch through the three nodes, over DDS."""

import math

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from foretouch.dataset.messages import decode_grasp
from foretouch.grasp import LiveGeoGraspConfig
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.executables import PERCEPTION
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import plane_from_msg
from foretouch.ros.runtime.diagnostics import InputSummary
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Cloud
from foretouch_msgs.msg import GraspArray, ObjectArray, Status, TablePlane, TouchPredictionArray

pytestmark = pytest.mark.ros

OUTPUTS = {"objects": ObjectArray, "table": TablePlane, "object_cloud": PointCloud2, "grasps": GraspArray,
           "touch": TouchPredictionArray}  # fmt: skip


@pytest.fixture
def chain(graph, model_card):
    """The three nodes with a publisher of clouds, and lists of what they say."""
    graph.add(*PERCEPTION, model=model_card)
    heard = {topic: graph.listen(message, topic) for topic, message in OUTPUTS.items()}
    heard["markers"] = graph.listen(MarkerArray, "markers")
    publisher = graph.talk(PointCloud2, "points")
    graph.matched("points")
    for topic in OUTPUTS:
        graph.matched(topic)
    return graph, publisher, heard


def send(chain, message):
    """Publish one cloud and wait for the end of its road."""
    graph, publisher, heard = chain
    before = len(heard["touch"])
    publisher.publish(message)
    graph.until(lambda: len(heard["touch"]) > before and all(len(heard[topic]) > before for topic in OUTPUTS))
    return {topic: heard[topic][-1] for topic in OUTPUTS}


def values(prediction):
    return np.array(
        [prediction.pdc_th.value, prediction.pdc_mf.value, *(i.value for i in (*prediction.e_th, *prediction.e_mf))]
    )


def test_nodes_and_command_line_give_the_same_bits(chain, scene_cloud, model_card):
    pipeline = Pipeline(PipelineConfig(model=model_card, grasp=LiveGeoGraspConfig()))
    for seed in range(3):
        cloud = scene_cloud(seed, stamp_ns=1_700_000_000_000_000_001 + seed)
        said = send(chain, cloud_to_msg(cloud))
        result = pipeline.run(cloud)
        (felt,) = result.targets
        np.testing.assert_array_equal(plane_from_msg(said["table"].plane).coefficients, felt.target.plane.coefficients)
        chosen = [one for one in said["objects"].objects if one.target]
        assert [one.id for one in chosen] == [felt.target.id]
        np.testing.assert_array_equal(chosen[0].indices, felt.target.pixels)
        assert len(said["grasps"].grasps) == len(felt.plan.grasps) > 0
        for message, grasp in zip(said["grasps"].grasps, felt.plan.grasps, strict=True):
            received = decode_grasp(message)
            for name in ("g1", "g2", "rotation"):
                np.testing.assert_array_equal(getattr(received, name), getattr(grasp, name))
        for message, prediction in zip(said["touch"].predictions, felt.predictions, strict=True):
            np.testing.assert_array_equal(values(message), prediction.value.vector().astype(np.float32))
            assert set(prediction.flags) <= set(message.flags)


def test_the_target_and_the_grasp_of_a_still_scene_are_kept(chain, scene_cloud):
    graph, *_ = chain
    graph.nodes[0].set_parameters([rclpy_parameter("target.margin_m", 1.0)])  # both objects are equally near
    graph.nodes[1].set_parameters([rclpy_parameter("grasp_hold", 5.0)])  # far more than the noise of the score
    cloud = scene_cloud(3)
    rng = np.random.default_rng(5)
    grasps = []
    for number in range(6):
        noise = rng.normal(0.0, 1e-4, cloud.xyz.shape).astype(np.float32)
        said = send(chain, cloud_to_msg(Cloud(cloud.xyz + noise, None, cloud.frame_id, cloud.stamp_ns + number)))
        (prediction,) = said["touch"].predictions
        assert "ambiguous_target" in prediction.flags
        assert said["grasps"].reason.startswith("ambiguous_target: objects 1 and 2 are equally near to the camera")
        if number:
            assert "was the target before" in said["grasps"].reason
        grasps.append(decode_grasp(said["grasps"].grasps[0]))
    for grasp in grasps[1:]:
        np.testing.assert_array_equal(np.stack([grasp.g1, grasp.g2]), np.stack([grasps[0].g1, grasps[0].g2]))


def test_frame_and_stamp_are_kept_through_the_whole_chain(chain, scene_cloud):
    said = send(chain, cloud_to_msg(scene_cloud(stamp_ns=1_234_567_890_987_654_321)))
    for topic, message in said.items():
        assert stamp_ns(message.header.stamp) == 1_234_567_890_987_654_321, topic
        assert message.header.frame_id == "camera_depth_optical_frame", topic
    (prediction,) = said["touch"].predictions
    assert stamp_ns(prediction.header.stamp) == 1_234_567_890_987_654_321
    assert prediction.model == "small"
    assert len(prediction.model_sha256) == 64
    assert prediction.grasp.id == said["grasps"].grasps[0].id
    assert math.isnan(prediction.pdc_th.lower)
    assert "late" in prediction.flags  # the stamp is years old


def test_a_fresh_cloud_is_not_late(chain, scene_cloud):
    graph, *_ = chain
    send(chain, cloud_to_msg(scene_cloud()))
    graph.nodes[2].set_parameters([rclpy_parameter("late_after_s", 60.0)])
    said = send(chain, cloud_to_msg(scene_cloud(stamp_ns=graph.probe.get_clock().now().nanoseconds)))
    (prediction,) = said["touch"].predictions
    assert "late" not in prediction.flags
    assert prediction.input_age.sec < 60


def rclpy_parameter(name, value):
    from rclpy.parameter import Parameter

    return Parameter(name, value=value)


def damaged(kind, cloud):
    """A cloud that breaks one rule, as a message."""
    message = cloud_to_msg(cloud)
    if kind == "width":
        message.width += 3
    elif kind == "field":
        message.fields = message.fields[:2]
    elif kind == "frame":
        message.header.frame_id = ""
    elif kind == "no points":
        message = cloud_to_msg(Cloud(np.empty((0, 3), np.float32), frame_id="cam", stamp_ns=7))
    elif kind == "all NaN":
        message = cloud_to_msg(Cloud(np.full((240, 424, 3), np.nan, np.float32), frame_id="cam", stamp_ns=8))
    elif kind == "one place":
        message = cloud_to_msg(Cloud(np.full((5000, 3), 0.7, np.float32), frame_id="cam", stamp_ns=9))
    elif kind == "bare table":
        flat = cloud.xyz.copy()
        rows, columns = np.mgrid[0:240, 0:424].astype(np.float32)
        flat[:] = np.stack([(columns - 212) / 400, (rows - 120) / 400, np.ones_like(rows)], axis=-1)
        message = cloud_to_msg(Cloud(flat, frame_id="cam", stamp_ns=10))
    return message


@pytest.mark.parametrize(
    ("kind", "status", "reason"),
    [
        ("width", Status.BAD_CLOUD, "row_step"),
        ("field", Status.BAD_CLOUD, "z is missing"),
        ("frame", Status.UNKNOWN_FRAME, "frame_id: is empty"),
        ("no points", Status.EMPTY_CLOUD, "holds no point"),
        ("all NaN", Status.EMPTY_CLOUD, "none of 101760 points is finite"),
        ("one place", Status.NO_PLANE, ""),
        ("bare table", Status.NO_OBJECT, "nothing stands"),
    ],
)
def test_a_bad_cloud_is_answered_with_a_name_and_the_next_one_is_served(chain, scene_cloud, kind, status, reason):
    said = send(chain, damaged(kind, scene_cloud()))
    assert said["object_cloud"].width == 0
    for topic, entries in (("objects", "objects"), ("grasps", "grasps"), ("touch", "predictions")):
        assert said[topic].status == status, (topic, said[topic].reason)
        assert reason in said[topic].reason
        assert said[topic].reason
        assert len(getattr(said[topic], entries)) == 0
    assert send(chain, cloud_to_msg(scene_cloud(stamp_ns=99)))["touch"].predictions


def test_all_targets_get_grasps_and_predictions_that_name_them(chain, scene_cloud):
    graph, *_ = chain
    assert graph.nodes[0].set_parameters([rclpy_parameter("target.mode", "all")])[0].successful
    assert graph.nodes[1].set_parameters([rclpy_parameter("grasp.count", 3)])[0].successful
    said = send(chain, cloud_to_msg(scene_cloud(n_objects=3)))
    ids = [one.id for one in said["objects"].objects]
    assert len(ids) == 3
    assert {grasp.object_id for grasp in said["grasps"].grasps} == set(ids)
    assert [p.grasp.id for p in said["touch"].predictions] == [g.id for g in said["grasps"].grasps]
    assert len({grasp.id for grasp in said["grasps"].grasps}) == len(said["grasps"].grasps)


def test_the_limits_of_objects_are_parameters_of_the_grasp_node(chain, scene_cloud):
    graph, *_ = chain
    assert graph.nodes[1].set_parameters([rclpy_parameter("limits.max_extent_m", 0.03)])[0].successful
    said = send(chain, cloud_to_msg(scene_cloud()))
    for topic in ("grasps", "touch"):
        assert said[topic].status == Status.NO_GRASP
        assert "more than max_extent_m 0.03" in said[topic].reason


def test_an_ambiguous_target_is_named(chain, scene_cloud):
    graph, *_ = chain
    far = [rclpy_parameter("target.mode", "point"), rclpy_parameter("target.point", [0.0, 0.0, 9.0])]
    assert graph.nodes[0].set_parameters_atomically(far).successful
    said = send(chain, cloud_to_msg(scene_cloud()))
    assert said["touch"].status == Status.NO_TARGET
    assert "no object within" in said["touch"].reason
    assert len(said["objects"].objects) == 2  # still told, only not chosen


def test_markers_show_objects_contacts_hand_and_electrodes(chain, scene_cloud):
    graph, _, heard = chain
    graph.matched("markers", publishers=2)
    send(chain, cloud_to_msg(scene_cloud()))
    wanted = {"objects", "object_ids", "contacts", "hand", "thumb", "middle_finger"}
    graph.until(lambda: {marker.ns for array in heard["markers"] for marker in array.markers} >= wanted)


def test_markers_that_fail_do_not_answer_a_second_time(chain, scene_cloud, monkeypatch):
    graph, _, heard = chain
    graph.matched("markers", publishers=2)

    def fail(*_, **__):
        raise FloatingPointError("overflow")

    for node, name in (("segmentation", "object_markers"), ("touch_predictor", "touch_markers")):
        monkeypatch.setattr(f"foretouch.ros.nodes.{node}.{name}", fail)
    said = send(chain, cloud_to_msg(scene_cloud()))
    assert said["touch"].status == said["objects"].status == Status.OK
    graph.until(lambda: [n.internal_errors.counts()["markers"] for n in graph.nodes] == [1, 0, 1])
    send(chain, cloud_to_msg(scene_cloud(stamp_ns=99)))
    assert len(heard["touch"]) == len(heard["objects"]) == 2


def test_every_input_is_accounted_for(chain, scene_cloud):
    graph, publisher, _ = chain
    for stamp in range(1, 31):
        publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=stamp)))
    first = graph.nodes[0].statistics
    settled: list[InputSummary] = []  # of one instant: the next cloud may be on its way

    def all_answered() -> bool:
        now = first.summary()
        if now.received > 0 and now.waiting == 0:
            settled.append(now)
        return bool(settled)

    graph.until(all_answered)
    now = settled[0]
    assert now.received == now.used + sum(now.dropped.values())
    assert now.received + now.lost <= 30
