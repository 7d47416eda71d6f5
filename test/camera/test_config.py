# SPDX-License-Identifier: Apache-2.0
"""Settings that contradict each other are refused by name."""

from every_case import every_refusal

from foretouch.camera.config import RealSenseConfig
from foretouch.errors import ConfigError


def test_bad_settings_are_named() -> None:
    cases = [
        ("file: 'a.db3' and serial '1' exclude each other", {"file": "a.db3", "serial": "1"}),
        ("stamp: 'best' is not one of auto, frame, arrival", {"stamp": "best"}),
    ]
    every_refusal(ConfigError, cases, RealSenseConfig.from_mapping)
    assert RealSenseConfig().optical_frame == "camera_depth_optical_frame"
    assert RealSenseConfig(frame_id="eye").optical_frame == "eye"
