# SPDX-License-Identifier: Apache-2.0
"""A world of its own: solids on a table, seen by a simulated depth camera."""

from foretouch.simulation.depth_scene import DepthImage, DepthScene, random_scene
from foretouch.simulation.primitives import Box, Cylinder, Primitive, Sphere
from foretouch.simulation.view import CameraView

__all__ = ["Box", "CameraView", "Cylinder", "DepthImage", "DepthScene", "Primitive", "Sphere", "random_scene"]
