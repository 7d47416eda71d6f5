# SPDX-License-Identifier: Apache-2.0
"""Messages from one frame to another: pure functions of a rigid transform, which leave their arguments as they are."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Plane as PlaneMsg
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.io.pointcloud2 import DATATYPES
from foretouch.errors import GraspError
from foretouch.grasp import quaternion_xyzw
from foretouch.grasp.messages import has_orientation, rotation_from_quaternion
from foretouch.ros.messages.answers import TouchAnswer
from foretouch.ros.messages.requests import GraspArrays, read_cloud
from foretouch.types import Float64
from foretouch_msgs.msg import Grasp, TouchPrediction


@dataclass(frozen=True, eq=False)
class FrameTransform:
    """The rigid transform p_target = rotation @ p_source + translation."""

    target: str  # frame of the results
    source: str  # frame of the arguments
    rotation: Float64  # (3, 3) float64
    translation: Float64  # (3,) float64 [m], the origin of the source in the target

    @classmethod
    def from_quaternion(cls, target: str, source: str, translation: Float64, quaternion_xyzw: Float64) -> Self:
        """From (3,) a translation [m] and (4,) a quaternion; a `GraspError` if its length is not 1 within 1e-3."""
        if not np.isfinite(translation).all():
            raise GraspError(f"translation: {translation.tolist()} is not finite")
        return cls(target, source, rotation_from_quaternion(quaternion_xyzw), translation)

    @cached_property
    def _rows(self) -> list[tuple[list[float], float]]:
        """Rows of the rotation with the translation: for three numbers, plain floats take a tenth of NumPy's time."""
        return list(zip(self.rotation.tolist(), self.translation.tolist(), strict=True))

    @cached_property
    def _quaternion(self) -> list[float]:
        return [float(value) for value in quaternion_xyzw(self.rotation)]

    def inverse(self) -> "FrameTransform":
        """The transform from the target to the source."""
        return FrameTransform(self.source, self.target, self.rotation.T, -self.rotation.T @ self.translation)

    def points(self, points: Float64) -> Float64:
        """Points (..., 3) [m], float64; what is not finite stays so."""
        with np.errstate(over="ignore", invalid="ignore"):
            return points @ self.rotation.T + self.translation

    def header(self, header: Header) -> Header:
        """The header with the frame of the target."""
        return Header(frame_id=self.target, stamp=header.stamp)

    def point(self, point: Point) -> Point:
        """A point [m]."""
        x, y, z = point.x, point.y, point.z
        a, b, c = ((p * x + q * y + r * z) + t for (p, q, r), t in self._rows)
        return Point(x=a, y=b, z=c)

    def pose(self, pose: Pose) -> Pose:
        """A pose; an orientation of four zeros, which stands for none, stays."""
        q = pose.orientation
        (a, b, c, d), (x, y, z, w) = self._quaternion, (q.x, q.y, q.z, q.w)
        return Pose(
            position=self.point(pose.position),
            orientation=Quaternion(  # the Hamilton product
                x=d * x + a * w + b * z - c * y,
                y=d * y + b * w + c * x - a * z,
                z=d * z + c * w + a * y - b * x,
                w=d * w - a * x - b * y - c * z,
            ),
        )

    def grasp(self, grasp: Grasp) -> Grasp:
        """A grasp: its contacts, its pose and its matrix; a matrix of nine zeros, which stands for none, stays."""
        moved = copy(grasp)
        moved.g1, moved.g2, moved.pose = self.point(grasp.g1), self.point(grasp.g2), self.pose(grasp.pose)
        with np.errstate(over="ignore", invalid="ignore"):
            moved.rotation = (self.rotation @ np.asarray(grasp.rotation, np.float64).reshape(3, 3)).reshape(9)
        return moved

    def grasps(self, grasps: Sequence[Grasp] | GraspArrays) -> Sequence[Grasp] | GraspArrays:
        """All grasps of a request."""
        if not isinstance(grasps, GraspArrays):
            return [self.grasp(one) for one in grasps]
        rotations = None if grasps.rotations is None else self.rotation @ grasps.rotations
        return replace(grasps, contacts=self.points(grasps.contacts), rotations=rotations)

    def plane(self, plane: PlaneMsg) -> PlaneMsg:
        """A plane; four zeros, which stand for none, stay."""
        coefficients = np.asarray(plane.coef, np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            normal = self.rotation @ coefficients[:3]
            return PlaneMsg(coef=np.append(normal, coefficients[3] - normal @ self.translation))

    def cloud(self, message: PointCloud2) -> PointCloud2:
        """A cloud; fields besides x, y and z stay.

        Raises:
            RefusalError: BAD_CLOUD, if its sizes do not add up.
        """
        xyz = self.points(read_cloud(message).xyz.astype(np.float64)).reshape(message.height, message.width, 3)
        data = bytearray(message.data)
        order, strides = ">" if message.is_bigendian else "<", (message.row_step, message.point_step)
        fields = {field.name: field for field in reversed(message.fields)}
        for axis, name in enumerate("xyz" if xyz.size else ""):
            kind = order + DATATYPES[fields[name].datatype]
            np.ndarray(xyz.shape[:2], kind, data, fields[name].offset, strides)[...] = xyz[..., axis]
        moved = copy(message)
        moved.header, moved.data = self.header(message.header), bytes(data)
        return moved

    def markers(self, markers: MarkerArray) -> MarkerArray:
        """Markers, whose points are relative to their poses."""
        moved = []
        for marker in markers.markers:
            one = copy(marker)
            one.header, one.pose = self.header(marker.header), self.pose(marker.pose)
            moved.append(one)
        return MarkerArray(markers=moved)

    def answer(self, answer: TouchAnswer, grasps: Sequence[Grasp] | None = None) -> TouchAnswer:
        """Predictions; those of `grasps` that had a pose stay as they were given, in the frame of the target."""
        header = self.header(answer.header)
        if answer.arrays:
            rotations = None if answer.rotations is None else self.rotation @ answer.rotations
            return replace(answer, header=header, rotations=rotations)
        pairs = zip(answer.grasps, grasps or [None] * len(answer.grasps), strict=True)
        moved = [self.grasp(one) if given is None or not has_orientation(given) else given for one, given in pairs]
        return replace(answer, header=header, grasps=moved)

    def _prediction(self, prediction: TouchPrediction) -> TouchPrediction:
        """A prediction with its grasp."""
        moved = copy(prediction)
        moved.header, moved.grasp = self.header(prediction.header), self.grasp(prediction.grasp)
        return moved

    def sampled(self, message: Any) -> Any:
        """A `SampleGrasps.Result` or `SampleGrasps.Feedback`."""
        moved = copy(message)
        moved.grasp_candidates = [copy(one) for one in message.grasp_candidates]
        for one in moved.grasp_candidates:
            one.header, one.pose = self.header(one.header), self.pose(one.pose)
        moved.grasps = [self.grasp(one) for one in message.grasps]
        if hasattr(message, "predictions"):
            moved.predictions = [self._prediction(one) for one in message.predictions]
        return moved
