# SPDX-License-Identifier: Apache-2.0
"""The action of MoveIt Task Constructor over DDS, with the type of another action; and costs by the rules of the parameter.

The type of MoveIt has three fields of ours: `grasp_state` of the result, `grasp_candidates` and `costs` of the feedback.
"""

import math

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2

from foretouch.pipeline import Pipeline
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import header_to_msg, plane_to_msg
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.steps import sampling
from foretouch.ros.steps.sampling import cost_of, planner_feedback
from foretouch.ros.steps.touch_settings import COSTS
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, GraspArray, Status, TablePlane

pytestmark = pytest.mark.ros

CAMERA = "camera_depth_optical_frame"


def send_latest(graph, node, target):
    """Give the predictor an object and its table, on which it then answers goals."""
    topics = {"object_cloud": PointCloud2, "table": TablePlane, "grasps": GraspArray}
    clouds, tables, grasps = (graph.talk(kind, topic) for topic, kind in topics.items())
    graph.matched(*topics)
    header = header_to_msg(CAMERA, 11)
    tables.publish(TablePlane(header=header, plane=plane_to_msg(target.plane)))
    clouds.publish(objects_to_msg([target], CAMERA, 11))
    grasps.publish(GraspArray(header=header, status=Status.NO_GRASP, reason="none"))
    graph.until(lambda: node.statistics.summary().used == 1)


def test_a_planner_gets_all_grasps_in_one_feedback_of_its_type(graph, model_card, scene_cloud, monkeypatch):
    monkeypatch.setattr(sampling, "PLANNER_TYPE", ("foretouch_msgs", "SampleGrasps"))
    (node,) = graph.add("touch_predictor", model=model_card, max_grasps=5, sample_cost="harder_finger")
    assert "sample_grasp_poses" in node.reported().values
    status, result, feedback = graph.goal(SampleGrasps, "sample_grasp_poses", SampleGrasps.Goal())
    assert (status, feedback) == (GoalStatus.STATUS_ABORTED, [])
    assert result.grasp_state.startswith("empty_cloud: cloud: is empty, and no object_cloud with a table")
    send_latest(graph, node, Pipeline().segment(scene_cloud(n_objects=3, width=848)).targets[0])
    status, result, feedback = graph.goal(SampleGrasps, "sample_grasp_poses", SampleGrasps.Goal())
    assert (status, result.grasp_state, len(feedback)) == (GoalStatus.STATUS_SUCCEEDED, "success", 1)
    _, own, _ = graph.goal(SampleGrasps, "sample_grasps", SampleGrasps.Goal(count=5))
    assert feedback[0].grasp_candidates == own.grasp_candidates
    assert list(feedback[0].costs) == list(own.costs) == sorted(own.costs)
    headers = [(pose.header.frame_id, pose.header.stamp.nanosec) for pose in feedback[0].grasp_candidates]
    assert headers == [(CAMERA, 11)] * 5
    assert not feedback[0].grasps  # no field but those of MoveIt
    for name, reason in (
        ("nothing", "hand.name: nothing: is neither a file nor one of allegro_index_thumb, franka_hand"),
        ("", "hand.name: "),
    ):
        (answer,) = node.set_parameters([Parameter("hand.name", value=name)])
        assert not answer.successful
        assert reason in answer.reason
    assert node.set_parameters([Parameter("hand.name", value="shadow_thumb_middle")])[0].successful  # while it runs
    _, _, feedback = graph.goal(SampleGrasps, "sample_grasp_poses", SampleGrasps.Goal())
    _, own, _ = graph.goal(SampleGrasps, "sample_grasps", SampleGrasps.Goal(count=5))
    assert {grasp.hand for grasp in own.grasps} == {"shadow_thumb_middle"}, own.grasp_state
    poses = [pose.pose for pose in feedback[0].grasp_candidates]
    assert poses == [grasp.pose_of_hand for grasp in own.grasps]
    assert poses != [grasp.pose for grasp in own.grasps]
    assert not node.internal_errors.counts()


def test_costs_by_each_rule_and_grasps_without_a_finite_one_are_left_out():
    poses = [PoseStamped() for _ in range(3)]
    for number, pose in enumerate(poses):
        pose.pose.position.x = float(number)
    result = SampleGrasps.Result(costs=[1.0, math.inf, math.inf], grasp_candidates=poses)
    found = planner_feedback(SampleGrasps, result)
    assert (list(found.costs), found.grasp_candidates) == ([1.0], poses[:1])
    result.costs = [math.inf] * 3
    with pytest.raises(RefusalError, match="no grasp has a finite cost"):
        planner_feedback(SampleGrasps, result)
    costs = {rule: cost_of(rule, Grasp(score=4.0), np.array([0.25, 0.75])) for rule in COSTS}
    assert costs == {"pressure": 0.5, "harder_finger": 0.75, "score": -4.0}
    assert np.isposinf([cost_of(rule, Grasp(score=math.nan), np.full(2, np.nan)) for rule in COSTS]).all()


def test_a_package_that_cannot_be_loaded_is_told_from_one_that_is_absent(monkeypatch):
    monkeypatch.setattr(sampling, "PLANNER_TYPE", ("no_such_msgs", "SampleGraspPoses"))
    assert sampling.planner_action_class() == (None, "")
    monkeypatch.setattr(sampling, "PLANNER_TYPE", ("foretouch_msgs", "Absent"))
    kind, fault = sampling.planner_action_class()
    assert kind is None
    assert "sample_grasp_poses: not offered: foretouch_msgs/Absent" in fault
    assert "AttributeError" in fault
    monkeypatch.setattr(sampling, "PLANNER_TYPE", ("foretouch_msgs", "SampleGrasps"))
    assert sampling.planner_action_class() == (SampleGrasps, "")
