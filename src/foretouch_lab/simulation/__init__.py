# SPDX-License-Identifier: Apache-2.0
"""The simulator: objects on a table, a simulated depth camera, and BioTac SP fingertips that press on the objects."""

from foretouch_lab.simulation.depth_scene import CameraView, DepthImage, DepthScene, random_scene
from foretouch_lab.simulation.solids import Box, Cylinder, Primitive, Sphere

__all__ = ["Box", "CameraView", "Cylinder", "DepthImage", "DepthScene", "Primitive", "Sphere", "random_scene"]
