# SPDX-License-Identifier: Apache-2.0
"""Depth cameras: a RealSense that is connected, recorded, or fed with synthetic frames, on one code path."""

from foretouch.camera.config import FilterConfig, RealSenseConfig, TimeoutConfig
from foretouch.camera.deproject import Deprojector, pinhole_matrix
from foretouch.camera.device import DeviceSource, list_devices
from foretouch.camera.realsense import CameraState, CameraStatus, RealSenseCamera
from foretouch.camera.synthetic import SyntheticCamera, SyntheticFrame

__all__ = [
    "CameraState",
    "CameraStatus",
    "Deprojector",
    "DeviceSource",
    "FilterConfig",
    "RealSenseCamera",
    "RealSenseConfig",
    "SyntheticCamera",
    "SyntheticFrame",
    "TimeoutConfig",
    "list_devices",
    "pinhole_matrix",
]
