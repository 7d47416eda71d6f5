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
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from typing import Literal

from packaging.requirements import Requirement

from foretouch.base.processes import ONE_THREAD
from foretouch.cli.output import announce, print_json, print_table
from foretouch.cli.parser import CommandParser
from foretouch.errors import ConfigError, ForetouchError
from foretouch.ros.runtime.environment import FAST_DDS, check_variables, large_clouds, wheels_of_ros

_PATIENCE_S = 120.0  # of one check in its own process; the longest takes 6 s on an idle machine
_EXTRA = re.compile(r"extra == ['\"](\w+)['\"]")
_REINSTALL = "pip install --force-reinstall foretouch"
_LIBUSB = "from foretouch.camera.device import ensure_libusb; ensure_libusb()"
_ROS = "from foretouch.ros.runtime.environment import prepare_environment; prepare_environment()"
_LIBRARIES = (
    ("torch", "import torch", "pip install --force-reinstall torch"),
    ("open3d", f"{_LIBUSB}; import open3d", "apt install libgl1 libgomp1 libusb-1.0-0"),
    ("pyrealsense2", f"{_LIBUSB}; import pyrealsense2", "apt install libusb-1.0-0"),
)
"""Libraries that may fail to load although they are installed, the code that loads them, and the fix."""


@dataclass(frozen=True)
class _Finding:
    """The result of one check."""

    name: str  # what was checked
    state: Literal["ok", "mismatch", "missing", "broken", "optional"]  # mismatch: may work; optional: needed by few
    found: str  # what was found
    fix: str = ""  # the command that fixes it, else ""


def add_arguments(parser: CommandParser) -> None:
    """Declare the options."""
    parser.add_argument("--all", action="store_true", help="also show the checks that passed")
    parser.add_argument("--self-test", action="store_true", help="also run the shipped models and ROS on this machine")


def run(arguments: argparse.Namespace) -> int:
    """Return exit status 1 if something is missing, broken or of another version."""
    announce("importing the libraries and loading the models")
    findings = [*_requirements(), *_libraries(), *_own_parts(), *_added_parts()]
    if arguments.self_test:
        code = "from foretouch.cli import selftest; selftest.check_"
        findings.append(_tried("models answer as expected", f"{code}models()", _REINSTALL))
        if all(finding.state == "ok" for finding in findings if finding.name == "ROS 2" or " loads" in finding.name):
            fix = "see the checks of rclpy, foretouch_msgs and shared memory"
            findings.append(_tried("a node answers over DDS", f"{code}ros()", fix))
    problems = [finding for finding in findings if finding.state not in {"ok", "optional"}]
    if arguments.json:
        for finding in findings:
            print_json(asdict(finding))
        return int(bool(problems))
    if shown := [finding for finding in findings if arguments.all or finding.state != "ok"]:
        print_table(
            "foretouch doctor", ["check", "state", "found", "fix"], [[*asdict(finding).values()] for finding in shown]
        )
    optional = sum(finding.state == "optional" for finding in findings)
    print(f"{len(findings)} checks, {len(problems)} to fix, {optional} optional")
    return int(bool(problems))


def _added_parts() -> Iterator[_Finding]:
    """List what other packages add by entry points."""
    for package in metadata.distributions():
        parts = [entry for entry in package.entry_points if entry.group.startswith("foretouch.")]
        if parts and package.name != "foretouch":
            names = [f"{entry.group.partition('.')[2]} {entry.name}" for entry in parts]
            yield _Finding(f"parts of {package.name}", "ok", ", ".join(names))


def _requirements() -> Iterator[_Finding]:
    """Compare Python and the requirements of setup.cfg with what is installed; whether ROS loads is tried below.

    A package that several extras name is checked once; what an extra lacks is one optional finding.
    """
    old, version = sys.version_info < (3, 11), platform.python_version()
    fix = "make setup PYTHON=python3.11" if old else ""
    yield _Finding("Python", "mismatch" if old else "ok", f"{version} {platform.machine()}", fix)
    present: dict[str, _Finding] = {}
    absent: dict[str, list[str]] = {}
    for line in metadata.requires("foretouch") or []:
        extra = match[1] if (match := _EXTRA.search(line)) else ""
        if extra in {"test", "dev", "docs", "ros", "kilted"}:
            continue
        finding = _requirement(Requirement(line))
        if extra and finding.state == "missing":
            absent.setdefault(extra, []).append(finding.name)
        else:
            present[finding.name] = finding
    yield from present.values()
    for extra, names in absent.items():
        yield _Finding(f"extra {extra}", "optional", f"absent: {', '.join(names)}", f"pip install 'foretouch[{extra}]'")


def _requirement(requirement: Requirement) -> _Finding:
    name, wanted = requirement.name, requirement.specifier
    fix = f"pip install '{name}{wanted}'"
    try:
        installed = metadata.version(name)
    except metadata.PackageNotFoundError:
        return _Finding(name, "missing", "absent", fix)
    fits = wanted.contains(installed, prereleases=True)
    return _Finding(name, "ok", installed) if fits else _Finding(name, "mismatch", f"{installed} is not {wanted}", fix)


def _libraries() -> Iterator[_Finding]:
    """Import the libraries that may fail to load, each in a separate process, and look at the shared memory of ROS."""
    for name, code, fix in _LIBRARIES:
        if importlib.util.find_spec(name) is not None:
            yield _tried(f"{name} loads", code, fix)
    if not any(map(importlib.util.find_spec, ("rclpy", "foretouch_msgs"))):
        found = "absent: only for nodes, run and record"
        yield _Finding("ROS 2", "optional", found, "pip install 'foretouch[ros]' ./foretouch_msgs")
        return
    try:
        check_variables()
    except ConfigError as err:
        yield _Finding("ROS 2", "broken", str(err), f"unset {str(err).partition(':')[0]}")
        return
    distro = os.environ.get("ROS_DISTRO") or f"{wheels_of_ros()}, wheels of PyPI"
    identified = f"{_ROS}; import rclpy; print(rclpy.get_rmw_implementation_identifier())"
    loaded = _tried(f"rclpy loads ({distro})", identified, "pip install 'foretouch[ros]'")
    yield loaded
    text, fine = large_clouds(loaded.found if loaded.state == "ok" else FAST_DDS)
    fast = FAST_DDS in text.partition(":")[0]
    fix = "docker run --shm-size=1g, or --ipc=host" if fast else f"RMW_IMPLEMENTATION={FAST_DDS}"
    yield _Finding("large clouds", "ok" if fine else "mismatch", text, "" if fine else fix)
    message = f"{_ROS}; from foretouch_msgs.msg import TouchPrediction; TouchPrediction()"
    yield _tried("foretouch_msgs loads", message, "pip install ./foretouch_msgs")
    for name, why in (("launch_ros", "launch files"), ("sr_robot_msgs", "the messages of Shadow")):
        present = importlib.util.find_spec(name) is not None
        yield _Finding(name, "ok" if present else "optional", "present" if present else f"absent: only for {why}")


def _own_parts() -> Iterator[_Finding]:
    """Check the compiled kernels, the released models, which are compared with their cards, and the camera."""
    try:
        from foretouch.models import available_models, load_model
    except (ForetouchError, ImportError) as err:
        yield _Finding("compiled kernels", "mismatch", str(err), "apt install gcc, then install foretouch again")
        return
    yield _Finding("compiled kernels", "ok", "loaded")
    for name in available_models():
        try:
            yield _Finding(f"model {name}", "ok", load_model(name).sha256[:12])
        except ForetouchError as err:
            yield _Finding(f"model {name}", "broken", str(err), _REINSTALL)
    if importlib.util.find_spec("pyrealsense2") is None:
        return  # the extra that has it is named
    devices = (
        "from foretouch.camera.device import list_devices; print(', '.join(list_devices()) or 'no device is connected')"
    )
    found = _tried("RealSense", devices, "")
    yield found if found.state == "ok" else replace(found, state="optional")


def _tried(name: str, code: str, fix: str) -> _Finding:
    """Run code in another process, which may crash: what it prints, or the last line of its error."""
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and code
            [sys.executable, "-c", code],
            capture_output=True, text=True, errors="replace", timeout=_PATIENCE_S, check=False,
            env={**os.environ, **ONE_THREAD},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return _Finding(name, "broken", f"takes more than {_PATIENCE_S:g} s", fix)
    if done.returncode < 0:
        return _Finding(name, "broken", f"its process ended by {signal.Signals(-done.returncode).name}", fix)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        return _Finding(name, "broken", lines[-1][:300], fix)
    return _Finding(name, "ok", done.stdout.strip() or "yes")
