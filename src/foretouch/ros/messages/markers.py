# SPDX-License-Identifier: Apache-2.0
"""Markers for RViz: objects, contacts, the hand, and the taxels coloured by predicted touch. Pure functions.

Every marker has a stable id and a lifetime of one second, so that outdated ones disappear.
"""

from itertools import count

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from foretouch.grasp.pose import taxels_at
from foretouch.report.hand_figure import COLOURS, hand_lines
from foretouch.ros.messages.conversions import point_to_msg
from foretouch.tactile import Ranges
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Float64, Grasp, Prediction, Touch
from foretouch.types.predictions import evidence_text
from foretouch_msgs.msg import ObjectArray, TablePlane

_CONTACT_M = 0.012  # diameter of a contact's sphere
_AXIS_M = 0.06  # length of the hand's axes
_TAXEL_M = 0.003
_LINE_M = 0.004  # width of the table's outline
_EDGE_M = 0.0015  # width of the edges of the hand's boxes
_TARGET = ColorRGBA(r=0.2, g=0.8, b=0.3, a=0.35)
_OTHER = ColorRGBA(r=0.6, g=0.6, b=0.6, a=0.25)
_WHITE = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
_YELLOW = ColorRGBA(r=1.0, g=0.8, b=0.1, a=1.0)
_CONTACTS = (ColorRGBA(r=1.0, g=0.4, b=0.1, a=1.0), ColorRGBA(r=0.1, g=0.5, b=1.0, a=1.0))
_DEAD = ColorRGBA(r=0.5, g=0.5, b=0.5, a=0.6)
_AXES = (ColorRGBA(r=1.0, a=1.0), ColorRGBA(g=1.0, a=1.0), ColorRGBA(b=1.0, a=1.0))


def object_markers(message: ObjectArray, table: TablePlane) -> MarkerArray:
    """Draw a translucent box around each object, green for targets, and its id; and the outline of the table.

    Args:
        message: The objects.
        table: Of the same cloud.
    """
    line = _marker(message.header, "table", 0, Marker.LINE_STRIP, _WHITE)
    corners = np.asarray(table.outline, np.float64).reshape(-1, 3)
    line.points, line.scale.x = [point_to_msg(corner) for corner in (*corners, *corners[:1])], _LINE_M
    markers = [line] if len(corners) else []
    for number, object_ in enumerate(message.objects):
        box = _marker(message.header, "objects", number, Marker.CUBE, _TARGET if object_.target else _OTHER)
        low, high = (np.array([p.x, p.y, p.z]) for p in (object_.minimum, object_.maximum))
        box.pose.position = point_to_msg((low + high) / 2.0)
        box.scale = Vector3(**dict(zip("xyz", np.maximum(high - low, 1e-3).tolist(), strict=True)))
        above = Point(x=object_.centroid.x, y=object_.minimum.y - 0.02, z=object_.centroid.z)  # y points down
        text = f"{object_.id}: {object_.n_points} points"
        markers += [box, _label(message.header, "object_ids", number, above, 0.03, text)]
    return MarkerArray(markers=markers)


def touch_markers(
    prediction: Prediction,
    header: Header,
    view: TaxelView,
    ranges: Ranges,
    rest: Touch | None = None,
    *,
    thumb_takes_g1: bool = True,
) -> MarkerArray:
    """Draw contacts, hand frame, the boxes of a described hand and all taxels of one prediction, with its scalars and what it is based on.

    The text is yellow if there is a flag. A refused prediction gives no marker. A taxel that contact has not moved is green, one
    that it has moved by the whole range red (see `TaxelView.shares`), and a dead one grey.

    Args:
        prediction: In the frame of the header.
        header: Of all markers.
        view: Of the sensor.
        ranges: Of the values.
        rest: Reading without contact, if it is known.
        thumb_takes_g1: Whether the first finger of the sensor is drawn at g1, else the second.
    """
    if not prediction.ok:
        return MarkerArray()
    grasp, value = prediction.grasp, prediction.value
    ids = count()
    markers = []
    for contact, colour in zip((grasp.g1, grasp.g2), _CONTACTS, strict=True):
        ball = _marker(header, "contacts", next(ids), Marker.SPHERE, colour)
        ball.pose.position = point_to_msg(contact)
        ball.scale = Vector3(x=_CONTACT_M, y=_CONTACT_M, z=_CONTACT_M)
        markers.append(ball)
    for number, (part, edges) in enumerate(hand_lines(grasp).items()):
        boxes = _marker(header, "hand_boxes", number, Marker.LINE_LIST, ColorRGBA(**_rgb(COLOURS[part]), a=0.9))
        boxes.points, boxes.scale.x = [point_to_msg(point) for point in edges.reshape(-1, 3)], _EDGE_M
        markers.append(boxes)
    for axis, colour in zip(grasp.rotation.T, _AXES, strict=True):
        arrow = _marker(header, "hand", next(ids), Marker.ARROW, colour)
        arrow.points = [point_to_msg(grasp.midpoint), point_to_msg(grasp.midpoint + _AXIS_M * axis)]
        arrow.scale = Vector3(x=0.004, y=0.008, z=0.0)
        markers.append(arrow)
    ends = (grasp.g1, grasp.g2) if thumb_takes_g1 else (grasp.g2, grasp.g1)
    for k, contact in enumerate(ends):
        markers.append(_taxels(header, view, k, grasp, contact, view.shares(value.values, rest, ranges, k)))
    above = point_to_msg(grasp.midpoint - [0.0, _AXIS_M + 0.02, 0.0])  # y points down
    based = evidence_text(prediction.reference, prediction.evidence.touches, prediction.evidence.readings)
    text = "\n".join([f"{_scalars(view, value, prediction)}({based})", *prediction.flags])
    markers.append(_label(header, "prediction", 0, above, 0.02, text, _YELLOW if prediction.flags else _WHITE))
    return MarkerArray(markers=markers)


def _scalars(view: TaxelView, value: Touch, around: Prediction | None = None) -> str:
    """Write the scalars of both fingers, `PDC 2779 ± 60 | 1800 ± 50 `; "" if there are none."""
    texts = [view.scalars(k, value, around) for k in range(len(view.fingers))]
    name = texts[0].partition(" ")[0]
    if len(view.sensor.scalar_channels) == 1:  # the name once
        texts[1:] = [text.removeprefix(f"{name} ") for text in texts[1:]]
    return f"{' | '.join(texts)} " if any(texts) else ""


def _taxels(header: Header, view: TaxelView, finger: int, grasp: Grasp, contact: Float64, shares: Float64) -> Marker:
    """Draw a sphere for each taxel of a finger."""
    marker = _marker(header, view.fingers[finger].replace(" ", "_"), 0, Marker.SPHERE_LIST, ColorRGBA(a=1.0))
    marker.scale = Vector3(x=_TAXEL_M, y=_TAXEL_M, z=_TAXEL_M)
    placed = taxels_at(view.sensor.layout, grasp, contact, 0.5 * _TAXEL_M)
    marker.points = [point_to_msg(point) for point in placed]
    marker.colors = [
        _heat(share) if valid else _DEAD for share, valid in zip(shares, view.sensor.valid[finger], strict=True)
    ]
    return marker


def _heat(share: float) -> ColorRGBA:
    """Colour from green (no change) over yellow to red (the full range)."""
    return ColorRGBA(r=float(min(1.0, 2.0 * share)), g=float(min(1.0, 2.0 - 2.0 * share)), b=0.1, a=1.0)


def _rgb(colour: str) -> dict[str, float]:
    """Red, green and blue of a colour such as `#ff8000`."""
    return {name: int(colour[k : k + 2], 16) / 255.0 for name, k in zip("rgb", (1, 3, 5), strict=True)}


def _label(
    header: Header, namespace: str, number: int, position: Point, size_m: float, text: str, colour: ColorRGBA = _WHITE
) -> Marker:
    label = _marker(header, namespace, number, Marker.TEXT_VIEW_FACING, colour)
    label.pose.position = position
    label.scale.z = size_m
    label.text = text
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
