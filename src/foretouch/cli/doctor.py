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
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from importlib import metadata
from typing import Literal

from packaging.requirements import Requirement

from foretouch.cli.output import announce, print_json, print_table
from foretouch.errors import ForetouchError, MissingDependencyError
from foretouch.processes import ONE_THREAD
from foretouch.ros.runtime.environment import FAST_DDS, large_clouds

_State = Literal["ok", "mismatch", "missing", "broken", "optional"]
_PATIENCE_S = 120.0  # of one check in a process of its own; the longest takes 6 s on an idle machine
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
    parser.add_argument("--self-test", action="store_true", help="also run the shipped models and ROS on this machine")


def run(arguments: argparse.Namespace) -> int:
    """Return exit status 1 if something is missing, broken or of another version."""
    announce("importing the libraries and loading the models")
    findings = list(_examine())
    if arguments.self_test:
        findings += _self_test(
            skipped={finding.name for finding in findings if finding.state not in {"ok", "optional"}}
        )
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


def _self_test(skipped: Collection[str]) -> Iterator[_Finding]:
    """Run the models and, unless it cannot be loaded, ROS, each in a process of its own."""
    reinstall = "pip install --force-reinstall foretouch"
    yield _tried(
        "models answer as expected", "from foretouch.cli.selftest import check_models; check_models()", reinstall
    )
    if not any(" loads" in name for name in skipped):
        code = "from foretouch.cli.selftest import check_ros; check_ros()"
        yield _tried("a node answers over DDS", code, "see the checks of rclpy, foretouch_msgs and shared memory")


def _examine() -> Iterator[_Finding]:
    """Run all checks, the fastest first."""
    old, version = sys.version_info < (3, 11), platform.python_version()
    fix = "make setup PYTHON=python3.11" if old else ""
    yield _Finding("Python", "mismatch" if old else "ok", f"{version} {platform.machine()}", fix)
    yield from _requirements()
    yield from _imports()
    yield from _own_parts()


def _requirements() -> Iterator[_Finding]:
    """Compare the requirements of setup.cfg with what is installed."""
    other_ros = {"kilted": {"ros"}, "jazzy": {"kilted"}}.get(_wheels_of_ros(), {"ros", "kilted"})
    for line in metadata.requires("foretouch") or []:
        extra = match[1] if (match := _EXTRA.search(line)) else None
        if extra not in {"test", "dev", "docs", *other_ros}:
            yield _requirement(Requirement(line), extra)


def _wheels_of_ros() -> str:
    """The distribution of ROS 2 whose wheels run, "jazzy" where none is installed; "" beside a ROS 2 of its own."""
    if os.environ.get("ROS_DISTRO"):
        return ""
    installed = {one.name for one in metadata.distributions()}
    return "kilted" if "ros-rclpy" in installed and "ros-jazzy-rclpy" not in installed else "jazzy"


def _requirement(requirement: Requirement, extra: str | None) -> _Finding:
    name, wanted = requirement.name, requirement.specifier
    fix = f"pip install '{name}{wanted}'"
    try:
        found = metadata.version(name)
    except metadata.PackageNotFoundError:
        return _Finding(name, "missing" if extra in {None, "ros", "kilted"} else "optional", "absent", fix)
    fits = wanted.contains(found, prereleases=True)
    return _Finding(name, "ok", found) if fits else _Finding(name, "mismatch", f"{found} is not {wanted}", fix)


def _imports() -> Iterator[_Finding]:
    """Import the libraries that may fail to load although they are installed, each in a separate process."""
    preload = "from foretouch.camera.device import ensure_libusb; ensure_libusb()"
    for name, code, fix in (
        ("torch loads", "import torch", "pip install --force-reinstall torch"),
        ("open3d loads", f"{preload}; import open3d", "apt install libgl1 libgomp1 libusb-1.0-0"),
        ("pyrealsense2 loads", f"{preload}; import pyrealsense2", "apt install libusb-1.0-0"),
    ):
        if importlib.util.find_spec(name.split()[0]) is not None:
            yield _tried(name, code, fix)
    prepared = "from foretouch.ros.runtime.environment import prepare_environment; prepare_environment()"
    distro = os.environ.get("ROS_DISTRO") or f"{_wheels_of_ros()}, wheels of PyPI"
    identified = f"{prepared}; import rclpy; print(rclpy.get_rmw_implementation_identifier())"
    loaded = _tried(f"rclpy loads ({distro})", identified, "pip install 'foretouch[ros]'")
    yield loaded
    text, fine = large_clouds(loaded.found if loaded.state == "ok" else FAST_DDS)
    fix = (
        "docker run --shm-size=1g, or --ipc=host"
        if FAST_DDS in text.partition(":")[0]
        else f"RMW_IMPLEMENTATION={FAST_DDS}"
    )
    yield _Finding("large clouds", "ok" if fine else "mismatch", text, "" if fine else fix)
    message = f"{prepared}; from foretouch_msgs.msg import TouchPrediction; TouchPrediction()"
    yield _tried("foretouch_msgs loads", message, "pip install ./foretouch_msgs")
    for name, why in (
        ("launch_ros", "launch files"),
        ("sensor_msgs_py", "comparison in tests"),
        ("sr_robot_msgs", "the messages of Shadow"),
    ):
        present = _tried(name, f"import {name}", "").state == "ok"
        yield _Finding(name, "ok" if present else "optional", "present" if present else f"absent: only for {why}")


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
    message, found = _outcome(code)
    return _Finding(name, "ok", found or "yes") if message is None else _Finding(name, "broken", message, fix)


def _outcome(code: str) -> tuple[str | None, str]:
    """Run code in another process, which may crash; returns the last line of the error, else None, and what it prints."""
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and code
            [sys.executable, "-c", code],
            capture_output=True, text=True, errors="replace", timeout=_PATIENCE_S, check=False,
            env={**os.environ, **ONE_THREAD},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"takes more than {_PATIENCE_S:g} s", ""
    if done.returncode < 0:
        return f"its process ended by {signal.Signals(-done.returncode).name}", ""
    lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
    return lines[-1][:300] if done.returncode else None, done.stdout.strip()
