# SPDX-License-Identifier: Apache-2.0
"""Depth cameras: a RealSense that is plugged in, recorded or fed with synthetic frames."""

from foretouch.camera.deproject import Deprojector, pinhole_matrix

__all__ = ["Deprojector", "pinhole_matrix"]
