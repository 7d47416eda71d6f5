# SPDX-License-Identifier: Apache-2.0
"""The simulator: objects on a table, a simulated depth camera, and BioTac SP fingertips that press on the objects."""

from foretouch.simulation.depth_scene import DepthImage, DepthScene, random_scene
from foretouch.simulation.solids import Box, Cylinder, Primitive, Sphere
from foretouch.simulation.view import CameraView

__all__ = ["Box", "CameraView", "Cylinder", "DepthImage", "DepthScene", "Primitive", "Sphere", "random_scene"]
