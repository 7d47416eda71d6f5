# SPDX-License-Identifier: Apache-2.0
"""A static hand-eye calibration: the pose of the camera's frame in a frame of the robot, from a YAML file.

The file is of the form of `HandEye`, or one that easy_handeye2 has written::

    translation: [0.45, 0.0, 0.80]                # m
    rotation: [0.7071068, 0.7071068, 0.0, 0.0]    # x, y, z, w
    frame_id: base_link
    child_frame_id: camera_depth_optical_frame
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from foretouch.config import Settings, load_yaml, setting
from foretouch.dataset.messages import rotation_from_quaternion
from foretouch.errors import ConfigError, GraspError, shown
from foretouch.ros.messages.frames import FrameTransform

_ROBOT_FRAMES = {"eye_on_base": "robot_base_frame", "eye_in_hand": "robot_effector_frame"}  # by calibration_type


@dataclass(frozen=True, kw_only=True)
class HandEye(Settings):
    """The keys of the file."""

    translation: tuple[float, ...] = setting(
        (), "x, y, z of the camera's frame in the robot's", unit="m", minimum=-100.0, maximum=100.0
    )
    rotation: tuple[float, ...] = setting((), "Its orientation, a quaternion x, y, z, w of unit length")
    frame_id: str = setting("", "The robot's frame, which must be that of the answers; any if empty")
    child_frame_id: str = setting("", "The camera's frame, which must be that of the clouds; any if empty")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, count in (("translation", 3), ("rotation", 4)):
            if len(getattr(self, name)) != count:
                raise ConfigError(f"HandEye.{name}: {list(getattr(self, name))} is not {count} numbers")
        try:
            rotation_from_quaternion(np.array(self.rotation))
        except GraspError as err:
            raise ConfigError(f"HandEye.rotation: {str(err).removeprefix('orientation: ')}") from err

    def transform(self) -> FrameTransform:
        """From the camera's frame to the robot's."""
        rotation = rotation_from_quaternion(np.array(self.rotation))
        return FrameTransform(self.frame_id, self.child_frame_id, rotation, np.array(self.translation))


def read_hand_eye(path: str) -> FrameTransform:
    """The transform from the camera's frame to the robot's; a frame that the file does not name is "".

    Raises:
        ConfigError: Names the file, the field, its value and the rule.
    """
    document = load_yaml(path)
    if "transform" in document:
        document = _from_easy_handeye(document, path)
    return HandEye.from_mapping(document, path).transform()


def _from_easy_handeye(document: Mapping[str, Any], path: str) -> dict[str, Any]:
    """The keys of `HandEye`, from a calibration of easy_handeye2."""
    try:
        parameters, transform = document["parameters"], document["transform"]
        return {
            "translation": [transform["translation"][axis] for axis in "xyz"],
            "rotation": [transform["rotation"][axis] for axis in "xyzw"],
            "frame_id": parameters[_ROBOT_FRAMES[parameters["calibration_type"]]],
            "child_frame_id": parameters["tracking_base_frame"],
        }
    except (KeyError, TypeError) as err:
        fault = f"there is no {err}" if isinstance(err, KeyError) else str(err)
        raise ConfigError(f"{shown(path)}: is not a calibration of easy_handeye2: {fault}") from err
