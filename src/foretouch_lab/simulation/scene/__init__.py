# SPDX-License-Identifier: Apache-2.0
"""Scenes: typed settings read from YAML; contradictions are refused with a reason."""

from foretouch_lab.simulation.scene.scene import SceneConfig, centre_of_objects, load_scene, scheduled_scene

__all__ = ["SceneConfig", "centre_of_objects", "load_scene", "scheduled_scene"]
