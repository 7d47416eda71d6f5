# SPDX-License-Identifier: Apache-2.0
"""Small recordings of synthetic scenes, written by the example that makes them."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from make_recording import SceneRecordingConfig, record_scenes, scene_clouds

__all__ = ["SceneRecordingConfig", "record_scenes", "scene_clouds"]
