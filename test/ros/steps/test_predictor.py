# SPDX-License-Identifier: Apache-2.0
"""Requests and planned grasps are answered as in Python: the same refusals, flags and numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from seen_solids import Camera, box
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

import foretouch as ft
from foretouch.cloud.messages import decode_objects
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.messages.placement import Placement
from foretouch.ros.messages.requests import RefusalError, RequestedGrasps, Targets, requested_targets
from foretouch.ros.steps.predictor import Predictor
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.types import ASSUMED_TABLE
from foretouch.types.scene import Object
from foretouch_msgs.msg import Status

CAMERA, CONFIG = Camera(60.0), TouchSettings()
POINTS = ft.Cloud(CAMERA.see(box(0.05, 0.06, 0.08)).finite)
SEEN = Object.of("1", POINTS, CAMERA.table().towards_camera, flags=("ambiguous_target",))


def placed(header: Header, _frame: str) -> Placement:
    """In the frame of the header, where it is not known what is up."""
    return Placement(header)


def asked_grasps() -> ft.Grasps:
    """Two planned ones, one with the columns of GraspNet, one in the air, one whose contacts are exchanged."""
    one, two = ft.plan(SEEN, count=2)
    x, y, z = one.rotation.T
    up = SEEN.plane.normal * 0.09
    turned = ft.Grasp(one.g1, one.g2, np.column_stack([-x, z, y]))
    return ft.Grasps.of(
        [one, two, turned, ft.Grasp(one.g1 + up, one.g2 + up, one.rotation), ft.Grasp(one.g2, one.g1, one.rotation)]
    )


def test_service_topic_and_python_answer_alike() -> None:
    predictor, grasps = Predictor("default"), asked_grasps()
    assert predictor.model is not None
    expected = predictor.model.predict(SEEN, grasps)
    assert expected.status.tolist() == ["ok", "ok", "bad_grasp", "ok", "bad_grasp"]
    assert ["off_object" in flags for flags in expected.flags] == [False, False, False, True, False]
    header = objects_to_msg([SEEN], "cam", 0).header
    targets = Targets(header, (SEEN,))
    arrays = SimpleNamespace(
        contacts=np.hstack([grasps.g1, grasps.g2]).ravel(),
        rotations=grasps.rotation.ravel(),
        grasps=[],
        id="",
        object_id="",
    )
    found = {
        "messages": predictor.answer(targets, RequestedGrasps.of_messages([grasp_to_msg(g) for g in grasps]), CONFIG),
        "arrays": predictor.answer(targets, RequestedGrasps.of_arrays(arrays), CONFIG),
    }
    rows = {name: answer.predictions for name, answer in found.items()}
    for name, answer in (rows | {"topic": predictor.predict(SEEN, grasps, CONFIG)}).items():
        assert answer.status.tolist() == expected.status.tolist(), name
        assert answer.reason.tolist() == expected.reason.tolist(), name
        assert answer.flags.tolist() == expected.flags.tolist(), name
        np.testing.assert_array_equal(answer.value, expected.value)


def test_a_request_about_the_latest_cloud_says_why_that_has_no_object() -> None:
    header = objects_to_msg([SEEN], "cam", 0).header
    latest = Targets(header, (), RefusalError(Status.NO_PLANE, "no plane within 5 m"))
    for table in ([], [SimpleNamespace(coef=SEEN.plane.coefficients)]):
        with pytest.raises(RefusalError, match="no plane within 5 m") as refused:
            requested_targets(
                SimpleNamespace(cloud=PointCloud2(header=header), table=table), latest, CONFIG.limits, placed
            )
        assert refused.value.status == Status.NO_PLANE


def test_a_request_without_a_table_is_flagged_and_one_with_it_is_not() -> None:
    cloud = objects_to_msg([SEEN], "cam", 0)
    predictor, grasps = Predictor("default"), RequestedGrasps.of_messages([grasp_to_msg(ft.plan(SEEN)[0])])
    flags = {}
    plane = SimpleNamespace(coef=SEEN.plane.coefficients)
    for name, table in (("without", []), ("with", [plane])):
        targets = requested_targets(SimpleNamespace(cloud=cloud, table=table), None, CONFIG.limits, placed)
        (flags[name],) = predictor.answer(targets, grasps, CONFIG).predictions.flags
    assert "assumed_table" in flags["without"]
    assert "assumed_table" not in flags["with"]
    (alone,) = decode_objects(cloud, ASSUMED_TABLE)
    assert alone.plane.assumed
