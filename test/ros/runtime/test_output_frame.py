# SPDX-License-Identifier: Apache-2.0
"""The source of the transform of answers: tf2 (a stand-in), or a calibration file."""

import sys

import numpy as np
import pytest
import tf2_stand_in
from every_case import every_case
from numpy.testing import assert_allclose
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from foretouch.errors import ConfigError, MissingDependencyError
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.runtime.output_frame import OutputFrame, OutputFrameConfig, read_hand_eye
from foretouch_msgs.msg import Status

pytestmark = pytest.mark.ros

OWN = """
translation: [0.45, -0.2, 0.8]
rotation: [0.5, -0.5, 0.5, 0.5]
frame_id: base
child_frame_id: cam
"""
EASY = """
parameters:
  calibration_type: KIND
  robot_base_frame: base
  robot_effector_frame: tool0
  tracking_base_frame: cam
  tracking_marker_frame: marker
transform:
  translation: {x: 0.45, y: -0.2, z: 0.8}
  rotation: {x: 0.5, y: -0.5, z: 0.5, w: 0.5}
"""
ON_BASE = EASY.replace("KIND", "eye_on_base")


@pytest.fixture
def write(tmp_path):
    def to_file(text):
        path = tmp_path / "hand_eye.yaml"
        path.write_text(text)
        return str(path)

    return to_file


def test_both_forms_of_file_give_the_transform_to_the_robot(write):
    turn = Rotation.from_quat([0.5, -0.5, 0.5, 0.5])
    for text, robot in ((OWN, "base"), (ON_BASE, "base"), (EASY.replace("KIND", "eye_in_hand"), "tool0")):
        found = read_hand_eye(write(text))
        assert (found.target, found.source) == (robot, "cam")
        assert_allclose(found.points(np.eye(3)), turn.apply(np.eye(3)) + np.array([0.45, -0.2, 0.8]), atol=1e-15)


def test_a_file_that_cannot_be_used_is_named_with_the_field_in_one_line(write, tmp_path):
    def check(reason, text):
        path = write(text)
        with pytest.raises(ConfigError, match=reason) as caught:
            read_hand_eye(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)

    cases = [
        (r"rotation: length 1.05357 of \[0.6, -0.5, 0.5, 0.5\] is not 1", OWN.replace("0.5, -0.5", "0.6, -0.5")),
        (r"translation\[0\]: nan is not finite", OWN.replace("0.45", ".nan")),
        (r"translation\[0\]: 450.0 is above 100.0 m", OWN.replace("0.45", "450")),
        (r"rotation\[3\]: 'fast' is not a number", OWN.replace("0.5]", "fast]")),
        (r"translation: \[0.45, 0.8\] is not 3 numbers", OWN.replace("-0.2, ", "")),
        ("position: unknown setting; known: translation, rotation", OWN.replace("translation", "position")),
        ("frame_id: 3 is not text", OWN.replace("frame_id: base\n", "frame_id: 3\n", 1)),
        (r"translation: \[\] is not 3 numbers", "rotation: [0, 0, 0, 1]"),
        ("holds a list, not a mapping", "- 1"),
        ("is not a calibration of easy_handeye2", EASY),
        ("rotation: length 0.953", ON_BASE.replace("w: 0.5", "w: 0.4")),
        ("is not a calibration of easy_handeye2: there is no 'z'", ON_BASE.replace(", z: 0.8", "")),
        ("is not a calibration of easy_handeye2", "transform: 3"),
    ]
    every_case(cases, check)
    with pytest.raises(ConfigError, match=r"none\.yaml"):
        read_hand_eye(str(tmp_path / "none.yaml"))


def of_file(path, frame="base"):
    return OutputFrame(None, OutputFrameConfig(output_frame=frame, hand_eye=path))


def test_a_calibration_is_for_the_frames_that_it_names(write):
    path = write(OWN)
    frame = of_file(path)
    assert frame.transform(Header(frame_id="base")) is None
    assert frame.transform(Header(frame_id="cam")).target == "base"
    with pytest.raises(RefusalError, match="no_transform: hand_eye is for clouds in 'cam', not in 'other'") as caught:
        frame.transform(Header(frame_id="other"))
    assert caught.value.status == Status.UNKNOWN_FRAME
    with pytest.raises(ConfigError, match="frame_id: 'base' is not output_frame, 'world'"):
        of_file(path, "world")
    anywhere = of_file(write(OWN.replace("frame_id: base\n", "").replace("child_frame_id: cam", "")), "world")
    assert anywhere.transform(Header(frame_id="any")).source == "any"
    with pytest.raises(ConfigError, match=r"hand_eye: 'x\.yaml' is given without output_frame"):
        OutputFrameConfig(hand_eye="x.yaml")
    default = OutputFrame(None, OutputFrameConfig())
    assert (default.transform(Header(frame_id="cam")), default.notes()) == (None, {})
    default.close()


def test_without_tf2_and_calibration_a_frame_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    with pytest.raises(MissingDependencyError, match="output_frame: 'base' needs tf2_ros, which is not installed"):
        of_file("")


@pytest.fixture
def tf2(monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2_stand_in.module())
    return tf2_stand_in.Buffer


def test_a_transform_of_tf2_is_that_of_the_stamp_of_the_cloud(tf2, monkeypatch):
    turns = Rotation.from_euler("z", [[0.0], [90.0]], degrees=True).as_quat()
    tf2.known["base", "cam"] = [(0, np.zeros(3), turns[0]), (1000, np.array([1.0, 0.0, 0.0]), turns[1])]
    frame = OutputFrame(Node.__new__(Node), OutputFrameConfig(output_frame="base", transform_timeout_s=0.05))
    half = frame.transform(header_to_msg("cam", 500))
    assert_allclose(half.points(np.eye(3)[0]), [0.5 + np.sqrt(0.5), np.sqrt(0.5), 0.0], atol=1e-12)
    with pytest.raises(RefusalError, match="no_transform: from 'cam' to 'base': Lookup would require extrapolation"):
        frame.transform(header_to_msg("cam", 2000))
    with pytest.raises(RefusalError, match=r"no_transform: from 'hand' to 'base': .* does not exist") as caught:
        frame.transform(header_to_msg("hand", 500))
    assert caught.value.status == Status.UNKNOWN_FRAME
    assert frame.notes() == {"output_frame": "base (tf2)"}
    real = tf2.lookup_transform

    def too_short(*arguments, **options):
        found = real(*arguments, **options)
        found.transform.rotation.w = 0.5
        return found

    monkeypatch.setattr(tf2, "lookup_transform", too_short)
    with pytest.raises(RefusalError, match=r"no_transform: from 'cam' to 'base': orientation: length 0\.5"):
        frame.transform(header_to_msg("cam", 0))
    frame.close()
