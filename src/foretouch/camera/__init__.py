# SPDX-License-Identifier: Apache-2.0
"""Depth cameras: a RealSense that is connected, recorded, or fed with synthetic frames, on one code path."""

from foretouch.camera.config import FilterConfig, RealSenseConfig, TimeoutConfig
from foretouch.camera.deproject import Deprojector, pinhole_matrix
from foretouch.camera.device import DeviceSource, FileSource, LiveSource, list_devices
from foretouch.camera.realsense import CameraState, CameraStatus, RealSenseCamera, open_camera
from foretouch.camera.synthetic import SyntheticCamera, SyntheticFrame

__all__ = [
    "CameraState",
    "CameraStatus",
    "Deprojector",
    "DeviceSource",
    "FileSource",
    "FilterConfig",
    "LiveSource",
    "RealSenseCamera",
    "RealSenseConfig",
    "SyntheticCamera",
    "SyntheticFrame",
    "TimeoutConfig",
    "list_devices",
    "open_camera",
    "pinhole_matrix",
]
