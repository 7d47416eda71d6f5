# SPDX-License-Identifier: Apache-2.0
"""`foretouch doctor`: check dependencies and print the fixes.

The required versions are read from the metadata of the installed package, so that they are declared only in setup.cfg;
the ones that the tests run with stand in constraints.txt.
"""

import argparse
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import metadata
from typing import Literal

from packaging.requirements import Requirement

from foretouch.cli.output import announce, print_json, print_table, print_text, progress_bar
from foretouch.errors import ForetouchError, MissingDependencyError
from foretouch.ros.runtime.shared_memory import stale_bytes

_State = Literal["ok", "mismatch", "missing", "broken", "optional"]
_EXTRA = re.compile(r"extra == ['\"](\w+)['\"]")


@dataclass(frozen=True)
class _Finding:
    """The result of one check."""

    name: str  # what was checked
    state: _State  # "ok", "mismatch" (may work), "missing", "broken", or "optional" (absent, and needed by few)
    found: str  # what was found
    fix: str = ""  # the command that fixes it, else ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--all", action="store_true", help="also show the checks that passed")
    parser.add_argument(
        "--self-test",
        nargs="*",
        metavar="ROW",
        help="run the shipped models and ROS on this machine; or only one of the rows models, ROS",
    )


def run(arguments: argparse.Namespace) -> int:
    """Return exit status 1 if something is missing, broken or of another version, or fails in the self-test."""
    if arguments.self_test is not None:
        return _self_test(arguments.self_test, as_json=arguments.json)
    announce("importing the libraries and loading the models")
    findings = list(_examine())
    problems = [finding for finding in findings if finding.state not in {"ok", "optional"}]
    if arguments.json:
        for finding in findings:
            print_json({**asdict(finding), "mend": finding.fix})  # `mend` is the old name of `fix`
        return int(bool(problems))
    shown = findings if arguments.all else [f for f in findings if f.state != "ok"]
    if shown:
        print_table(
            "foretouch doctor", ["check", "state", "found", "fix"], [[f.name, f.state, f.found, f.fix] for f in shown]
        )
    print(f"{len(findings)} checks, {len(problems)} to fix")
    return int(bool(problems))


def _self_test(names: Sequence[str], *, as_json: bool) -> int:
    from foretouch.cli.selftest import ROWS, run_rows

    began = time.monotonic()
    results = []
    with progress_bar("", total=len(names or ROWS), hidden=as_json, transient=True) as update:
        for result in run_rows(names or list(ROWS)):
            results.append(result)
            update(description=result.row)
            if as_json:
                print_json(asdict(result))
    failed = [one for one in results if one.state == "failed"]
    if not as_json:
        rows = [[one.row, one.state, one.found, f"{one.seconds:.1f} s"] for one in results]
        print_table("foretouch doctor --self-test", ["row", "state", "found", "time"], rows)
        for one in failed:
            print_text(f"{one.row}: {one.cause}\n  fix: {one.fix}")
        print(f"{len(results)} rows, {len(failed)} failed, {time.monotonic() - began:.0f} s")
    return int(bool(failed))


def _examine() -> Iterator[_Finding]:
    """Run all checks, the fastest first."""
    old, version = sys.version_info < (3, 11), platform.python_version()
    fix = "make setup PYTHON=python3.11" if old else ""
    yield _Finding("Python", "mismatch" if old else "ok", f"{version} {platform.machine()}", fix)
    yield from _requirements()
    yield from _imports()
    yield _shared_memory()
    yield from _own_parts()


def _requirements() -> Iterator[_Finding]:
    """Compare the requirements of setup.cfg with what is installed."""
    other_ros = {"kilted": {"jazzy"}, "jazzy": {"ros"}}.get(_wheels_of_ros(), {"ros", "jazzy"})
    for line in metadata.requires("foretouch") or []:
        extra = match[1] if (match := _EXTRA.search(line)) else None
        if extra not in {"test", "dev", "docs", *other_ros}:
            yield _requirement(Requirement(line), extra)


def _wheels_of_ros() -> str:
    """The distribution of ROS 2 whose wheels run, "kilted" where none is installed; "" beside a ROS 2 of its own."""
    if os.environ.get("ROS_DISTRO"):
        return ""
    try:
        return "jazzy" if metadata.version("ros-rclpy").startswith("7.") else "kilted"
    except metadata.PackageNotFoundError:
        return "kilted"


def _requirement(requirement: Requirement, extra: str | None) -> _Finding:
    name, wanted = requirement.name, requirement.specifier
    fix = f"pip install '{name}{wanted}'"
    try:
        found = metadata.version(name)
    except metadata.PackageNotFoundError:
        return _Finding(name, "missing" if extra in {None, "ros", "jazzy"} else "optional", "absent", fix)
    fits = wanted.contains(found, prereleases=True)
    return _Finding(name, "ok", found) if fits else _Finding(name, "mismatch", f"{found} is not {wanted}", fix)


def _imports() -> Iterator[_Finding]:
    """Import the libraries that may fail to load although they are installed, each in a separate process."""
    preload = "from foretouch.camera.libusb import ensure_libusb; ensure_libusb()"
    for name, code, fix in (
        ("torch loads", "import torch", "pip install --force-reinstall torch"),
        ("open3d loads", f"{preload}; import open3d", "apt install libgl1 libgomp1 libusb-1.0-0"),
        ("pyrealsense2 loads", f"{preload}; import pyrealsense2", "apt install libusb-1.0-0"),
    ):
        if importlib.util.find_spec(name.split()[0]) is not None:
            yield _tried(name, code, fix)
    prepared = "from foretouch.ros.runtime.environment import prepare_environment; prepare_environment()"
    distro = os.environ.get("ROS_DISTRO") or f"{_wheels_of_ros()}, wheels of PyPI"
    yield _tried(f"rclpy loads ({distro})", f"{prepared}; import rclpy", "pip install 'foretouch[ros]'")
    message = f"{prepared}; from foretouch_msgs.msg import TouchPrediction; TouchPrediction()"
    yield _tried("foretouch_msgs loads", message, "pip install ./foretouch_msgs")
    for name, why in (
        ("launch_ros", "launch files"),
        ("sensor_msgs_py", "comparison in tests"),
        ("sr_robot_msgs", "the messages of Shadow"),
    ):
        present = _failure(f"import {name}") is None
        yield _Finding(name, "ok" if present else "optional", "present" if present else f"absent: only for {why}")


def _shared_memory() -> _Finding:
    try:
        free_mb = shutil.disk_usage("/dev/shm").free / 1e6  # noqa: S108 - DDS puts its segments there
    except OSError:
        return _Finding("shared memory", "missing", "no /dev/shm", "docker run --ipc=host, or --shm-size=1g")
    found = f"{free_mb:.0f} MB free"
    if (stale_mb := stale_bytes() / 1e6) > 0.0:
        found += f"; {stale_mb:.0f} MB of processes that were killed, which the next node frees"
    if free_mb + stale_mb >= 256:  # three segments of 64 MB and a reserve
        return _Finding("shared memory", "ok", found)
    return _Finding("shared memory", "mismatch", found, "docker run --shm-size=1g")


def _own_parts() -> Iterator[_Finding]:
    """The compiled kernels, the released models, which are compared with their cards, and the camera."""
    kernels = _checked("compiled kernels", "mismatch", "apt install gcc, then install foretouch again", _load_kernels)
    yield kernels
    if kernels.state != "ok":
        return
    from foretouch.models import DEFAULT_MODEL, available_models

    for name in available_models():  # the default first
        what = "default model" if name == DEFAULT_MODEL else f"model {name}"
        yield _checked(what, "broken", "pip install --force-reinstall foretouch", partial(_load_model, name))
    yield _checked("RealSense", "optional", "", _list_cameras)


def _load_kernels() -> str:
    import foretouch.kernels  # noqa: F401

    return "loaded"


def _load_model(name: str) -> str:
    from foretouch.models import load_model

    model = load_model(name)
    intervals = "with intervals" if model.calibration is not None else "without intervals and online adaptation"
    return f"{model.name} {model.sha256[:12]} {intervals}"


def _list_cameras() -> str:
    from foretouch.camera.device import list_devices

    found = list_devices()
    if not found:
        raise MissingDependencyError("no RealSense device is connected")
    return ", ".join(found)


def _checked(name: str, otherwise: _State, fix: str, check: Callable[[], str]) -> _Finding:
    """What a function returns, or in another state the error that it raises."""
    try:
        return _Finding(name, "ok", check())
    except (ForetouchError, ImportError) as err:
        return _Finding(name, otherwise, str(err), fix)


def _tried(name: str, code: str, fix: str) -> _Finding:
    message = _failure(code)
    return _Finding(name, "ok", "yes") if message is None else _Finding(name, "broken", message, fix)


def _failure(code: str) -> str | None:
    """Run code in another process, which may crash; returns the last line of the error, else None."""
    done = subprocess.run(  # noqa: S603 - our own interpreter and code
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
    return lines[-1] if done.returncode else None
