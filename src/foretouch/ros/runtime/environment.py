# SPDX-License-Identifier: Apache-2.0
"""What a process of foretouch sets for itself before NumPy and rclpy are imported, and the start of rclpy.

Importing or activating a node changes nothing of this: commands and executables call it. The user's own variables are never changed. And the shared memory of Fast DDS: whether large clouds pass through it between processes, and
what one that was killed leaves behind, about 67 MB with our profile. Fast DDS holds a lock on `<segment>_el` as long as the owner
of a segment lives, which `fastdds shm clean` tests too.
"""

import fcntl
import os
import shutil
import stat
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from tempfile import mkdtemp
from typing import Final

from foretouch.base.interrupts import uninterrupted
from foretouch.base.processes import ONE_THREAD
from foretouch.errors import ConfigError

SHARED_MEMORY_PROFILE = Path(__file__).with_name("fastdds_shared_memory.xml")
"""Fast DDS with a 64 MB segment: with the default of 0.5 MB most clouds between processes are lost."""
_FOLDER: Final = Path("/dev/shm")  # noqa: S108  where Fast DDS puts its segments
_LOCK: Final = "_el"
_NEEDED_MB: Final = 256.0  # three segments of 64 MB and a reserve; Docker gives 64 MB
FAST_DDS: Final = "rmw_fastrtps_cpp"
"""The middleware that foretouch is tested with, and that its shared-memory profile is for."""

_LAST_DOMAIN: Final = 232

_PROFILE_VARIABLES = {"fastdds": "FASTDDS_DEFAULT_PROFILES_FILE", "fastrtps": "FASTRTPS_DEFAULT_PROFILES_FILE"}


def wheels_of_ros() -> str:
    """Return the release of ROS 2 whose wheels of PyPI are installed, such as "jazzy"; "" without."""
    releases = {"ros-rclpy": "kilted", "ros-jazzy-rclpy": "jazzy"}
    return next((releases[wheel.name] for wheel in metadata.distributions() if wheel.name in releases), "")


def check_variables() -> None:
    """Refuse variables of ROS with which loading or starting rclpy ends the process.

    Raises:
        ConfigError: Names the variable: a domain that Fast DDS has no ports for, or a middleware that wheels of PyPI lack.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (domain.isdecimal() and int(domain) <= _LAST_DOMAIN):
        raise ConfigError(f"ROS_DOMAIN_ID: {domain!r} is not a whole number from 0 to {_LAST_DOMAIN}")
    middleware = os.environ.get("RMW_IMPLEMENTATION") or FAST_DDS
    if middleware != FAST_DDS and wheels_of_ros():
        rule = f"ROS 2 from PyPI has {FAST_DDS} alone: unset RMW_IMPLEMENTATION in this terminal"
        raise ConfigError(f"RMW_IMPLEMENTATION: {middleware!r} is not installed; {rule}")


def prepare_environment() -> None:
    """Set what is missing: the ament index, the shared-memory profile, one thread for linear algebra.

    The matrices here are small: with a pool of threads, a plane fit waits for the other threads longer than
    it computes (8 ms against 0.6 ms on a loaded two-core machine).
    """
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)  # wheels of PyPI install into the Python prefix
    if not any(name in os.environ for name in _PROFILE_VARIABLES.values()):
        os.environ[profile_variable()] = str(SHARED_MEMORY_PROFILE)
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)


def profile_variable() -> str:
    """Choose the environment variable that names the profile: Fast DDS 2 (Jazzy) and 3 have different ones."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", sys.prefix).split(os.pathsep)
    return _PROFILE_VARIABLES[
        "fastrtps" if any(Path(prefix, "share", "fastrtps").is_dir() for prefix in prefixes) else "fastdds"
    ]


def start_rclpy(arguments: Sequence[str]) -> None:
    """Prepare the environment and call `rclpy.init`, without signal handlers; a `ConfigError` if an argument is malformed.

    Where large clouds may be lost between processes, a warning says so once.
    """
    prepare_environment()
    import rclpy
    from rclpy.logging import get_logger
    from rclpy.signals import SignalHandlerOptions

    with uninterrupted():
        try:
            _name_log_folder()
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        except Exception as err:  # rclpy declares no public type for what it raises here
            rclpy.try_shutdown()
            rule = "unknown: " if type(err).__name__ == "UnknownROSArgsError" else ""
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


def large_clouds(rmw: str, folder: Path = _FOLDER) -> tuple[str, bool]:
    """Describe how large clouds pass between processes, and whether that is known to lose none.

    Args:
        rmw: Name of the middleware.
        folder: Of shared memory.
    """
    if rmw != FAST_DDS:
        return f"{rmw}: not tested; the shared-memory profile of foretouch is for {FAST_DDS} (docs/install.md)", False
    try:
        usage = shutil.disk_usage(folder)
    except OSError:
        return f"{rmw}: there is no {folder}: clouds go by UDP, and large ones are lost", False
    free_mb, stale_mb = usage.free / 1e6, stale_bytes(folder) / 1e6
    state = f"{rmw}: {free_mb:.0f} of {usage.total / 1e6:.0f} MB of {folder} are free"
    if stale_mb > 0.0:
        state += f"; {stale_mb:.0f} MB of processes that were killed, which the next node frees"
    if free_mb + stale_mb >= _NEEDED_MB:
        return state, True
    return f"{state}, {_NEEDED_MB:g} are needed: clouds go by UDP, and large ones are lost", False


def stale_bytes(folder: Path = _FOLDER, *, free: bool = False) -> int:
    """Sum the sizes of the segments of this user whose processes have ended [bytes].

    Args:
        folder: Of shared memory.
        free: Whether these segments are removed.
    """
    total = 0
    for lock in [*folder.glob(f"fastdds_*{_LOCK}"), *folder.glob(f"fastrtps_*{_LOCK}")]:
        segment = lock.with_name(lock.name.removesuffix(_LOCK))
        with suppress(OSError), _unlocked(lock):  # one in use, of another user, or gone meanwhile
            if "_port" not in segment.name:  # which the next process takes over
                total += segment.stat().st_size
                if free:
                    segment.unlink()
                    lock.unlink()
    return total


@contextmanager
def _unlocked(lock: Path) -> Iterator[None]:
    """Hold a lock; an OSError if another process holds it, or the file is a link, no regular file or of another user."""
    # Without waiting: anyone may put a FIFO there.
    descriptor = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        status = os.fstat(descriptor)
        if status.st_uid != os.getuid() or not stat.S_ISREG(status.st_mode):
            raise PermissionError(f"{lock}: is of another user, or no regular file")
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)
