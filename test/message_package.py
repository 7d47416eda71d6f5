# SPDX-License-Identifier: Apache-2.0
"""A package of messages that a test builds as `foretouch_msgs` is built, once for each content, Python and release of ROS, and uses in this process."""

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import pytest

_OURS = Path(__file__).parents[1] / "foretouch_msgs"
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "foretouch"
_CMAKE = """cmake_minimum_required(VERSION 3.20)
project({package})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}} {files})
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""
# Each library needs those before it; rclpy finds them by their names once they are loaded.
_LIBRARIES = ("generator_c", "typesupport_fastrtps_cpp", "typesupport_fastrtps_c", "typesupport_introspection_c",
              "typesupport_c", "generator_py")  # fmt: skip


def use_package(definitions: Mapping[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Build the types of one package, texts by name such as `xela_server_ros2/msg/Taxel`, so that they can be imported.

    A skip if they cannot be built here, such as without a compiler or a network.
    """
    package = next(iter(definitions)).partition("/")[0]
    release = [(name, metadata.version(name)) for name in ("ros-fastcdr", "ros-rosidl-generator-py")]  # it is linked to
    content = (sorted(definitions.items()), sys.implementation.cache_tag, release)
    key = hashlib.sha256(repr(content).encode()).hexdigest()[:16]
    prefix = _CACHE / f"{package}-{key}"
    if not prefix.is_dir():
        _build(package, definitions, prefix)
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join([str(prefix), os.environ.get("AMENT_PREFIX_PATH", "")]))
    monkeypatch.syspath_prepend(next(prefix.glob("lib/python*/site-packages")))
    for name in _LIBRARIES:
        ctypes.CDLL(str(prefix / f"lib/lib{package}__rosidl_{name}.so"), ctypes.RTLD_GLOBAL)


def _build(package: str, definitions: Mapping[str, str], prefix: Path) -> None:
    folder = prefix.with_name(f"{prefix.name}.{os.getpid()}")
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "source/msg").mkdir(parents=True)
    shutil.copytree(_OURS / "pip", folder / "source/pip")
    files = [name.partition("/")[2] + ".msg" for name in definitions]
    for file, text in zip(files, definitions.values(), strict=True):
        (folder / "source" / file).write_text(text)
    (folder / "source/CMakeLists.txt").write_text(
        _CMAKE.format(package=package, files=" ".join(f'"{one}"' for one in files))
    )
    own = {
        name: (_OURS / name).read_text().replace("foretouch_msgs", package)
        for name in ("package.xml", "pyproject.toml")
    }
    own["package.xml"] = re.sub(r" *<(depend|ros1_bridge).*\n", "", own["package.xml"])
    own["pyproject.toml"] = re.sub(r"\ndependencies = \[.*?\]\n", "\n", own["pyproject.toml"], flags=re.DOTALL)
    for name, text in own.items():
        (folder / "source" / name).write_text(text)
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--quiet", "--no-deps", "-w"]
    done = subprocess.run(
        [*command, str(folder), str(folder / "source")], capture_output=True, text=True, check=False, timeout=540.0
    )
    wheel = next(folder.glob("*.whl"), None)
    if wheel is None:
        shutil.rmtree(folder)
        pytest.skip(f"{package} cannot be built here: {done.stderr.strip().splitlines()[-1:]}")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "wheel")
    with suppress(OSError):  # another process has built it meanwhile
        next(folder.glob("wheel/*.data/data")).rename(prefix)
    shutil.rmtree(folder)
