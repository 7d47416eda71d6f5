# SPDX-License-Identifier: Apache-2.0
"""Settings that contradict each other are refused by name."""

from every_case import every_refusal

from foretouch.camera.config import RealSenseConfig
from foretouch.errors import ConfigError


def test_bad_settings_are_named_and_the_frame_is_that_of_the_image_the_points_come_from() -> None:
    cases = [
        ("file: 'a.db3' and serial '1' exclude each other", {"file": "a.db3", "serial": "1"}),
        ("record_to: 'b.db3': a recording cannot be recorded again", {"file": "a.db3", "record_to": "b.db3"}),
        ("stall_s: 5.0 is above reopen_s, 3.0", {"timeouts.stall_s": 5.0}),
        ("align: 'both' is not one of none, colour_to_depth, depth_to_colour", {"align": "both"}),
        ("magnitude: 9 is above 8 px", {"filters.decimation.magnitude": 9}),
        ("filters.median: unknown setting; known: decimation, spatial", {"filters.median": 1}),
    ]
    every_refusal(ConfigError, cases, RealSenseConfig.from_mapping)
    assert RealSenseConfig().optical_frame == "camera_depth_optical_frame"
    assert RealSenseConfig(align="depth_to_colour").optical_frame == "camera_color_optical_frame"
    assert RealSenseConfig(frame_id="eye").optical_frame == "eye"
