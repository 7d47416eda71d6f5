# SPDX-License-Identifier: Apache-2.0
"""Results in `output_frame`, over DDS: moved as NumPy moves them, for topics, requests and goals; and what is said where nothing transforms."""

import math

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseArray
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2

from foretouch import reading
from foretouch.pipeline import Pipeline
from foretouch.ros.messages.clouds import cloud_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import plane_to_msg
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, GraspArray, ObjectArray, Status, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros

TURN = Rotation.from_euler("xyz", [math.pi + 0.2, 0.1, 0.7])  # z of the camera down, a little tilted
POSE = np.eye(4)
POSE[:3, :3], POSE[:3, 3] = TURN.as_matrix(), (0.5, -0.2, 1.4)
SEVEN = [*POSE[:3, 3], *TURN.as_quat()]


def at(point):
    """A point of the camera in the base."""
    return POSE[:3, :3] @ [point.x, point.y, point.z] + POSE[:3, 3]


def xyz(point):
    return [point.x, point.y, point.z]


def turn(orientation):
    return Rotation.from_quat([orientation.x, orientation.y, orientation.z, orientation.w]).as_matrix()


def same_grasp(moved, grasp):
    for name in ("g1", "g2"):
        assert_allclose(xyz(getattr(moved, name)), at(getattr(grasp, name)), atol=1e-12)
    rotation = POSE[:3, :3] @ np.reshape(grasp.rotation, (3, 3))
    assert_allclose(np.reshape(moved.rotation, (3, 3)), rotation, atol=1e-12)
    assert_allclose(xyz(moved.pose.position), at(grasp.pose.position), atol=1e-12)
    assert_allclose(turn(moved.pose.orientation), rotation, atol=1e-9)
    assert_allclose(xyz(moved.pose_of_hand.position), at(grasp.pose_of_hand.position), atol=1e-12)
    assert_allclose(
        turn(moved.pose_of_hand.orientation), POSE[:3, :3] @ turn(grasp.pose_of_hand.orientation), atol=1e-9
    )
    assert_allclose(xyz(moved.approach), POSE[:3, :3] @ xyz(grasp.approach), atol=1e-12)
    assert (moved.id, moved.score, moved.depth_m, moved.thumb_at) == (
        grasp.id,
        grasp.score,
        grasp.depth_m,
        grasp.thumb_at,
    )


def test_a_pose_that_is_none_and_a_frame_that_nothing_knows_are_refused_by_name(graph, scene_cloud):
    for settings, reason in (
        ({"camera_pose": SEVEN}, "camera_pose: is a pose in output_frame, which is empty"),
        ({"output_frame": "b", "camera_pose": [1.0]}, "camera_pose: [1.0] is not x, y, z and a quaternion x, y, z, w"),
        ({"output_frame": "b", "camera_pose": [0.0] * 7}, "camera_pose: orientation: length 0"),
    ):
        with pytest.raises(Exception, match=reason.replace("[", r"\[").replace("]", r"\]")):
            graph.add("perception", **settings)
    try:
        import tf2_ros  # noqa: F401
    except ImportError:
        (node,) = graph.add("perception", output_frame="base_link")
        assert node.failure.startswith("output_frame: base_link: tf2_ros is not installed; install")


@pytest.mark.slow
def test_tf_is_asked_at_the_stamp_of_the_cloud_and_what_it_lacks_is_told(graph, scene_cloud, model_card):
    tf2_ros = pytest.importorskip("tf2_ros", reason="tf2_ros comes with a full ROS 2")
    from geometry_msgs.msg import Transform, TransformStamped, Vector3

    from foretouch.ros.messages.conversions import header_to_msg, rotation_to_msg

    graph.add("perception", model=model_card, output_frame="base_link")
    heard, grasps = graph.listen(TouchPredictionArray, "touch"), graph.listen(GraspArray, "grasps")
    talk = graph.talk_matched(PointCloud2, "points")
    frame = scene_cloud().frame_id

    def send(stamp_s):
        talk.publish(cloud_to_msg(scene_cloud(stamp_ns=stamp_s * 10**9)))
        graph.until(lambda: heard and heard[-1].header.stamp.sec == stamp_s)
        return heard[-1]

    graph.matched("touch", "grasps")
    answer = send(100)
    assert answer.status == Status.UNKNOWN_FRAME
    assert answer.reason.startswith(f"no_transform: from '{frame}' to 'base_link' at the stamp of the cloud: ")
    broadcaster = tf2_ros.TransformBroadcaster(graph.probe)
    graph.matched("/tf")
    turned = rotation_to_msg(POSE[:3, :3])
    for stamp_s, shift in ((200, 0.0), (202, 2.0)):  # a camera that moves by 1 m/s
        x, y, z = POSE[:3, 3] + np.array([shift, 0.0, 0.0])
        moved = Transform(translation=Vector3(x=x, y=y, z=z), rotation=turned)
        header = header_to_msg("base_link", stamp_s * 10**9)
        broadcaster.sendTransform(TransformStamped(header=header, child_frame_id=frame, transform=moved))
    graph.until(lambda: send(201).status == Status.OK)
    (one,) = (one for one in grasps if one.header.stamp.sec == 201 and one.grasps)
    g1 = at(one.grasps[0].g1) + np.array([1.0, 0.0, 0.0])
    assert_allclose(xyz(heard[-1].predictions[0].grasp.g1), g1, atol=1e-6)
    late = send(203)
    assert (late.status, "extrapolation into the future" in late.reason) == (Status.UNKNOWN_FRAME, True)
    targets = Pipeline().segment(scene_cloud(stamp_ns=203 * 10**9)).targets
    own = objects_to_msg(targets, frame, 203 * 10**9)  # of a cloud for which nothing is known
    answer = ask(graph, cloud=own, grasps=one.grasps[:1]).touch
    assert (answer.status, answer.header) == (Status.OK, own.header)


# From here on one graph runs, for all tests.


@pytest.fixture(scope="module")
def based(module_graph, scene_cloud, model_card):
    """What perception publishes for one cloud, by topic, with a camera whose pose in base_link is a parameter."""
    kinds = {
        "touch": TouchPredictionArray,
        "grasps": GraspArray,
        "grasp_poses": PoseArray,
        "objects": ObjectArray,
        "table": TablePlane,
        "object_cloud": PointCloud2,
    }
    settings = {
        "output_frame": "base_link",
        "camera_pose": SEVEN,
        "hand.name": "shadow_thumb_middle",
        "grasp__count": 3,
    }
    module_graph.add("perception", model=model_card, **settings)
    heard = {topic: module_graph.listen(kind, topic) for topic, kind in kinds.items()}
    points = module_graph.talk_matched(PointCloud2, "points")
    module_graph.matched(*kinds)
    points.publish(cloud_to_msg(scene_cloud(n_objects=3, width=848, stamp_ns=77)))
    module_graph.until(lambda: all(heard.values()))
    return {topic: messages[-1] for topic, messages in heard.items()}


def ask(graph, **fields):
    return graph.call(PredictTouch, "predict_touch", PredictTouch.Request(**fields))


def test_results_are_moved_and_what_the_steps_exchange_stays_in_the_frame_of_the_cloud(based):
    camera = based["object_cloud"].header.frame_id
    frames = {topic: message.header.frame_id for topic, message in based.items()}
    assert frames == dict.fromkeys(("touch", "grasp_poses", "objects"), "base_link") | dict.fromkeys(
        ("grasps", "table", "object_cloud"), camera
    )
    assert {message.header.stamp.nanosec for message in based.values()} == {77}
    planned = based["grasps"].grasps
    assert len(planned) == 3
    for prediction, pose, grasp in zip(based["touch"].predictions, based["grasp_poses"].poses, planned, strict=True):
        assert prediction.header.frame_id == "base_link"
        same_grasp(prediction.grasp, grasp)
        assert pose == prediction.grasp.pose_of_hand
    (target,) = (one for one in based["objects"].objects if one.target)
    points = np.frombuffer(based["object_cloud"].data, np.float32).reshape(-1, based["object_cloud"].point_step // 4)
    moved = points[:, :3].astype(np.float64) @ POSE[:3, :3].T + POSE[:3, 3]
    assert_allclose([xyz(target.minimum), xyz(target.maximum)], [moved.min(axis=0), moved.max(axis=0)], atol=1e-6)
    assert_allclose(xyz(target.centroid), moved.mean(axis=0), atol=1e-6)


def test_a_request_is_answered_in_its_own_frame_and_without_one_in_that_of_the_results(module_graph, based):
    planned = based["grasps"].grasps
    moved = [prediction.grasp for prediction in based["touch"].predictions]
    cloud = PointCloud2(header=based["grasps"].header)
    for grasps, header in ((planned, cloud), (moved, PointCloud2())):
        answer = ask(module_graph, cloud=header, grasps=grasps).touch
        assert answer.header.frame_id == (header.header.frame_id or "base_link")
        assert [prediction.status for prediction in answer.predictions] == [Status.OK] * 3
        for prediction, told in zip(answer.predictions, based["touch"].predictions, strict=True):
            assert "unknown_frame" not in prediction.flags
            assert_allclose(reading(prediction)["PDC"].value, reading(told)["PDC"].value, rtol=1e-5)
    contacts = np.array([[*xyz(one.g1), *xyz(one.g2)] for one in moved])
    batch = ask(module_graph, contacts=contacts.ravel()).batch
    assert (batch.header.frame_id, batch.status) == ("base_link", Status.OK)
    here = ask(
        module_graph, cloud=cloud, contacts=np.array([[*xyz(one.g1), *xyz(one.g2)] for one in planned]).ravel()
    ).batch
    rotations = POSE[:3, :3] @ np.reshape(here.rotations, (3, 3, 3))
    assert_allclose(np.reshape(batch.rotations, (3, 3, 3)), rotations, atol=1e-9)
    (typed,) = ask(module_graph, grasps=[Grasp(g1=moved[0].g1, g2=moved[0].g2)]).touch.predictions
    assert_allclose(np.reshape(typed.grasp.rotation, (3, 3)), rotations[0], atol=1e-9)
    plane = plane_to_msg(None)
    plane.coef = [0.0, 0.0, 1.0, 5.0]  # five metres below the base
    refused = ask(module_graph, contacts=contacts.ravel(), table=[plane]).batch
    assert (refused.status, "table" in refused.reason) == (Status.BAD_PLANE, True)


def test_goals_are_answered_in_the_frame_of_the_results(module_graph, based):
    status, result, feedback = module_graph.goal(
        SampleGrasps, "sample_grasps", SampleGrasps.Goal(count=3, cost="score")
    )
    assert (status, len(result.grasps)) == (GoalStatus.STATUS_SUCCEEDED, 3)
    planned = {grasp.id: grasp for grasp in based["grasps"].grasps}
    for part in (result, feedback[-1]):
        for pose, grasp in zip(part.grasp_candidates, part.grasps, strict=True):
            assert (pose.header.frame_id, pose.pose) == ("base_link", grasp.pose_of_hand)
            assert_allclose(xyz(grasp.g1), at(planned[grasp.id.rpartition("/")[0]].g1), atol=1e-9)
    assert {prediction.header.frame_id for prediction in result.predictions} == {"base_link"}


def test_an_object_that_is_sent_without_a_table_stands_on_a_level_one(module_graph, based):
    camera = based["object_cloud"]
    contacts = np.array([[*xyz(one.g1), *xyz(one.g2)] for one in based["grasps"].grasps]).ravel()
    batch = ask(module_graph, cloud=camera, contacts=contacts).batch
    assert (batch.status, batch.header.frame_id) == (Status.OK, camera.header.frame_id)
    points = np.frombuffer(camera.data, np.float32).reshape(-1, camera.point_step // 4)[:, :3].astype(np.float64)
    up = POSE[2, :3]  # z of the base in the frame of the camera
    level = plane_to_msg(None)
    level.coef = [*up, -(points @ up).min()]
    given = ask(module_graph, cloud=camera, contacts=contacts, table=[level]).batch
    assert_allclose(batch.rotations, given.rotations, atol=1e-9)
    assert_allclose(batch.scalars, given.scalars, rtol=1e-5)
