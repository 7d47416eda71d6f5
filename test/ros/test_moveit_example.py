# SPDX-License-Identifier: Apache-2.0
"""`examples/moveit_grasp.py`: its poses, and goals with the fields of moveit_msgs, which cannot be installed from PyPI."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3, Vector3Stamped
from seen_solids import Camera, box
from std_msgs.msg import Header

from foretouch.grasp import GeoGraspConfig, HandConfig, plan_grasps
from foretouch.ros.messages.conversions import grasp_to_msg

EXAMPLE = Path(__file__).parents[2] / "examples" / "moveit_grasp.py"
FIELDS = {  # of moveit_msgs 2.6, those with a part here and all that are named like them
    "BoundingVolume": "primitives primitive_poses meshes mesh_poses",
    "Constraints": "name joint_constraints position_constraints orientation_constraints visibility_constraints",
    "MotionPlanRequest": "workspace_parameters start_state goal_constraints path_constraints trajectory_constraints "
    "reference_trajectories pipeline_id planner_id group_name num_planning_attempts allowed_planning_time "
    "max_velocity_scaling_factor max_acceleration_scaling_factor cartesian_speed_limited_link max_cartesian_speed",
    "MoveItErrorCodes": "val",
    "OrientationConstraint": "header orientation link_name absolute_x_axis_tolerance absolute_y_axis_tolerance "
    "absolute_z_axis_tolerance parameterization weight",
    "PlanningOptions": "planning_scene_diff plan_only look_around look_around_attempts max_safe_execution_cost replan "
    "replan_attempts replan_delay",
    "PositionConstraint": "header link_name target_point_offset constraint_region weight",
    "Goal": "request planning_options",
    "Grasp": "id pre_grasp_posture grasp_posture grasp_pose grasp_quality pre_grasp_approach post_grasp_retreat "
    "post_place_retreat max_contact_force allowed_touch_objects",
    "GripperTranslation": "direction desired_distance min_distance",
    "JointTrajectory": "header joint_names points",
    "JointTrajectoryPoint": "positions velocities accelerations effort time_from_start",
}


def message_class(name: str) -> type:
    """A class that takes the fields of a message by name, and no others."""

    def fill(self, **fields):
        assert set(fields) <= set(FIELDS[name].split()), (name, sorted(fields))
        self.__dict__.update(fields)

    return type(name, (), {"__init__": fill, "SUCCESS": 1})


@pytest.fixture
def example(monkeypatch):
    package, msg, action = (ModuleType(f"moveit_msgs{end}") for end in ("", ".msg", ".action"))
    for name in FIELDS:
        setattr(msg, name, message_class(name))
    action.MoveGroup = type("MoveGroup", (), {"Goal": message_class("Goal")})
    for module in (package, msg, action):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    spec = importlib.util.spec_from_file_location("moveit_grasp", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_hand_comes_along_its_approach_and_lifts_off_the_table(example):
    camera = Camera(50.0)
    cloud, table = camera.see(box(0.05, 0.08, 0.1)), camera.table()
    (grasp,) = plan_grasps(cloud, table, GeoGraspConfig(), hand=HandConfig(name="franka_hand")).grasps
    up = table.normal / np.linalg.norm(table.normal)
    before, at, after = example.poses_of(grasp_to_msg(grasp), up)
    places = np.array([[one.position.x, one.position.y, one.position.z] for one in (before, at, after)])
    np.testing.assert_allclose(places[1], grasp.way.pose_of_hand[:3, 3], atol=1e-12)
    np.testing.assert_allclose(places[1] - places[0], 0.1 * grasp.way.approach, atol=1e-9)
    heights = [table.height(place) for place in places]
    assert heights[2] - heights[1] == pytest.approx(0.15)
    assert heights[0] > heights[1] + 0.02  # from above
    assert before.orientation == at.orientation == after.orientation
    goal = example.goal_of(PoseStamped(header=Header(frame_id="camera"), pose=at), plan_only=True)
    (wanted,) = goal.request.goal_constraints
    (place,), (turn,) = wanted.position_constraints, wanted.orientation_constraints
    assert place.header.frame_id == turn.header.frame_id == "camera"
    assert place.link_name == turn.link_name == "panda_hand_tcp"
    assert place.constraint_region.primitive_poses[0].position == at.position
    assert turn.orientation == at.orientation
    assert goal.planning_options.plan_only


def test_the_page_fills_the_grasp_of_moveit_with_pose_approach_retreat_and_posture():
    page = (EXAMPLE.parents[1] / "docs" / "planners.md").read_text(encoding="utf-8")
    names = {
        name: message_class(name) for name in ("Grasp", "GripperTranslation", "JointTrajectory", "JointTrajectoryPoint")
    }
    names |= {"Vector3": Vector3, "Vector3Stamped": Vector3Stamped, "PoseStamped": PoseStamped}
    exec(re.search(r"```python\n(def as_moveit_grasp.*?)```", page, re.DOTALL)[1], names)
    camera = Camera(50.0)
    settings = HandConfig(name="shadow_thumb_middle")
    (grasp,) = plan_grasps(camera.see(box(0.05, 0.08, 0.1)), camera.table(), GeoGraspConfig(), hand=settings).grasps
    made = names["as_moveit_grasp"](grasp_to_msg(grasp), Header(frame_id="camera"), 0.8)
    place = made.grasp_pose.pose.position
    np.testing.assert_allclose([place.x, place.y, place.z], grasp.way.pose_of_hand[:3, 3], atol=1e-12)
    there, back = (one.direction.vector for one in (made.pre_grasp_approach, made.post_grasp_retreat))
    np.testing.assert_allclose([there.x, there.y, there.z], grasp.way.approach, atol=1e-12)
    np.testing.assert_allclose([back.x, back.y, back.z], -grasp.way.approach, atol=1e-12)
    assert list(made.grasp_posture.joint_names) == list(grasp.way.joints)
    np.testing.assert_allclose(made.grasp_posture.points[0].positions, grasp.way.posture)
