# SPDX-License-Identifier: Apache-2.0
"""Environment variables and limits of memory that must be set before NumPy and rclpy are imported.

The user's own are never changed.
"""

import ctypes
import os
import sys
from pathlib import Path

from foretouch.processes import ONE_THREAD

SHARED_MEMORY_PROFILE = Path(__file__).with_name("fastdds_shared_memory.xml")
"""Fast DDS with a 64 MB segment: with the default of 0.5 MB most clouds between processes are lost."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # parameters of glibc's `mallopt`
_KEPT_MB = {_M_MMAP_THRESHOLD: 32, _M_TRIM_THRESHOLD: 128}  # the former at its maximum
_PROFILE_VARIABLES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")


def prepare_environment() -> None:
    """Set what is missing: the ament index, the shared-memory profile, one thread for linear algebra, large blocks kept.

    The matrices here are small: with a pool of threads, a plane fit waits for the other threads longer than
    it computes (8 ms against 0.6 ms on a loaded two-core machine).
    """
    if "AMENT_PREFIX_PATH" not in os.environ:  # wheels of PyPI install into the Python prefix
        os.environ["AMENT_PREFIX_PATH"] = sys.prefix
    if not any(name in os.environ for name in _PROFILE_VARIABLES):
        os.environ[_PROFILE_VARIABLES[0]] = str(SHARED_MEMORY_PROFILE)
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    _keep_large_blocks()


def _keep_large_blocks() -> None:
    """Let the allocator use the memory of a cloud again for the next one.

    By default, glibc returns such a block to the system at once. Getting it again, page by page, made receiving a cloud
    of 848x480 four times as expensive. Other allocators have no `mallopt`.
    """
    set_limit = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if set_limit is None or any(name.startswith(("MALLOC_", "GLIBC_TUNABLES")) for name in os.environ):
        return
    for parameter, megabytes in _KEPT_MB.items():
        set_limit(parameter, megabytes << 20)
