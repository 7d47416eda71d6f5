# SPDX-License-Identifier: Apache-2.0
"""What people type: the commands of README and of the pages, and the launch files, with the official command line of ROS 2.

They run where the variable `ROS2_TOOLS` names the folder of the program `ros2`, such as `/opt/ros/jazzy/bin`.
"""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from every_case import every_case

from foretouch.ros import executables
from foretouch.ros.nodes import NODES
from test.ros.conftest import open_domain

TOOLS = os.environ.get("ROS2_TOOLS", "")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.timeout(300),
    pytest.mark.skipif(not TOOLS, reason="types commands of ROS 2: set ROS2_TOOLS to the folder of the program ros2"),
]

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TYPED = re.compile(r"^ros2 [^#\n]*|`(ros2 [a-z]+[^`\n]*)`", re.MULTILINE)
TOUCH = "foretouch_msgs/msg/TouchPredictionArray"
ELSEWHERE = {  # what needs a driver, a program or a device that is not here
    "ros2 launch realsense2_camera": "the driver of the RealSense",
    "ros2 launch foretouch perception.launch.py$": "a RealSense",
    "ros2 launch .* rviz:=true": "RViz",
    "ros2 launch .* model:=": "a model of the reader's",
    "ros2 launch …": "a name of the command alone",
    "ros2 run ros1_bridge": "ROS 1",
    "ros2 run rmw_zenoh_cpp": "Zenoh",
    "ros2 bag": "rosbag2",
}


def installed(prefix: Path) -> None:
    """Make what `colcon build` installs of the package, in a prefix: the files of `share`, and an executable for each node."""
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "foretouch").touch()
    (prefix / "share" / "foretouch").symlink_to(ROOT)
    (prefix / "lib" / "foretouch").mkdir(parents=True)
    for name in NODES:
        assert hasattr(executables, name)
        path = prefix / "lib" / "foretouch" / f"foretouch_{name}"
        lines = [f"#!{sys.executable}", f"from foretouch.ros.executables import {name}", f"raise SystemExit({name}())"]
        path.write_text("\n".join(lines), encoding="utf-8")
        path.chmod(0o755)


class Terminal:
    """Types commands in a domain of its own, in a folder that begins empty."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        installed(folder / "install" / "foretouch")
        prefixes = [str(folder / "install" / "foretouch"), os.environ.get("AMENT_PREFIX_PATH", sys.prefix)]
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(open_domain(new=True)),
            "WORKSPACE": str(folder),
            "AMENT_PREFIX_PATH": os.pathsep.join(prefixes),
            "PATH": f"{TOOLS}{os.pathsep}{os.environ['PATH']}",
            "XDG_STATE_HOME": str(folder / "state"),
            "PYTHONUNBUFFERED": "1",
        }
        self._processes: list[subprocess.Popen[bytes]] = []
        self._outputs: dict[int, Path] = {}  # by process

    def __call__(self, command: str, timeout_s: float = 60.0) -> str:
        """The output of a command that ends by itself; it must succeed."""
        process = self.start(command)
        process.wait(timeout=timeout_s)
        assert process.returncode == 0, f"{command}: {self.output(process)}"
        return self.output(process)

    def some(self, command: str, wanted: str, timeout_s: float = 60.0) -> str:
        """The output of a command that goes on, up to a match of a pattern; then Ctrl-C."""
        process, end = self.start(command), time.monotonic() + timeout_s
        while not re.search(wanted, self.output(process), re.MULTILINE):
            assert time.monotonic() < end, f"{command}: {wanted} is not in: {self.output(process)}"
            time.sleep(0.1)
        return self.stop(process)

    def start(self, command: str) -> "subprocess.Popen[bytes]":
        """A command that goes on until `stop`."""
        output = self.folder / f"{len(self._processes)}.txt"
        with output.open("wb") as file:
            process = subprocess.Popen(
                shlex.split(command), env=self._environment, cwd=self.folder, stdout=file, stderr=subprocess.STDOUT,
                start_new_session=True,
            )  # fmt: skip
        self._processes.append(process)
        self._outputs[process.pid] = output
        return process

    def output(self, process: "subprocess.Popen[bytes]") -> str:
        """What a command has written so far."""
        return self._outputs[process.pid].read_text(encoding="utf-8")

    def stop(self, process: "subprocess.Popen[bytes]") -> str:
        """Press Ctrl-C, after which the command must end by itself; what it has written."""
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        process.wait(timeout=30.0)
        return self.output(process)

    def until(self, command: str, wanted: str, timeout_s: float = 60.0) -> str:
        """The output of a command, typed again and again until it matches a pattern."""
        end, output = time.monotonic() + timeout_s, ""
        while not re.search(wanted, output, re.MULTILINE):
            assert time.monotonic() < end, f"{command}: {wanted} is not in: {output}"
            process = self.start(command)
            process.wait(timeout=timeout_s)
            output = self.output(process)
        return output

    def answers(self, namespace: str, count: int = 1) -> list[int]:
        """The status of the next answers of a graph."""
        topic = f"{namespace}/touch {TOUCH} --qos-durability volatile --qos-reliability reliable"
        return [int(self(f"ros2 topic echo --once --field status {topic}").split()[0]) for _ in range(count)]

    def close(self) -> None:
        """End what still runs, and the daemon of the command line."""
        for process in self._processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
        for process in self._processes:
            try:
                process.wait(timeout=20.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
        self("ros2 daemon stop")


@pytest.fixture(scope="module")
def typed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Terminal]:
    """A terminal in which the demo scene was launched, with nothing but its name."""
    terminal = Terminal(tmp_path_factory.mktemp("terminal"))
    terminal.start("ros2 launch foretouch scene.launch.py dwell:=600")
    assert terminal.answers("/foretouch") == [0]
    yield terminal
    terminal.close()


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    """A terminal in a domain where nothing runs."""
    one = Terminal(tmp_path)
    yield one
    one.close()


def printed() -> set[str]:
    """All commands of ROS 2 on README and the pages."""
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    return {(found[1] or found[0]).strip() for text in texts for found in TYPED.finditer(text)}


ONCE = {  # commands of the pages that end by themselves, by what their output holds
    "ros2 node list": "/foretouch/perception\n",
    "ros2 topic list": "/foretouch/touch\n",
    "ros2 launch foretouch FILE --show-args": "'namespace'",
    "ros2 service call /foretouch/forget_touches std_srvs/srv/Trigger": " touches forgotten",
    "ros2 param set /foretouch/perception target.mode free": "Set parameter successful",
    "ros2 param dump /foretouch/perception": "ros__parameters:",
    "ros2 launch foretouch scene.launch.py scene:=FILE": None,  # with files in the tests below
    "ros2 launch foretouch replay.launch.py": None,
    "ros2 param set": None,  # the name of a command alone, as those below
    "ros2 param list": None,
    "ros2 topic echo": None,
    "ros2 topic info -v": None,
    "ros2 service call": None,
    "ros2 param dump": None,
    "ros2 param load": None,
    "ros2 launch": None,
}
ON_AND_ON = {  # commands that go on until Ctrl-C, by the line of the launch or the command that is waited for
    "ros2 topic echo /diagnostics": "name: /foretouch/perception",
    "ros2 launch foretouch perception.launch.py camera:=false depth:=TOPIC": "process started",
    "ros2 launch foretouch perception.launch.py camera:=false input:=objects": "process started",
    "ros2 launch foretouch scene.launch.py": "process started",
    "ros2 launch foretouch recorder.launch.py record:=session": "recording to|recorder.*session",
    "ros2 run foretouch foretouch_bridge": "serving at ws://",
}


def test_each_command_of_the_pages_runs_as_printed_or_needs_what_is_not_here(typed: Terminal) -> None:
    commands = {one for one in printed() if not any(re.match(needed, one) for needed in ELSEWHERE)}
    by_hand = set(fenced("From a terminal"))
    assert commands - by_hand - {*ONCE, *ON_AND_ON} == set(), "commands that no test types"

    def once(command: str) -> None:
        words = command.replace("FILE", "scene.launch.py")
        wanted = ONCE[command]
        assert wanted is None or wanted in typed(words)

    every_case({one: one for one in sorted(commands & {*ONCE})}, once)
    every_case({one: one for one in sorted(commands & {*ON_AND_ON})}, lambda one: typed.some(one, ON_AND_ON[one]))


def fenced(title: str) -> list[str]:
    """The commands below a title of docs/planners.md."""
    page = (ROOT / "docs" / "planners.md").read_text(encoding="utf-8")
    block = re.search(rf"^## {title}\n.*?```sh\n(.*?)```", page, re.MULTILINE | re.DOTALL)
    assert block is not None, title
    return [" ".join(line.partition(" #")[0].split()) for line in block[1].splitlines()]


def test_a_request_without_a_cloud_a_stamp_or_a_rotation_is_answered(typed: Terminal) -> None:
    commands = fenced("From a terminal")
    assert {command.split()[3] for command in commands if command.startswith("ros2 service")} >= {
        "/foretouch/predict_touch",
        "/foretouch/forget_touches",
    }

    def check(command: str) -> None:
        answer = typed(command)
        if "Grasps" in command:
            assert "Goal finished with status: SUCCEEDED" in answer
            assert "Feedback:" in answer
        elif "Predict" in command:
            part = answer.partition("batch=" if "contacts" in command else "touch=")[2]
            assert re.search(r"values=\[\d", part)
            assert "frame_id='camera_depth_optical_frame'" in part
        elif command.startswith("ros2 service"):
            assert "success=True" in answer

    every_case({one: (one,) for one in commands}, check)


def test_what_is_asked_about_a_graph_is_answered(typed: Terminal) -> None:
    """The commands with which people look at any graph."""
    perception = "/foretouch/perception"
    expected = {
        f"ros2 node info {perception}": "/foretouch/predict_touch: foretouch_msgs/srv/PredictTouch",
        "ros2 topic info -v /foretouch/touch": "Durability: TRANSIENT_LOCAL",
        "ros2 service list": "/foretouch/perception/change_state",
        "ros2 action list -t": "/foretouch/sample_grasps [foretouch_msgs/action/SampleGrasps]",
        f"ros2 param list {perception}": "segmentation.plane.threshold_m",
        f"ros2 param get {perception} target.mode": "String value is: ",
        f"ros2 param describe {perception} segmentation.plane.threshold_m": "Max value: 0.1",
        f"ros2 param set {perception} segmentation.plane.threshold_m 0.011": "Set parameter successful",
        f"ros2 param set {perception} segmentation.plane.threshold_m 7": "Setting parameter failed",
        f"ros2 param set {perception} segmentation.plane.thresold_m 0.01": "did you mean segmentation.plane.threshold_m?",
        f"ros2 lifecycle get {perception}": "active [3]",
        f"ros2 lifecycle list {perception}": "deactivate [4]",
        "ros2 interface show foretouch_msgs/srv/PredictTouch": "float64[] contacts",
        "ros2 pkg executables foretouch": "foretouch foretouch_perception",
        "ros2 topic pub --once /foretouch/clicked_point geometry_msgs/msg/PointStamped "
        "'{header: {frame_id: camera_depth_optical_frame}, point: {x: -0.035, z: 1.15}}'": "publishing #1",
    }

    def check(command: str, wanted: str) -> None:
        assert wanted in typed(command)

    every_case({one: (one, wanted) for one, wanted in expected.items()}, check)
    typed.some("ros2 topic hz /foretouch/touch", r"average rate: [1-9]")
    typed.some("ros2 topic delay /foretouch/touch", r"average delay: 0\.")
    typed.some("ros2 topic bw /foretouch/touch", r"KB/s from|B/s from")
    for step, state in (("deactivate", "inactive"), ("activate", "active")):
        assert "Transitioning successful" in typed(f"ros2 lifecycle set {perception} {step}")
        assert state in typed(f"ros2 lifecycle get {perception}")
    assert typed.answers("/foretouch") == [0]


def test_two_graphs_launched_in_two_namespaces_answer_and_end_with_ctrl_c(terminal: Terminal) -> None:
    own = {"/**": {"ros__parameters": {"tactile_topic": "tactile"}}}
    (terminal.folder / "own.yaml").write_text(yaml.safe_dump(own), encoding="utf-8")
    launched = [
        terminal.start(f"ros2 launch foretouch scene.launch.py namespace:=/{side} fps:=2 params_file:=own.yaml")
        for side in ("left", "right")
    ]
    assert [terminal.answers(f"/{side}") for side in ("left", "right")] == [[0], [0]]
    assert {"/left/perception", "/right/perception"} <= set(terminal("ros2 node list").split())
    assert "/left/tactile" in terminal("ros2 param get /left/perception tactile_topic") or "tactile" in terminal(
        "ros2 param get /left/perception tactile_topic"
    )
    for process in launched:
        output = terminal.stop(process)
        assert (process.returncode, "Traceback" in output, "second graph" in output) == (0, False, False), output


def test_one_process_for_each_step_takes_remapped_images_and_a_node_that_is_killed_is_started_again(
    terminal: Terminal,
) -> None:
    scene = "-p source:=scene -p camera.fps:=3 -p scene.dwell_s:=600.0 -p scene.path:="
    camera = terminal.start(
        f"ros2 run foretouch foretouch_camera --ros-args -r __ns:=/cam {scene}{ROOT / 'config/scenes/demo.yaml'}"
    )
    launched = terminal.start(
        "ros2 launch foretouch perception.launch.py camera:=false depth:=/cam/depth/image_rect_raw one_process:=false respawn:=true"
    )
    assert terminal.answers("/foretouch") == [0]
    steps = ("segmentation", "grasp", "touch_predictor")
    assert {f"/foretouch/{step}" for step in steps} <= set(terminal("ros2 node list").split())
    before = pid_of(terminal, "grasp")
    os.kill(before, signal.SIGKILL)
    end = time.monotonic() + 60.0
    while (now := pid_of(terminal, "grasp")) == before:
        assert time.monotonic() < end, "the node was not started again"
    assert now != before
    assert terminal.answers("/foretouch") == [0]
    output = terminal.stop(launched)
    assert "process has died" in output
    terminal.stop(camera)


def pid_of(terminal: Terminal, node: str) -> int:
    """The process of a node, from its next report."""
    rule = shlex.quote(f"m.status[0].name == '/foretouch/{node}'")
    report = next(yaml.safe_load_all(terminal(f"ros2 topic echo --once --filter {rule} /diagnostics")))
    return int({pair["key"]: pair["value"] for pair in report["status"][0]["values"]}["pid"])


def test_a_graph_launched_with_the_time_of_a_clock_answers_by_it(terminal: Terminal) -> None:
    pytest.importorskip("rosgraph_msgs.msg", reason="rosgraph_msgs is not installed")
    played = {"/foretouch/replay": {"ros__parameters": {"restamp": True, "loop": True, "rate_hz": 2.0}}}
    (terminal.folder / "played.yaml").write_text(yaml.safe_dump(played), encoding="utf-8")
    terminal.start("ros2 topic pub -r 20 /clock rosgraph_msgs/msg/Clock '{clock: {sec: 1000, nanosec: 5}}'")
    path = ROOT / "examples/data/table.npz"
    launched = terminal.start(
        f"ros2 launch foretouch replay.launch.py path:={path} use_sim_time:=true params_file:=played.yaml"
    )
    assert (
        terminal.until(f"ros2 topic echo --once --field header.stamp.sec /foretouch/touch {TOUCH}", r"^\d+").split()[0]
        == "1000"
    )
    assert "Boolean value is: True" in terminal("ros2 param get /foretouch/perception use_sim_time")
    assert "Traceback" not in terminal.stop(launched)


def test_parameters_that_were_dumped_start_the_same_graph_and_can_be_loaded(terminal: Terminal) -> None:
    launch = "ros2 launch foretouch perception.launch.py camera:=false"
    first = terminal.start(launch)
    terminal.until("ros2 lifecycle get /foretouch/perception", "^active")
    for name, value in (("target.mode", "all"), ("hand.opening_m", "0.07"), ("frames", "[camera_a, camera_b]")):
        assert "successful" in terminal(f"ros2 param set /foretouch/perception {name} '{value}'")
    dumped = terminal("ros2 param dump /foretouch/perception")
    (terminal.folder / "dumped.yaml").write_text(dumped, encoding="utf-8")
    terminal.stop(first)
    second = terminal.start(f"{launch} params_file:=dumped.yaml")
    terminal.until("ros2 lifecycle get /foretouch/perception", "^active")
    assert settled(terminal("ros2 param dump /foretouch/perception")) == settled(dumped)
    loaded = terminal("ros2 param load /foretouch/perception dumped.yaml")
    failed = [line for line in loaded.splitlines() if "failed" in line and "read-only" not in line]
    assert ("Set parameter target.mode successful" in loaded, failed) == (True, [])
    terminal.stop(second)


def settled(dumped: str) -> Any:
    """The parameters of a dumped file; a list without elements and no value are the same in ROS, which has no type for either."""
    text = json.dumps(yaml.safe_load(dumped), sort_keys=True)
    return text.replace('"null"', "null").replace("[]", "null")


def test_what_a_launched_recorder_wrote_is_replayed_to_its_end_by_a_launch(terminal: Terminal) -> None:
    scene = terminal.start("ros2 launch foretouch scene.launch.py fps:=3 dwell:=600")
    assert terminal.answers("/foretouch") == [0]
    recorder = terminal.start("ros2 launch foretouch recorder.launch.py record:=session object:=can")
    terminal.until("ros2 topic echo --once --field bytes_written /foretouch/recorder_status", r"^[1-9]\d{5,}")
    assert "success=True" in terminal(
        "ros2 service call /foretouch/stop_recording foretouch_msgs/srv/StopRecording", 90.0
    )
    for process in (recorder, scene):
        terminal.stop(process)
    output = terminal("ros2 launch foretouch replay.launch.py path:=session", 120.0)
    assert "foretouch_replay" in output
    assert "Traceback" not in output
