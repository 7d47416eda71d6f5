# SPDX-License-Identifier: Apache-2.0
"""Requests and goals on one target, for tests of the touch predictor."""

import numpy as np
from geometry_msgs.msg import Quaternion

from foretouch.grasp import GeoGraspConfig
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, plane_to_msg
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.srv import PredictTouch


def a_target(scene_cloud):
    """One object of a scene, on which nine pairs rank, or more."""
    return Pipeline().segment(scene_cloud(n_objects=3, width=848)).targets[0]


def many_grasps(target):
    return Pipeline(PipelineConfig(grasp=GeoGraspConfig(count=10))).plan(target).grasps


class Planner:
    """Requests and goals on one target, for a predictor with these parameters."""

    def __init__(self, graph, target, grasps, **parameters):
        (self.node,) = graph.add("touch_predictor", **parameters)
        self.graph, self.target, self.grasps, self.feedback = graph, target, grasps, []

    def request(self, count=1):
        messages, table = [grasp_to_msg(grasp) for grasp in self.grasps[:count]], [plane_to_msg(self.target.plane)]
        return PredictTouch.Request(cloud=objects_to_msg([self.target], "cam", 5), grasps=messages, table=table)

    def ask(self, request=None, field="touch"):
        return getattr(self.graph.call(PredictTouch, "predict_touch", request or self.request()), field)

    def goal(self, **fields):
        table = [plane_to_msg(self.target.plane)]
        return SampleGrasps.Goal(cloud=objects_to_msg([self.target], "cam", 5), table=table, count=5, **fields)

    def sample(self, goal=None):
        _, result, self.feedback = self.graph.goal(SampleGrasps, "sample_grasps", goal or self.goal())
        return result


def oriented(message, orientation):
    """The message with this orientation alone."""
    message.rotation, message.pose.orientation = np.zeros(9), orientation
    return message


def without_orientation(message):
    return oriented(message, Quaternion(w=0.0))
