# SPDX-License-Identifier: Apache-2.0
"""The parts of a `foretouch_msgs/GraspSample`: our types to the fields of messages, and back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from foretouch.cloud.io.pointcloud2 import encode
from foretouch.dataset.messages import decode_cloud as cloud_of
from foretouch.dataset.messages import decode_grasp
from foretouch.dataset.recording.record import TouchSeries
from foretouch.errors import DatasetError
from foretouch.grasp.pose import quaternion_xyzw
from foretouch.types import TOUCH_SIZE, Cloud, Grasp, Touch

__all__ = [
    "cloud_fields",
    "cloud_of",
    "grasp_fields",
    "grasp_of",
    "header_fields",
    "require_finite",
    "series_of",
    "stamp_ns_of",
    "touch_fields",
    "touch_of",
]

_NS: Final = 1_000_000_000
_STAMP_END_NS: Final = 2**31 * _NS
_TOUCH: Final = ("pdc_th", "pdc_mf", "e_th", "e_mf")
_FINITE: Final = (*_TOUCH, *(f"tare_{name}" for name in _TOUCH), "series", "others", "extra_values")


def header_fields(stamp_ns: int, frame_id: str, name: str) -> SimpleNamespace:
    """A header; refuses stamps that ROS cannot hold.

    Args:
        stamp_ns: [ns] since 1970.
        frame_id: Of it.
        name: What the stamp is of, for the message.

    Raises:
        DatasetError: If the stamp is before 1970 or after 2038.
    """
    if not 0 <= stamp_ns < _STAMP_END_NS:
        raise DatasetError(f"{name}: {stamp_ns} is before 1970 or after 2038, where the stamps of ROS end")
    seconds, nanoseconds = divmod(int(stamp_ns), _NS)
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def stamp_ns_of(header: Any) -> int:
    """The stamp of a header [ns]."""
    return int(header.stamp.sec) * _NS + int(header.stamp.nanosec)


def cloud_fields(cloud: Cloud) -> SimpleNamespace:
    """A cloud as `sensor_msgs/PointCloud2`."""
    layout, data = encode(cloud)
    return SimpleNamespace(
        header=header_fields(cloud.stamp_ns, cloud.frame_id, "cloud.stamp_ns"),
        height=layout.height,
        width=layout.width,
        fields=[
            SimpleNamespace(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count) for f in layout.fields
        ],
        is_bigendian=layout.is_bigendian,
        point_step=layout.point_step,
        row_step=layout.row_step,
        data=np.frombuffer(data, np.uint8),
        is_dense=layout.is_dense,
    )


def grasp_fields(grasp: Grasp) -> SimpleNamespace:
    """A grasp as `foretouch_msgs/Grasp`."""
    x, y, z, w = map(float, quaternion_xyzw(grasp.rotation))
    return SimpleNamespace(
        id=grasp.id,
        object_id=grasp.object_id,
        g1=_point(grasp.g1),
        g2=_point(grasp.g2),
        pose=SimpleNamespace(position=_point(grasp.midpoint), orientation=SimpleNamespace(x=x, y=y, z=z, w=w)),
        rotation=np.ascontiguousarray(grasp.rotation.reshape(9), np.float64),
        score=float(grasp.score),
        status=0,
        reason="",
    )


def grasp_of(message: Any, score: float) -> Grasp:
    """The grasp in a `foretouch_msgs/Grasp`.

    Raises:
        GraspError: If its numbers are no grasp.
    """
    return decode_grasp(message, np.asarray(message.rotation, np.float64).reshape(3, 3), score)


def _point(position: Any) -> SimpleNamespace:
    x, y, z = map(float, position)
    return SimpleNamespace(x=x, y=y, z=z)


def touch_fields(touch: Touch | None, flag: str, prefix: str) -> dict[str, Any]:
    """A touch by field, zeros where there is none.

    Args:
        touch: Or None.
        flag: Name of the field that says whether it is there.
        prefix: Of the names of the others.
    """
    vector = np.zeros(TOUCH_SIZE) if touch is None else touch.vector()
    values = Touch.from_vector(vector)
    return {flag: touch is not None, **{f"{prefix}{name}": getattr(values, name) for name in _TOUCH}}


def touch_of(message: Any, flag: str, prefix: str) -> Touch | None:
    """What `touch_fields` was given."""
    if not getattr(message, flag):
        return None
    pdc_th, pdc_mf, e_th, e_mf = (getattr(message, f"{prefix}{name}") for name in _TOUCH)
    return Touch(float(pdc_th), float(pdc_mf), np.asarray(e_th, np.float64), np.asarray(e_mf, np.float64))


def series_of(message: Any) -> TouchSeries | None:
    """The series in a sample, which looks into the message; None where it is empty."""
    length = len(message.series_stamps)
    if length == 0:
        return None
    others = np.asarray(message.others, np.float32).reshape(len(message.other_names), length)
    return TouchSeries(
        stamps_ns=np.asarray(message.series_stamps, np.int64),
        counts=np.asarray(message.series, np.float32).reshape(length, TOUCH_SIZE),
        phases=np.asarray(message.series_phase, np.uint8),
        others=dict(zip(message.other_names, others, strict=True)),
    )


def require_finite(message: SimpleNamespace) -> None:
    """Refuse what is not finite; scores of grasps may be.

    Raises:
        DatasetError: Names sample and field.
    """
    for name in _FINITE:
        if not np.isfinite(getattr(message, name)).all():
            raise DatasetError(f"{message.id}: {name}: holds a value that is not finite")
