# SPDX-License-Identifier: Apache-2.0
"""`run`, `replay` and `record` as a person calls them: processes of their own, over real DDS."""

import argparse
import json
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from scene_builders import scene_cloud, write_scenes

from foretouch.cli import run as run_command
from foretouch.cli.parser import CommandParser
from foretouch.dataset.formats.rosbag2 import write_bag
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.source import open_source
from foretouch.errors import ConfigError, ModelError
from foretouch.models.registry import find_card
from foretouch.pipeline import Pipeline
from foretouch.ros.nodes.monitor import View
from foretouch.stream import Stream
from foretouch.tactile import BIOTAC
from foretouch.tactile.description import packaged_sensor, with_sensor
from foretouch.types import Cloud
from foretouch.types.arrays import plain

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="ROS 2 is not installed")

FRAME = "camera_depth_optical_frame"
EXAMPLES = Path(__file__).parents[2] / "examples"
LISTENER = EXAMPLES / "listen_touch.py"
CAMERA = f"""
import numpy as np, rclpy
from sensor_msgs.msg import CameraInfo, Image
seen = np.load({str(EXAMPLES / "data" / "table_depth.npz")!r})
(height, width), K = seen["depth"].shape, seen["K"]
size = {{"height": height, "width": width}}
rclpy.init()
node = rclpy.create_node("camera_of_others")
images = node.create_publisher(Image, "/cam/depth/image_rect_raw", 5)
infos = node.create_publisher(CameraInfo, "/cam/depth/camera_info", 5)
colours = node.create_publisher(Image, "/cam/color/image_raw", 5)
image = Image(**size, encoding="16UC1", step=2 * width, data=seen["depth"].tobytes())
colour = Image(**size, encoding="rgb8", step=3 * width, data=bytes(3 * height * width))
info = CameraInfo(**size, k=K.ravel(), p=np.c_[K, np.zeros(3)].ravel(), distortion_model="plumb_bob", d=[0.0] * 5)
def send():
    image.header.frame_id = "camera_depth_optical_frame"
    image.header.stamp = node.get_clock().now().to_msg()
    info.header = colour.header = image.header
    infos.publish(info)
    images.publish(image)
    colours.publish(colour)
node.create_timer(0.2, send)
rclpy.spin(node)
"""


def run(environment: dict[str, str], *words: object) -> tuple[int, list[dict[str, Any]], str]:
    with started(environment, *words) as process:
        out, err = process.communicate(timeout=100)
    return process.returncode, [json.loads(line) for line in out.splitlines() if line.startswith("{")], err


@contextmanager
def started(environment: dict[str, str], *words: object, command: str = "run") -> Iterator[subprocess.Popen[str]]:
    words = (sys.executable, "-m", "foretouch.cli.main", command, *words, "--json")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(list(map(str, words)), env=environment, **pipes) as process:
        yield process


@pytest.mark.slow
def test_a_recording_is_answered_cloud_by_cloud_and_drawn(tmp_path, environment) -> None:
    picture = tmp_path / "touch.png"
    status, lines, err = run(
        environment, "--source", write_scenes(tmp_path / "bag", 5), "--picture", picture, "--rate", 2
    )
    assert status == 0, err
    *answers, last = lines
    assert (last["played"], last["answered"], len(answers)) == (5, 5, 5)
    assert last["conflicts"] == []
    assert "second graph" not in err
    assert len({answer["stamp_ns"] for answer in answers}) == 5
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_run_predict_and_a_stream_in_python_answer_a_recording_alike_to_the_bit(tmp_path, environment, call) -> None:
    """Ids, targets and kept grasps, too: the grasp changes from cloud to cloud unless it is kept."""
    rng, still = np.random.default_rng(5), scene_cloud(2)
    noisy = (still.xyz * (1.0 + rng.normal(0.0, 0.0006, (*still.xyz.shape[:2], 1))) for _ in range(5))
    seen = [Cloud(xyz.astype(np.float32), None, FRAME, 10**18 + k * 10**9) for k, xyz in enumerate(noisy)]
    write_bag(tmp_path / "bag", seen)
    status, (*lines, last), err = run(environment, "--source", tmp_path / "bag", "--rate", 1)
    assert (status, last["answered"]) == (0, len(seen)), err
    predicted = call("predict", tmp_path / "bag", "--target", "nearest", "--json").records
    stream, held = Stream(), []
    for line, record, item in zip(lines, predicted, open_source(tmp_path / "bag"), strict=True):
        result = stream.answer(item.cloud)
        (target,) = result.targets
        played, (own,) = line["predictions"], record["predictions"]
        assert len(played) == len(target.plan.grasps) == 1
        assert played[0]["object"] == record["object"] == target.target.id
        for name, value in target.predictions.to_dict()["predictions"][0].items():
            assert own[name] == plain(value), name
            assert as_sent(played[0][name]) == as_sent(plain(value)), name
        held.append(own["grasp"]["g1"])
    assert held[1:] == held[:-1] or len({tuple(g1) for g1 in held}) < len(held)
    alone = [Pipeline(stream.config).run(cloud).targets[0].plan.grasps.g1[0].tolist() for cloud in seen]
    assert alone != held, "nothing had to be kept"


def as_sent(value: Any) -> Any:
    """Numbers as a message holds them, float32."""
    if isinstance(value, dict):
        return {key: as_sent(item) for key, item in value.items()}
    if isinstance(value, list):
        return [as_sent(item) for item in value]
    return float(np.float32(value)) if isinstance(value, float) else value


@pytest.mark.slow
def test_a_topic_of_depth_images_is_answered_until_the_count(environment) -> None:
    with subprocess.Popen([sys.executable, "-c", CAMERA], env=environment) as camera:
        try:
            words = ("--source", "/cam/depth/image_rect_raw", "--color", "/cam/color/image_raw", "--count", 3)
            status, (*answers, last), err = run(environment, *words)
        finally:
            camera.kill()
    assert (status, len(answers)) == (0, 3), err
    assert {len(answer["predictions"]) for answer in answers} == {1}
    assert 3 == last["answered"] <= last["played"] <= 5, "what comes after the last answer does not count"


CAMERA_OPTIONS = {
    "--intrinsics": "1,1,1,1",
    "--camera-info": "a.yaml",
    "--info-topic": "/a",
    "--rectified": "yes",
    "--depth-scale": "1",
}


def test_mistakes_are_one_line_before_anything_starts(call, tmp_path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("camera: {width: 424, hight: 320}\n", encoding="utf-8")
    none, played = tmp_path / "none", "is for recordings and files, and --source"
    image = Path(__file__).parents[2] / "examples" / "data" / "table.npz"

    def check(words: tuple[object, ...], line: str) -> None:
        call(*words).check_refused(f"foretouch: {line}")

    picture = ("--picture", tmp_path / "touch.txt")
    check(("run", "--source", none, *picture), f"{picture[1]}: the extension is not one of .png, .pdf, .svg, .jpg")

    cases = [
        (("run", "--source", none), f"{none}: does not exist\n"),
        (("replay", none), f"{none}: does not exist\n"),
        (("run", "--source", "camera", "--wait-for", "touch"), f"--wait-for: {played} camera is another source\n"),
        (("run", "--source", "s.yaml", "--wait-limit", "1"), f"--wait-limit: {played} s.yaml is another source\n"),
        (("run", "--source", "s.yaml", "--depth-scale", "1"), f"--depth-scale: {played} s.yaml is"),
        (
            ("run", "--source", "camera", "--color", "/a"),
            "--color: is for recordings and files, and depth images on a topic, and",
        ),
        (
            ("run", "--source", image, "--color", "a.png"),
            f"{image}: holds points: leave out --color, which is for depth",
        ),
        (("run", "--source", "/a/b", "--plane", "0,0,1,-1"), f"--plane: {played} /a/b is"),
        *(
            (("run", "--source", source, option, value), f"{option}: {played} {source} is")
            for source in ("/a/b", "camera", "s.yaml")
            for option, value in CAMERA_OPTIONS.items()
        ),
        *(
            ((command, *source, image, option, value), f"{image}: holds points: leave out {option}, which is for depth")
            for command, source in (("run", ("--source",)), ("replay", ()))
            for option, value in CAMERA_OPTIONS.items()
            if option != "--info-topic"
        ),
        (("replay", image, "--info-topic", "/a"), f"{image}: is not a recording, so it has no topic /a"),
        (("replay", image, "--plane", "0,0,1,-1"), "--plane: is for the points of one object; the table is found in"),
        (("run", "--source", "/a/b", "--rate", "1"), "--rate: is for recordings and files, and scenes (.yaml), and"),
        (("run", "--source", image, "--dwell", "1"), "--dwell: is for scenes (.yaml), and --source"),
        (("run", "--source", image, "--plane", "0,0,1,-1"), "--plane: is for the points of one object; the table is"),
        (("run", "--source", none, "--model", "nope"), "nope: is not a model folder, no card"),
        (("run", "--source", none, "--model", tmp_path / "a.json"), f"{tmp_path / 'a.json'}: no such"),
        (("run", "--source", scene), f"{scene}: camera.hight: unknown setting"),
    ]
    every_case(cases, check)


@pytest.mark.slow
def test_a_planner_that_is_waited_for_gets_every_answer(tmp_path, environment) -> None:
    words = ("--source", write_scenes(tmp_path / "bag", 5), "--wait-for", "touch", "--wait-limit", 60)
    with started(environment, *words) as process:
        command = [sys.executable, str(LISTENER), "--count", "5"]
        listener = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=80, check=False)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    answers = [json.loads(line) for line in out.splitlines()[:5]]
    stamps = [answer["stamp_ns"] for answer in answers]
    assert not any("late" in prediction["flags"] for answer in answers for prediction in answer["predictions"])
    heard = [line.split()[0].split(".") for line in listener.stdout.splitlines() if line[0] != " "]
    assert list(dict.fromkeys(int(sec) * 10**9 + int(ns) for sec, ns in heard)) == stamps


def test_a_scene_is_predicted_by_the_model_of_its_hand_unless_another_is_named(tmp_path) -> None:
    (tmp_path / "scene.yaml").write_text("grasps: {}\n")
    files = {
        "none": "/foretouch/perception: {ros__parameters: {use_tare: false}}",
        "named": "foretouch: {perception: {ros__parameters: {model: simulated_too}}}",
    }
    for name, text in files.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    parser = CommandParser("foretouch run --source camera", prog="foretouch run")
    run_command.add_arguments(parser)

    def model(*words: str) -> str | None:
        arguments = parser.parse_args(["--source", *words])
        return run_command._nodes(arguments)["perception"].get("model")

    scene = str(tmp_path / "scene.yaml")
    assert model(scene) == model(scene, "--params", str(tmp_path / "none.yaml")) == "simulated"
    assert model(scene, "--params", str(tmp_path / "named.yaml")) is None  # the file's counts
    assert model(scene, "--model", "contact-v3") == "contact-v3"
    with pytest.raises(ModelError, match=r"simulated_too: .* did you mean simulated"):
        model(scene, "--model", "simulated_too")
    assert model("camera") is None


def test_grasps_on_a_scene_are_planned_for_the_hand_that_it_names(tmp_path) -> None:
    (tmp_path / "scene.yaml").write_text("hand: franka_hand\n")
    (tmp_path / "own.yaml").write_text("foretouch: {perception: {ros__parameters: {hand.name: two_tips}}}")
    parser = CommandParser("foretouch run --source camera", prog="foretouch run")
    run_command.add_arguments(parser)

    def perception(*words: str) -> dict[str, Any]:
        return run_command._nodes(parser.parse_args(["--source", str(tmp_path / "scene.yaml"), *words]))["perception"]

    assert {"hand.name": "franka_hand", "hand.thumb_at": "g1"}.items() <= perception().items()
    assert "hand.name" not in perception("--params", str(tmp_path / "own.yaml"))  # the file's counts
    option = perception("--params", str(tmp_path / "own.yaml"), "--hand", "robotiq_2f85")
    assert {"hand.name": "robotiq_2f85", "hand.thumb_at": "g1"}.items() <= option.items()  # an option counts more
    with pytest.raises(ConfigError, match=r"--hand: name: frnka_hand: .* did you mean franka_hand"):
        perception("--hand", "frnka_hand")


@pytest.mark.slow
def test_without_a_camera_it_names_what_it_waits_for_and_ends_with_its_own_status(environment) -> None:
    with started(environment, "--source", "camera") as process:
        assert process.stderr is not None
        lines = []
        for line in process.stderr:
            lines.append(line)
            if "waiting for the first cloud" in line:
                break
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=60)
    assert process.returncode == 3, rest
    assert "no RealSense device" in lines[-1], lines
    last = rest.splitlines()[-1]
    assert "no cloud came from the camera: absent: no RealSense device is connected" in last
    assert "Traceback" not in "".join(lines) + rest


@pytest.mark.slow
def test_ctrl_c_ends_a_recording_in_order(tmp_path, environment) -> None:
    words = ("-o", tmp_path / "set", "--object", "can", "--set", "identity.hand=shadow")
    with started(environment, *words, command="record") as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["recording"]
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    last = json.loads(out.splitlines()[-1])
    assert (last["recording"], last["reason"], last["samples"]) == (False, "", 0)
    assert last["sensors"] == {"TH": "no data", "MF": "no data", "camera": "no data"}
    assert err.count("keys are off without a terminal; the services edit_grasp, ") == 1
    (report,) = verify_dataset(tmp_path / "set")
    assert (report.finished, report.faults) == (True, [])


def test_what_is_shown_is_for_the_sensor_of_the_model_from_the_option_or_the_parameter_file(tmp_path) -> None:
    card = json.loads(find_card("contact-v3").read_text())
    path, params = tmp_path / "uskin.json", tmp_path / "params.yaml"
    path.write_text(json.dumps(with_sensor(card, packaged_sensor("xela_uskin_4x4"))))
    params.write_text(f"/foretouch/perception:\n  ros__parameters: {{model: {path}}}\n")
    by_option, by_file = {"perception": {"model": str(path)}}, dict[str, Any](perception={})
    for name, file, nodes in (
        ("xela_uskin_4x4", None, by_option),
        ("xela_uskin_4x4", params, by_file),
        ("biotac_sp", None, by_file),
        ("biotac_sp", params, {"perception": {"model": "absent"}}),
    ):
        given: Any = SimpleNamespace(params=file)
        assert run_command._sensor(given, nodes).config.name == name


def test_a_source_that_was_not_played_completely_is_a_fault_unless_it_was_stopped() -> None:
    cases = (
        (("finished", 3, 0), ""),
        (("finished", 0, 0), "holds no cloud and no sample"),
        (("stopped", 0, 0), ""),
        (("finished", 2, 1), "1 entry could not be read: a.png: is cut off"),
        (("finished", 2, 3), "3 entries could not be read, first a.png: is cut off"),
        (("failed", 2, 0), "failed: cut off"),
    )
    for (outcome, played, unreadable), fault in cases:
        replay: Any = SimpleNamespace(
            outcome=outcome,
            played=Counter(clouds=played),
            unreadable=unreadable,
            failure="cut off",
            first_refusal="a.png: is cut off",
        )
        assert run_command.replay_fault(replay) == fault


@pytest.mark.parametrize(
    ("flags", "status"), [(("no_contact_TH", "no_contact_MF"), 1), (("no_contact_TH",), 0), ((), 0)]
)
def test_a_hand_that_touches_nothing_is_named_and_decides_the_exit_status(flags, status, capsys) -> None:
    readings = SimpleNamespace(flags=flags, touch=SimpleNamespace(channels=BIOTAC))
    view = View(answers=Counter(ok=2), executed=(None, readings))
    monitor = SimpleNamespace(close_view=lambda: view)
    graph = SimpleNamespace(monitor=monitor, nodes={}, replay=None, played=lambda: 2, conflicts=list)
    lines = SimpleNamespace(dropped=0, put=lambda _: None, close=lambda _: True)
    assert (
        run_command._finish(
            graph, argparse.Namespace(json=True, picture=None, source="a.yaml", lines=lines), complete=True
        )
        == status
    )
    assert ("touched nothing: its readings are those at rest" in capsys.readouterr().err) == bool(status)
