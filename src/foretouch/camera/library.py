# SPDX-License-Identifier: Apache-2.0
"""Moved to `foretouch.camera.device`."""

from foretouch.camera.device import realsense

__all__ = ["realsense"]
