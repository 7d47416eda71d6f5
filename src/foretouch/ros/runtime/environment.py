# SPDX-License-Identifier: Apache-2.0
"""Environment variables and limits of memory that must be set before NumPy and rclpy are imported, and the start of rclpy.

The user's own are never changed.
"""

import ctypes
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import mkdtemp

from foretouch.errors import ConfigError
from foretouch.interrupts import uninterrupted
from foretouch.processes import ONE_THREAD
from foretouch.ros.runtime.shared_memory import large_clouds, stale_bytes

SHARED_MEMORY_PROFILE = Path(__file__).with_name("fastdds_shared_memory.xml")
"""Fast DDS with a 64 MB segment: with the default of 0.5 MB most clouds between processes are lost."""

_PROFILE_VARIABLES = {"fastdds": "FASTDDS_DEFAULT_PROFILES_FILE", "fastrtps": "FASTRTPS_DEFAULT_PROFILES_FILE"}


def prepare_environment() -> None:
    """Set what is missing: the ament index, the shared-memory profile, one thread for linear algebra, large blocks kept.

    The matrices here are small: with a pool of threads, a plane fit waits for the other threads longer than
    it computes (8 ms against 0.6 ms on a loaded two-core machine).
    """
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)  # wheels of PyPI install into the Python prefix
    if not any(name in os.environ for name in _PROFILE_VARIABLES.values()):
        os.environ[profile_variable()] = str(SHARED_MEMORY_PROFILE)
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    _keep_large_blocks()


def profile_variable() -> str:
    """The environment variable that names the profile: Fast DDS 2 (Jazzy) ignores that of 3, and 3 warns of that of 2."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", sys.prefix).split(os.pathsep)
    return _PROFILE_VARIABLES[
        "fastrtps" if any(Path(one, "share", "fastrtps").is_dir() for one in prefixes) else "fastdds"
    ]


def start_rclpy(arguments: Sequence[str]) -> None:
    """Prepare the environment and call `rclpy.init`, without signal handlers; a `ConfigError` if an argument is malformed.

    Where large clouds may be lost between processes, a warning says so once.
    """
    prepare_environment()
    stale_bytes(free=True)
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
    from rclpy.logging import get_logger
    from rclpy.signals import SignalHandlerOptions

    with uninterrupted():
        try:
            _name_log_folder()
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        except (RCLError, ValueError, UnknownROSArgsError) as err:
            rclpy.try_shutdown()
            rule = "unknown: " if isinstance(err, UnknownROSArgsError) else ""
            raise ConfigError(f"ROS arguments: {rule}{' '.join(str(err).split())}") from err
        text, pass_on = large_clouds(rclpy.utilities.get_rmw_implementation_identifier())
        if not pass_on:
            get_logger("foretouch").warning(f"{text}; foretouch doctor names a fix")


def _name_log_folder() -> None:
    """Give ROS another folder for its logs where the user has no home, or one that cannot be written."""
    if any(name in os.environ for name in ("ROS_LOG_DIR", "ROS_HOME")):
        return
    home = Path(os.environ.get("HOME") or "/", ".ros", "log")
    exists = next(path for path in (home, *home.parents) if path.exists())
    if not os.environ.get("HOME") or not exists.is_dir() or not os.access(exists, os.W_OK):
        os.environ["ROS_LOG_DIR"] = mkdtemp(prefix="foretouch-log-")


def _keep_large_blocks() -> None:
    """Let glibc keep the memory of a cloud for the next: new pages made receiving four times as expensive.

    One arena for all threads, or each thread that ever takes a cloud keeps memory of its own for the next one.
    """
    set_limit = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if set_limit is None or any(name.startswith(("MALLOC_", "GLIBC_TUNABLES")) for name in os.environ):
        return
    # M_MMAP_THRESHOLD, at its maximum, M_TRIM_THRESHOLD, and M_ARENA_MAX.
    for parameter, value in ((-3, 32 << 20), (-1, 128 << 20), (-8, 1)):
        set_limit(parameter, value)
