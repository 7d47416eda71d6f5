# SPDX-License-Identifier: Apache-2.0
"""Send SIGINT, SIGTERM and SIGHUP at random moments to `run`, `record`, `replay` and the node `hand`, and see what is left.

Each must end in time with its status or that of a regular end, and leave no process, no segment of shared memory and no open
recording.
"""

import fcntl
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.errors import FileError

ROOT = Path(__file__).parents[1]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SCENE = ROOT / "config" / "scenes" / "clean.yaml"
PATIENCE_S = 60.0
LATEST_S = 8.0  # after the command catches signals, when all that starts has started also on a busy computer
FAULTS = ("Traceback", "Exception ignored", "terminate called", "Segmentation fault")
_CLI = ("-m", "foretouch.cli.main")
COMMANDS = {
    "run": (*_CLI, "run", "--source", str(SCENE), "--rate", "10", "--json"),
    "record": (*_CLI, "record", "-o", "{folder}/set", "--json"),
    "replay": (*_CLI, "replay", "{scenes}", "--no-wait", "--rate", "2", "--loop", "--json"),
    "hand": ("-c", "import sys; from foretouch.ros.executables import hand; sys.exit(hand())", "--ros-args", "-p",
             f"scene.path:={SCENE}"),
}  # fmt: skip
NO_CLOUD = 3  # of a `run` that ends before its first cloud


def fault_of(name: str, rng: np.random.Generator, scenes: Path, environment: Mapping[str, str]) -> str:
    """Start a command in a session of its own, send it a signal at a moment, and tell what is wrong afterwards; "" if nothing is."""
    number, after_s = SIGNALS[int(rng.integers(len(SIGNALS)))], float(rng.uniform(0.0, LATEST_S))
    with tempfile.TemporaryDirectory() as folder:
        words = [word.format(folder=folder, scenes=scenes) for word in COMMANDS[name]]
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        process = subprocess.Popen([sys.executable, *words], env=environment, cwd=ROOT, start_new_session=True, **pipes)
        while process.poll() is None and not catches(process.pid):
            time.sleep(0.002)
        time.sleep(after_s)
        segments, late = _segments(process.pid), False
        process.send_signal(number)
        try:
            _, error = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            late = True
            os.killpg(process.pid, signal.SIGKILL)
            _, error = process.communicate()
        usual = {0, 128 + number, -number} | ({NO_CLOUD} if name == "run" else set())
        found = [f"exit status {process.returncode}: {error.decode()[-200:]}"] * (process.returncode not in usual)
        found += _faults(process, error.decode(), segments, Path(folder) / "set")
        found += [f"not ended after {PATIENCE_S:.0f} s"] * late
    return "; ".join([f"{number.name} after {after_s:.2f} s", *found]) if found else ""


def _faults(process: "subprocess.Popen[bytes]", error: str, segments: set[Path], dataset: Path) -> Iterator[str]:
    yield from (f"{word}: {error[-300:]}" for word in FAULTS if word in error)
    left = list(members(process.pid))
    yield from (f"left: {line}" for line in left)
    yield from (f"left: {segment}" for segment in segments if segment.exists() and not _locked(segment))
    with suppress(FileError):  # the signal came before there was a dataset
        for report in verify_dataset(dataset):
            if not (report.clean and report.finished):
                yield f"{report.path.name}: is open, or has faults: {report.fault_lines()[:2]}"


def _segments(pid: int) -> set[Path]:
    """Segments of shared memory that a process has mapped, without those of ports, which the next process takes over."""
    try:
        maps = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")
    except OSError:
        return set()
    return {
        Path(one) for one in re.findall(r"(/dev/shm/fast(?:dds|rtps)_\S+)$", maps, re.MULTILINE) if "_port" not in one
    }


def _locked(segment: Path) -> bool:
    """Whether a segment is of another process, which lives: Fast DDS keeps a lock beside it."""
    with suppress(OSError), segment.with_name(f"{segment.name}_el").open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def catches(pid: int) -> bool:
    """Whether a process catches SIGHUP, which Python alone does not: before, a signal ends the interpreter as it likes."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return False
    (mask,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(mask, 16) >> (signal.SIGHUP - 1) & 1)


def members(session: int) -> Iterator[str]:
    """Command lines of the processes of a session."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, leader = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(leader) == session and state != "Z":
                yield (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # it has ended meanwhile
            continue


def write_clouds(folder: Path) -> Path:
    """Three clouds of a scene, as a folder that can be replayed."""
    from foretouch.cloud.io.files import read_cloud, write_cloud

    cloud = read_cloud(ROOT / "examples" / "data" / "table.npz")
    for number in range(3):
        write_cloud(folder / f"{number}.npz", cloud)
    return folder
