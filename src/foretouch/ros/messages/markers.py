# SPDX-License-Identifier: Apache-2.0
"""Markers for RViz: objects, contacts, the hand, and the electrodes coloured by predicted touch. Pure functions.

Every marker has a stable id and a lifetime of one second, so that outdated ones disappear.
"""

import math
from itertools import count

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from foretouch.dataset.messages import decode_grasp
from foretouch.grasp.pose import electrodes_at
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, point_to_msg, reference_text
from foretouch.tactile import ELECTRODES, Ranges
from foretouch.types import Float64, Grasp, GraspSample
from foretouch_msgs.msg import Interval, ObjectArray, Status, TouchPrediction

_CONTACT_M = 0.012  # diameter of a contact's sphere
_AXIS_M = 0.06  # length of the hand's axes
_ELECTRODE_M = 0.003
_TARGET = ColorRGBA(r=0.2, g=0.8, b=0.3, a=0.35)
_OTHER = ColorRGBA(r=0.6, g=0.6, b=0.6, a=0.25)
_WHITE = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
_YELLOW = ColorRGBA(r=1.0, g=0.8, b=0.1, a=1.0)
_CONTACTS = (ColorRGBA(r=1.0, g=0.4, b=0.1, a=1.0), ColorRGBA(r=0.1, g=0.5, b=1.0, a=1.0))
_AXES = (ColorRGBA(r=1.0, a=1.0), ColorRGBA(g=1.0, a=1.0), ColorRGBA(b=1.0, a=1.0))


def object_markers(message: ObjectArray) -> MarkerArray:
    """Draw a translucent box around each object, green for targets, and its id."""
    markers = []
    for number, one in enumerate(message.objects):
        box = _marker(message.header, "objects", number, Marker.CUBE, _TARGET if one.target else _OTHER)
        low, high = (np.array([p.x, p.y, p.z]) for p in (one.minimum, one.maximum))
        box.pose.position = point_to_msg((low + high) / 2.0)
        box.scale = Vector3(**dict(zip("xyz", np.maximum(high - low, 1e-3).tolist(), strict=True)))
        above = Point(x=one.centroid.x, y=one.minimum.y - 0.02, z=one.centroid.z)  # y points down
        text = f"{one.id}: {one.n_points} points"
        markers += [box, _label(message.header, "object_ids", number, above, 0.03, text)]
    return MarkerArray(markers=markers)


def touch_markers(prediction: TouchPrediction, ranges: Ranges, *, thumb_takes_g1: bool = True) -> MarkerArray:
    """Draw contacts, hand frame and the 48 electrodes of one prediction, with its pressures and what it is based on.

    The text is yellow if there is a flag.

    A refused prediction gives no marker. An electrode at the upper end of its range is green, at the lower end red:
    compression lowers the count.
    """
    if prediction.status != Status.OK:
        return MarkerArray()
    grasp = decode_grasp(prediction.grasp)
    header = prediction.header
    ids = count()
    markers = []
    for contact, colour in zip((grasp.g1, grasp.g2), _CONTACTS, strict=True):
        ball = _marker(header, "contacts", next(ids), Marker.SPHERE, colour)
        ball.pose.position = point_to_msg(contact)
        ball.scale = Vector3(x=_CONTACT_M, y=_CONTACT_M, z=_CONTACT_M)
        markers.append(ball)
    for axis, colour in zip(grasp.rotation.T, _AXES, strict=True):
        arrow = _marker(header, "hand", next(ids), Marker.ARROW, colour)
        arrow.points = [point_to_msg(grasp.midpoint), point_to_msg(grasp.midpoint + _AXIS_M * axis)]
        arrow.scale = Vector3(x=0.004, y=0.008, z=0.0)
        markers.append(arrow)
    thumb, finger = (grasp.g1, grasp.g2) if thumb_takes_g1 else (grasp.g2, grasp.g1)
    above = point_to_msg(grasp.midpoint - [0.0, _AXIS_M + 0.02, 0.0])  # y points down
    pressures = f"PDC {_interval_text(prediction.pdc_th)} | {_interval_text(prediction.pdc_mf)}"
    text = "\n".join([f"{pressures} ({reference_text(prediction)})", *prediction.flags])
    markers += [
        _electrodes(header, "thumb", grasp, thumb, prediction.e_th, ranges.of("E_TH")),
        _electrodes(header, "middle_finger", grasp, finger, prediction.e_mf, ranges.of("E_MF")),
        _label(header, "prediction", 0, above, 0.02, text, _YELLOW if prediction.flags else _WHITE),
    ]
    return MarkerArray(markers=markers)


def sample_markers(sample: GraspSample, ranges: Ranges) -> MarkerArray:
    """Draw what a recorded grasp read, as `touch_markers` draws a prediction, until the markers of another replace it.

    A sample without a touch gives no marker.
    """
    if sample.touch is None:
        return MarkerArray()
    intervals = [Interval(value=value, lower=math.nan, upper=math.nan) for value in sample.touch.values.tolist()]
    pdc_th, pdc_mf, *electrodes = intervals
    found = touch_markers(
        TouchPrediction(
            header=header_to_msg(sample.cloud.frame_id, sample.stamp_ns),
            grasp=grasp_to_msg(sample.grasp),
            pdc_th=pdc_th,
            pdc_mf=pdc_mf,
            e_th=electrodes[:ELECTRODES],
            e_mf=electrodes[ELECTRODES:],
        ),
        ranges,
    )
    for one in found.markers:
        one.lifetime = Duration()
    found.markers[-1].text = f"{sample.id}: PDC {pdc_th.value:.0f} | {pdc_mf.value:.0f}"
    return found


def _electrodes(
    header: Header, namespace: str, grasp: Grasp, contact: Float64, values: list[Interval], limits: tuple[float, float]
) -> Marker:
    """Draw 24 spheres."""
    marker = _marker(header, namespace, 0, Marker.SPHERE_LIST, ColorRGBA(a=1.0))
    marker.scale = Vector3(x=_ELECTRODE_M, y=_ELECTRODE_M, z=_ELECTRODE_M)
    placed = electrodes_at(grasp, contact, 0.5 * _ELECTRODE_M)
    counts = np.array([interval.value for interval in values], np.float64)
    marker.points = [point_to_msg(point) for point in placed]
    marker.colors = [_heat(drop) for drop in np.clip((limits[1] - counts) / (limits[1] - limits[0]), 0.0, 1.0)]
    return marker


def _interval_text(interval: Interval) -> str:
    """Value and half width as text, `2779 ± 60`; only the value where the model is not calibrated."""
    if math.isnan(interval.lower):
        return f"{interval.value:.0f}"
    return f"{interval.value:.0f} ± {(interval.upper - interval.lower) / 2.0:.0f}"


def _heat(drop: float) -> ColorRGBA:
    """Colour from green (no drop) over yellow to red (the full range)."""
    return ColorRGBA(r=float(min(1.0, 2.0 * drop)), g=float(min(1.0, 2.0 - 2.0 * drop)), b=0.1, a=1.0)


def _label(
    header: Header, namespace: str, number: int, position: Point, size_m: float, text: str, colour: ColorRGBA = _WHITE
) -> Marker:
    label = _marker(header, namespace, number, Marker.TEXT_VIEW_FACING, colour)
    label.pose.position, label.scale.z, label.text = position, size_m, text
    return label


def _marker(header: Header, namespace: str, number: int, kind: int, colour: ColorRGBA) -> Marker:
    return Marker(
        header=header,
        ns=namespace,
        id=number,
        type=kind,
        action=Marker.ADD,
        pose=Pose(orientation=Quaternion(w=1.0)),
        color=colour,
        lifetime=Duration(sec=1),
    )
