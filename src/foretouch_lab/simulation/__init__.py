# SPDX-License-Identifier: Apache-2.0
"""The simulator: objects on a table, a simulated depth camera, and BioTac SP fingertips that press on the objects."""

from foretouch_lab.simulation.depth_scene import CameraView, DepthScene, RenderedFrame, random_scene
from foretouch_lab.simulation.solids import Primitive

__all__ = ["CameraView", "DepthScene", "Primitive", "RenderedFrame", "random_scene"]
