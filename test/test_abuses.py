# SPDX-License-Identifier: Apache-2.0
"""Commands and keys at the wrong moment, as a user meets them: processes of their own, most over real DDS.

Each abuse ends with the right exit status, in a line or a few that name the cause, without a traceback, and leaves no
process behind. What holds must hold at whatever instant a signal comes, however busy the machine is. A launch without
rviz2 is in `test/ros/test_launch_files.py`.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import signal_cases
from every_case import every_case
from process_domain import process_environment
from recording_builders import write_dataset
from scene_builders import scene_cloud, write_scenes

from foretouch.cloud.io.files import write_cloud
from foretouch.types import Cloud

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

CONFIG = Path(__file__).parents[1] / "config"
PATIENCE_S = 100.0
INTERRUPTED = {130, -signal.SIGINT}  # the latter while the interpreter ends
TINY = [
    *("model.tnet=false", "model.trunk_widths=[8,16]", "model.head_widths=[16]", "model.n_points=64"),
    *("train.epochs=400", "train.batch_size=4"),
]


@dataclass(frozen=True)
class Abuse:
    """A command, what is done to it, and how it must end. `@` in a word is the folder of the files, `%` a new one."""

    name: str
    words: str
    status: set[int]
    line: str = ""  # of stderr
    stdout: str = ""  # a path instead of a pipe, or `closed`
    limit: int | None = None  # of the size of any file that is written [bytes]
    head: bool = False  # read one line, then close the pipe
    env: dict[str, str] = field(default_factory=dict)
    number: int = signal.SIGINT
    after: float = 0.0  # when to send the signal [s], after the start


RUN = "run --source @/recording --rate 10 --json"
SIMULATE = f"simulate {CONFIG}/scenes/clean.yaml -n 400 -o %/store --workers 2"
TRAIN = f"train {CONFIG}/train/touchnet-v1.yaml data=@/set -o %/run {' '.join(TINY)}"
EXPERIMENT = f"experiment label_ratio --preset smoke --data {CONFIG}/scenes/deformables.yaml --workers 2 -o %/sweep"
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
ENDED = {0, *INTERRUPTED}

SIGNALS = [
    *(Abuse(f"simulate, Ctrl-C after {t}", SIMULATE, INTERRUPTED, "SIGINT", after=t) for t in (0.0, 1.4)),
    *(Abuse(f"train, Ctrl-C after {t}", TRAIN, INTERRUPTED, "SIGINT", after=t) for t in (0.5, 2.0)),
    *(Abuse(f"experiment, Ctrl-C after {t}", EXPERIMENT, ENDED, after=t) for t in (0.5, 2.5)),
    Abuse("simulate, SIGTERM", SIMULATE, {143, -15}, "SIGTERM", number=signal.SIGTERM, after=2.0),
]
"""Those of `run`, `record`, `replay` and `hand` come at random moments, in `signal_cases`."""

MISTAKES = {
    "ros": [
        Abuse("absent parameter file", f"{RUN} --params @/none.yaml", {1}, "none.yaml: No such file"),
        Abuse("parameter file of no nodes", f"{RUN} --params @/flat.yaml", {1}, "holds no ros__parameters"),
        Abuse("unwritable dataset", "record -o /proc/none/set --seconds 1", {1}, "/proc/none/set: No such"),
        Abuse("full disk, JSON", f"{RUN} --count 2", {1}, "output: No space left", stdout="/dev/full"),
        Abuse("closed pipe, live", f"{RUN} --count 20", {0}, head=True),
    ],
    "files": [
        Abuse("no cloud at all", "segment @/junk.pcd @/empty.mcap @ @/none", {1}, "junk.pcd: header"),
        Abuse("full disk, simulation", SIMULATE, {1}, "store: cannot be written: File too large", limit=20_000),
        Abuse("full disk, export", "dataset export @/set -o %/out --format npz", {1}, "File too large", limit=2_000),
        Abuse("closed stdout", "grasp @/scene.npz --json", {0}, stdout="closed"),
        Abuse("locale without UTF-8", "predict @/object.pcd @/scene.npz", {0}, env=ASCII),
        Abuse("dumb terminal", "models", {0}, env={"TERM": "dumb"}),
    ],
}


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    write_scenes(folder / "recording", 40)
    cloud = scene_cloud(3, objects=2, width=424)
    write_cloud(folder / "scene.npz", cloud)
    write_cloud(folder / "object.pcd", Cloud(cloud.xyz[100:140, 200:240].reshape(-1, 3)))
    write_dataset(folder / "set", 8, points=100)
    (folder / "junk.pcd").write_bytes(bytes(range(256)))
    (folder / "empty.mcap").touch()
    (folder / "flat.yaml").write_text("queue_depth: 3\n")
    return folder


@pytest.fixture
def start(files) -> Callable[[Abuse, Path], subprocess.Popen[bytes]]:
    """Starts a command as the leader of a session of its own, as a terminal does, in a DDS domain of these tests."""
    environment = {**process_environment(), "TERM": "xterm"}

    def run(abuse: Abuse, folder: Path) -> subprocess.Popen[bytes]:
        words = [word.replace("@", str(files), 1).replace("%", str(folder), 1) for word in abuse.words.split()]
        command = [sys.executable, "-m", "foretouch.cli.main", *words]
        if abuse.stdout == "closed":
            command = ["sh", "-c", 'exec "$@" >&- <&-', "sh", *command]
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=os.open(abuse.stdout, os.O_WRONLY) if abuse.stdout.startswith("/") else subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**environment, **abuse.env},
            start_new_session=True,
            bufsize=0,  # or `readline` would take more than a line, which `communicate` then lacks
        )
        if abuse.limit is not None:
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (abuse.limit, abuse.limit))
        return process

    return run


def wait_for(abuse: Abuse, process: subprocess.Popen[bytes]) -> None:
    """Wait for the moment of the signal: until the command catches signals, and then as long as is said."""
    end = time.monotonic() + PATIENCE_S
    while process.poll() is None and not signal_cases.catches(process.pid):
        assert time.monotonic() < end
        time.sleep(0.002)
    time.sleep(abuse.after)


def check_end(abuse: Abuse, process: subprocess.Popen[bytes], out: bytes, err: str) -> None:
    assert process.returncode in abuse.status, f"exit status {process.returncode}: {err}"
    for word in ("Traceback", "Exception ignored", "Error in", "terminate called"):
        assert word not in err, err
    assert abuse.line in err, err
    lines = [line for line in err.splitlines() if line.startswith("foretouch: ")]
    assert bool(lines) >= (process.returncode > 0), err
    assert len(lines) <= 5, err
    end = time.monotonic() + 20.0
    while left := list(signal_cases.members(process.pid)):
        assert time.monotonic() < end, left
        time.sleep(0.05)
    if "--json" in abuse.words:
        assert all(isinstance(json.loads(line), dict) for line in out.splitlines())


def test_a_signal_at_any_moment_ends_it_in_order(start, tmp_path) -> None:
    def check(abuse: Abuse) -> None:
        folder = tmp_path / abuse.name
        folder.mkdir()
        process = start(abuse, folder)
        wait_for(abuse, process)
        for _ in range(2):  # a second Ctrl-C, as a person sends it, if a library has lost the first
            if process.poll() is None:
                send = os.killpg if abuse.number == signal.SIGINT else os.kill
                send(process.pid, abuse.number)
            try:
                out, err = process.communicate(timeout=PATIENCE_S / 2)
                break
            except subprocess.TimeoutExpired:
                continue
        else:
            os.killpg(process.pid, signal.SIGKILL)
            pytest.fail(f"did not end: {process.communicate()[1].decode()}")
        check_end(abuse, process, out, err.decode())
        hidden = [path.name for path in folder.iterdir() if path.name.startswith(".")]
        assert hidden == [], "a half-written output is left"

    every_case({one.name: one for one in SIGNALS}, check)


@pytest.mark.ros
@pytest.mark.parametrize("name", signal_cases.COMMANDS)
def test_signals_at_random_moments_leave_no_process_no_shared_memory_and_no_open_recording(name, tmp_path) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    rng, scenes = np.random.default_rng(7), signal_cases.write_clouds(tmp_path)
    for _ in range(int(os.environ.get("FORETOUCH_SIGNALS", "3"))):
        assert signal_cases.fault_of(name, rng, scenes, process_environment()) == ""


@pytest.mark.ros
@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_or_a_fault_outside_is_told_in_one_line(kind, start, tmp_path) -> None:
    if kind == "ros":
        pytest.importorskip("rclpy", reason="ROS 2 is not installed")

    def check(abuse: Abuse) -> None:
        folder = tmp_path / abuse.name
        folder.mkdir()
        process, out = start(abuse, folder), b""
        if abuse.head:
            assert process.stdout is not None
            assert process.stderr is not None
            assert process.stdout.readline()
            process.stdout.close()
            err = process.stderr.read()
            process.wait(PATIENCE_S)
        else:
            out, err = process.communicate(timeout=PATIENCE_S)
        check_end(abuse, process, out or b"", err.decode())

    every_case({one.name: one for one in MISTAKES[kind]}, check)
