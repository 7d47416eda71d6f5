# SPDX-License-Identifier: Apache-2.0
"""Scenes: typed settings read from YAML; contradictions are refused with a reason."""

from foretouch_lab.simulation.scene.scene import SceneConfig, load_scene

__all__ = ["SceneConfig", "load_scene"]
