# SPDX-License-Identifier: Apache-2.0
"""The frame that answers are published in, by default that of their cloud.

Its transform comes from tf2, looked up at the stamp of the cloud, or from a static hand-eye calibration, which needs
no tf2. An answer whose transform is missing is refused with a reason that begins with `no_transform`. Requests in that
frame are brought to the frame of the camera, in which touch is predicted.
"""

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Plane as PlaneMsg
from std_msgs.msg import Header

from foretouch.config import Settings, load_yaml, setting
from foretouch.errors import ConfigError, GraspError, MissingDependencyError, shown
from foretouch.ros.messages.clouds import TargetCloud
from foretouch.ros.messages.frames import FrameTransform
from foretouch.ros.messages.requests import GraspArrays, RefusalError
from foretouch_msgs.msg import Grasp, Status, TablePlane

_ROBOT_FRAMES = {"eye_on_base": "robot_base_frame", "eye_in_hand": "robot_effector_frame"}  # by calibration_type


@dataclass(frozen=True, kw_only=True)
class HandEye(Settings):
    """The keys of a file with a static hand-eye calibration, the pose of the camera's frame in a frame of the robot."""

    translation: tuple[float, ...] = setting(
        (), "x, y, z of the camera's frame in the robot's", unit="m", bounds=(-100.0, 100.0)
    )
    rotation: tuple[float, ...] = setting((), "Its orientation, a quaternion x, y, z, w of unit length")
    frame_id: str = setting("", "The robot's frame, which must be that of the answers; any if empty")
    child_frame_id: str = setting("", "The camera's frame, which must be that of the clouds; any if empty")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, count in (("translation", 3), ("rotation", 4)):
            if len(getattr(self, name)) != count:
                raise ConfigError(f"{name}: {list(getattr(self, name))} is not {count} numbers")
        try:
            self.transform()
        except GraspError as err:
            raise ConfigError(f"rotation: {str(err).removeprefix('orientation: ')}") from err

    def transform(self) -> FrameTransform:
        """From the camera's frame to the robot's."""
        return FrameTransform.from_quaternion(
            self.frame_id, self.child_frame_id, np.array(self.translation), np.array(self.rotation)
        )


def read_hand_eye(path: str) -> FrameTransform:
    """The transform from the camera's frame to the robot's; a frame that the file does not name is "".

    The file is of the form of `HandEye`, or one that easy_handeye2 has written::

        translation: [0.45, 0.0, 0.80]                # m
        rotation: [0.7071068, 0.7071068, 0.0, 0.0]    # x, y, z, w
        frame_id: base_link
        child_frame_id: camera_depth_optical_frame

    Raises:
        ConfigError: Names the file, the field, its value and the rule.
    """
    document: Mapping[str, Any] = load_yaml(path)
    if "transform" in document:
        try:
            parameters, transform = document["parameters"], document["transform"]
            document = {
                "translation": [transform["translation"][axis] for axis in "xyz"],
                "rotation": [transform["rotation"][axis] for axis in "xyzw"],
                "frame_id": parameters[_ROBOT_FRAMES[parameters["calibration_type"]]],
                "child_frame_id": parameters["tracking_base_frame"],
            }
        except (KeyError, TypeError) as err:
            fault = f"there is no {err}" if isinstance(err, KeyError) else str(err)
            raise ConfigError(f"{shown(path)}: is not a calibration of easy_handeye2: {fault}") from err
    return HandEye.from_mapping(document, path).transform()


@dataclass(frozen=True, kw_only=True)
class OutputFrameConfig(Settings, read_only=True):
    """Settings of nodes that publish poses."""

    output_frame: str = setting("", "Frame of what is published, such as base_link; that of the cloud if empty")
    hand_eye: str = setting(
        "",
        "File with the pose of the camera in output_frame, of translation (m) and rotation (x, y, z, w), or of "
        "easy_handeye2; tf2 if empty",
    )
    transform_timeout_s: float = setting(0.1, "Longest wait for the transform of a cloud from tf2", bounds=(0.0, 10.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hand_eye and not self.output_frame:
            raise ConfigError(f"hand_eye: {self.hand_eye!r} is given without output_frame")


class Latest(NamedTuple):
    """The newest object_cloud and the table of the same stamp."""

    cloud: PointCloud2 | TargetCloud
    table: TablePlane


class _FramedRequest(NamedTuple):
    """A request in the frame of its cloud."""

    cloud: PointCloud2 | TargetCloud  # of the object
    table: Sequence[PlaneMsg]  # none, or one
    grasps: Sequence[Grasp] | GraspArrays  # on the object
    transform: FrameTransform | None  # of the answer; None if it stays in the frame of the cloud


class OutputFrame:
    """Finds the transform of each cloud. Thread-safe.

    A `ConfigError` if the calibration cannot be used, or a `MissingDependencyError` if tf2 is needed and not installed.
    """

    def __init__(self, node: Node, config: OutputFrameConfig) -> None:
        self.name = config.output_frame  # "" for that of the cloud
        self._timeout = Duration(seconds=config.transform_timeout_s)
        self._calibration = read_hand_eye(config.hand_eye) if config.hand_eye else None
        self._tf2: Any = None
        if self._calibration is not None and self._calibration.target not in {"", self.name}:
            raise ConfigError(
                f"{config.hand_eye}: frame_id: {self._calibration.target!r} is not output_frame, {self.name!r}"
            )
        if self.name and self._calibration is None:
            try:
                self._tf2 = importlib.import_module("tf2_ros")
            except ImportError as err:
                raise MissingDependencyError(
                    f"output_frame: {self.name!r} needs tf2_ros, which is not installed; install it with ROS 2, or give "
                    "a calibration as hand_eye"
                ) from err
            self._buffer = self._tf2.Buffer()
            self._listener = self._tf2.TransformListener(self._buffer, node)

    def close(self) -> None:
        """End the subscriptions of tf2."""
        if self._tf2 is not None:
            self._listener.unregister()

    def notes(self) -> dict[str, str]:
        """The frame and the source of its transform, for /diagnostics; nothing for the frame of the cloud."""
        return {"output_frame": f"{self.name} ({'hand_eye' if self._calibration else 'tf2'})"} if self.name else {}

    def knows(self, frame_id: str, camera: str) -> bool:
        """Whether clouds in a frame can be placed; a calibration that names no frame is for that of the graph's own clouds."""
        return self._calibration is None or bool(self._calibration.source) or frame_id == camera

    def camera_frame(self, latest: str) -> str:
        """The frame of the clouds: that of the latest, else of the calibration; else a `RefusalError`."""
        if latest:
            return latest
        if self._calibration is None:
            raise _refusal("the frame of the camera is not known before the first object_cloud")
        return self._calibration.source or "camera"

    def transform(self, cloud: Header) -> FrameTransform | None:
        """The transform of answers for a cloud, None if they stay in its frame; a `RefusalError` if there is none."""
        if self.name in {"", cloud.frame_id}:
            return None
        if self._calibration is None:
            return self._looked_up(cloud)
        source = self._calibration.source
        if source not in {"", cloud.frame_id}:
            raise _refusal(f"hand_eye is for clouds in {source!r}, not in {cloud.frame_id!r}")
        return replace(self._calibration, target=self.name, source=cloud.frame_id)

    def _looked_up(self, cloud: Header) -> FrameTransform:
        try:
            found = self._buffer.lookup_transform(
                self.name, cloud.frame_id, Time.from_msg(cloud.stamp), timeout=self._timeout
            ).transform
            t, q = found.translation, found.rotation
            pose = np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w])
            return FrameTransform.from_quaternion(self.name, cloud.frame_id, *pose)
        except (self._tf2.TransformException, GraspError) as err:
            raise _refusal(f"from {cloud.frame_id!r} to {self.name!r}: {' '.join(str(err).split())}") from err


def in_cloud_frame(
    frame: OutputFrame,
    cloud: PointCloud2,
    table: Sequence[PlaneMsg],
    grasps: Sequence[Grasp] | GraspArrays,
    latest: Latest | None,
) -> _FramedRequest:
    """Bring a request to the frame of the camera; a `RefusalError`: UNKNOWN_FRAME, or EMPTY_CLOUD without a latest cloud.

    The header of the cloud gives the frame of cloud, table and grasps: the camera's, or `frame`, that of the answers. A
    cloud that is only a header stands for the latest one, with its table.
    """
    header = cloud.header
    if header.frame_id and not cloud.fields:
        return _on_latest(frame, header, table, grasps, latest)
    if not frame.name or header.frame_id != frame.name:
        if latest is not None and not frame.knows(header.frame_id, latest.cloud.header.frame_id):
            raise _refusal(f"hand_eye is for clouds in {latest.cloud.header.frame_id!r}, not in {header.frame_id!r}")
        return _FramedRequest(cloud, table, grasps, frame.transform(header))
    camera = frame.camera_frame("" if latest is None else latest.cloud.header.frame_id)
    transform = frame.transform(Header(frame_id=camera, stamp=header.stamp))
    if transform is None:  # the frame of the answers is the camera's
        return _FramedRequest(cloud, table, grasps, None)
    back = transform.inverse()
    return _FramedRequest(back.cloud(cloud), [*map(back.plane, table)], back.grasps(grasps), transform)


def _on_latest(
    frame: OutputFrame,
    header: Header,
    table: Sequence[PlaneMsg],
    grasps: Sequence[Grasp] | GraspArrays,
    latest: Latest | None,
) -> _FramedRequest:
    if latest is None:
        raise no_latest_cloud()
    camera = latest.cloud.header
    transform = frame.transform(camera)
    if header.frame_id != camera.frame_id:
        if transform is None or header.frame_id != transform.target:
            known = repr(camera.frame_id) + ("" if transform is None else f" or {transform.target!r}")
            raise RefusalError(Status.UNKNOWN_FRAME, f"cloud: frame {header.frame_id!r} of the request is not {known}")
        back = transform.inverse()
        table, grasps = [*map(back.plane, table)], back.grasps(grasps)
    own = [latest.table.plane] if latest.table.status == Status.OK else []
    return _FramedRequest(latest.cloud, table or own, grasps, transform)


def no_latest_cloud() -> RefusalError:
    """The refusal of a request that is about the latest cloud before there is one."""
    return RefusalError(Status.EMPTY_CLOUD, "cloud: is empty, and no object_cloud with a table was received yet")


def _refusal(reason: str) -> RefusalError:
    return RefusalError(Status.UNKNOWN_FRAME, f"no_transform: {reason}")
