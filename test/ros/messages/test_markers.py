# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from answer_builders import refusal
from constant_models import sensor_with_dead
from seen_solids import Camera
from seen_solids import box as solid_box
from std_msgs.msg import Header

from foretouch.grasp import GeoGraspConfig, HandConfig, plan_grasps
from foretouch.grasp.pose import fingertip_rotation
from foretouch.pipeline import Pipeline
from foretouch.ros.messages.clouds import object_to_msg
from foretouch.ros.messages.markers import object_markers, touch_markers
from foretouch.ros.messages.placement import Placement
from foretouch.tactile import P2_RANGES, Ranges, biotac_touch
from foretouch.tactile.description import packaged_sensor
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Grasp, Prediction, Touch
from foretouch.types.scene import Object
from foretouch_msgs.msg import ObjectArray, TablePlane

BIOTAC_VIEW = TaxelView(packaged_sensor("biotac_sp"))
HEADER = Header(frame_id="cam")
# Contacts left and right of the view, object axis up: Z = +x, X = Z x axis, Y completes it.
GRASP = Grasp(np.array([0.04, 0.0, 0.8]), np.array([-0.04, 0.0, 0.8]), np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0.0]]))


def drawn(e_th, e_mf, **options):
    """Markers of a prediction by their namespace."""
    touch = biotac_touch(np.hstack([2800.0, 1800.0, np.asarray(e_th, float), np.asarray(e_mf, float)]))
    return by_name(touch_markers(Prediction.of(GRASP, touch), HEADER, BIOTAC_VIEW, P2_RANGES.ranges, **options))


def by_name(array):
    found = {}
    for marker in array.markers:
        found.setdefault(marker.ns, []).append(marker)
    return found


def points(marker):
    return np.array([[p.x, p.y, p.z] for p in marker.points])


def test_fingertips_are_rotations_whose_pads_face_each_other_in_a_closed_or_turned_hand_too():
    turned = [
        Grasp(np.array([0.0, 0.0, width_m]), np.zeros(3), np.eye(3)[:, list(order)])
        for width_m in (5e-324, 1e-200, 1e-13, 0.05)
        for order in ((0, 1, 2), (2, 0, 1))  # the hand's Z, or its X, along the contacts
    ]
    for grasp in (GRASP, *turned):
        first, second = (fingertip_rotation(grasp, contact) for contact in (grasp.g1, grasp.g2))
        for rotation in (first, second):
            np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
            assert np.linalg.det(rotation) == pytest.approx(1.0)
        np.testing.assert_allclose(first[:, 2], -second[:, 2], atol=1e-12)
    for contact in (GRASP.g1, GRASP.g2):
        rotation, inward = fingertip_rotation(GRASP, contact), GRASP.midpoint - contact
        np.testing.assert_allclose(-rotation[:, 2], inward / np.linalg.norm(inward), atol=1e-12)
        assert rotation[:, 0] @ GRASP.midpoint > 0.0  # the tip points away from the camera


def test_the_boxes_of_the_hand_are_at_the_contacts():
    solid = solid_box(0.05, 0.08, 0.1)
    cloud, table = Camera(50.0).see(solid), Camera(50.0).table()
    (grasp,) = plan_grasps(cloud, table, GeoGraspConfig(), hand=HandConfig(name="franka_hand")).grasps
    touch = biotac_touch(np.full(50, 2800.0))
    boxes = by_name(touch_markers(Prediction.of(grasp, touch), HEADER, BIOTAC_VIEW, P2_RANGES.ranges))["hand_boxes"]
    assert [len(marker.points) for marker in boxes] == [2 * 24, 24, 2 * 24]  # finger, palm, thumb: 12 edges a box
    thumb = grasp.g1 if grasp.way.thumb_at == "g1" else grasp.g2
    outward = (thumb - grasp.midpoint) / np.linalg.norm(thumb - grasp.midpoint)
    inner = ((points(boxes[2]) - grasp.midpoint) @ outward).min()
    assert inner == pytest.approx(grasp.width_m / 2.0, abs=1e-9)
    palm = (points(boxes[1]) - grasp.midpoint) @ grasp.way.approach
    assert palm.max() == pytest.approx(-0.046, abs=1e-9)
    assert "hand_boxes" not in drawn(np.ones(24), np.ones(24))


def test_electrodes_contacts_and_hand_axes_are_where_the_grasp_is_and_thumb_takes_g1():
    markers = drawn(np.full(24, 3000.0), np.full(24, 3000.0))
    thumb, finger = points(markers["thumb"][0]), points(markers["middle_finger"][0])
    assert thumb.shape == finger.shape == (24, 3)
    assert (thumb[:, 0] >= 0.04 - 1e-9).all()
    assert (finger[:, 0] <= -0.04 + 1e-9).all()
    assert np.linalg.norm(thumb - GRASP.g1, axis=1).max() < 0.02
    assert (points(drawn(np.ones(24), np.ones(24), thumb_takes_g1=False)["thumb"][0])[:, 0] < 0.0).all()
    low, high = P2_RANGES.ranges.of("E_TH")  # a drop is red and none is green
    counts = np.full(24, high)
    counts[5], counts[6] = low, (low + high) / 2
    colours = drawn(counts, counts)["thumb"][0].colors
    assert [(colours[k].r, colours[k].g) for k in (0, 5, 6)] == [(0.0, 1.0), (1.0, 0.0), (1.0, 1.0)]
    markers = drawn(np.ones(24), np.ones(24))
    balls = [[m.pose.position.x, m.pose.position.y, m.pose.position.z] for m in markers["contacts"]]
    np.testing.assert_array_equal(balls, [GRASP.g1, GRASP.g2])
    for arrow, axis in zip(markers["hand"], GRASP.rotation.T, strict=True):
        start, end = points(arrow)
        np.testing.assert_allclose(start, GRASP.midpoint)
        np.testing.assert_allclose((end - start) / np.linalg.norm(end - start), axis)
    flat = [marker for group in markers.values() for marker in group]
    assert len({(m.ns, m.id) for m in flat}) == len(flat)
    assert {m.header.frame_id for m in flat} == {"cam"}
    assert not touch_markers(refusal("refused", "")[0], HEADER, BIOTAC_VIEW, P2_RANGES.ranges).markers


def test_a_dead_taxel_is_grey_and_others_are_coloured_by_their_change_from_rest():
    sensor = sensor_with_dead("xela_uskin_4x4", 5)
    view, rest = TaxelView(sensor), Touch(np.full(96, 30_000.0), sensor.channels)
    values = rest.values.copy()
    values[sensor.taxel_columns[0, 3, 2]] += 1000.0  # Z of the first finger
    values[sensor.taxel_columns[1, 7, 2]] -= 500.0
    values[sensor.taxel_columns[1, 8, 0]] += 5000.0  # X is not shown
    ranges = Ranges(sensor.channels, ((29_000.0, 31_000.0),) * len(sensor.channels.modalities))
    found = by_name(touch_markers(Prediction.of(GRASP, Touch(values, sensor.channels)), HEADER, view, ranges, rest))
    thumb, finger = found["thumb"][0], found["FF"][0]
    np.testing.assert_allclose(points(thumb)[:, 0], 0.04, atol=1e-9)  # flat on the contact
    np.testing.assert_allclose(points(finger)[:, 0], -0.04, atol=1e-9)
    np.testing.assert_allclose(np.sort(np.unique(np.round(np.ptp(points(thumb), axis=0), 6))), [0.0, 0.0141])
    green, red, grey = (0.0, 1.0), (1.0, 0.0), (0.5, 0.5)
    assert [(c.r, c.g) for c in thumb.colors] == [red if k == 3 else grey if k == 5 else green for k in range(16)]
    assert [(c.r, c.g) for c in finger.colors] == [(1.0, 1.0) if k == 7 else green for k in range(16)]
    assert found["prediction"][0].text == "(cloud only)"


def test_boxes_enclose_their_objects(scene_cloud):
    found = Pipeline().segment(scene_cloud()).objects
    message = ObjectArray(
        header=HEADER, objects=[object_to_msg(one, Placement(HEADER), target=one.id == "1") for one in found]
    )
    for sent, one in zip(message.objects, found, strict=True):
        assert sent.confidence == np.float32(one.confidence)
    received = Object.of("1", found[0].cloud, found[0].plane)
    assert np.isnan(object_to_msg(received, Placement(HEADER), target=True).confidence)
    outline = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [0.5, 0.5, 1.0]], np.float32)
    table = TablePlane(header=HEADER, outline=outline.ravel())
    markers = by_name(object_markers(message, table))
    np.testing.assert_allclose(points(markers["table"][0]), [*outline, outline[0]])  # closed
    assert "table" not in by_name(object_markers(message, TablePlane(header=HEADER)))
    boxes = markers["objects"]
    for box, one in zip(boxes, found, strict=True):
        centre = np.array([box.pose.position.x, box.pose.position.y, box.pose.position.z])
        half = np.array([box.scale.x, box.scale.y, box.scale.z]) / 2
        assert (np.abs(one.cloud.xyz - centre) <= half + 1e-6).all()
    assert boxes[0].color.g > boxes[0].color.r
