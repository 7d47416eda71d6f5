# SPDX-License-Identifier: Apache-2.0
"""Whether large clouds pass between processes, and the shared memory that Fast DDS leaves behind in one that was killed.

That is about 67 MB each with our profile.

Fast DDS holds a lock on `<segment>_el` as long as the owner of a segment lives, which `fastdds shm clean` tests too.
"""

import fcntl
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

_FOLDER: Final = Path("/dev/shm")  # noqa: S108  where Fast DDS puts its segments
_LOCK: Final = "_el"
_NEEDED_MB: Final = 256.0  # three segments of 64 MB and a reserve; Docker gives 64 MB
FAST_DDS: Final = "rmw_fastrtps_cpp"
"""The middleware that foretouch is tested with, and that its shared-memory profile is for."""


def large_clouds(rmw: str, folder: Path = _FOLDER) -> tuple[str, bool]:
    """How large clouds pass between processes by a middleware (RMW), in words, and whether that is known to lose none."""
    if rmw != FAST_DDS:
        return f"{rmw}: not tested; the shared-memory profile of foretouch is for {FAST_DDS} (docs/install.md)", False
    try:
        usage = shutil.disk_usage(folder)
    except OSError:
        return f"{rmw}: there is no {folder}: clouds go by UDP, and large ones are lost", False
    free_mb, stale_mb = usage.free / 1e6, stale_bytes(folder) / 1e6
    found = f"{rmw}: {free_mb:.0f} of {usage.total / 1e6:.0f} MB of {folder} are free"
    if stale_mb > 0.0:
        found += f"; {stale_mb:.0f} MB of processes that were killed, which the next node frees"
    if free_mb + stale_mb >= _NEEDED_MB:
        return found, True
    return f"{found}, {_NEEDED_MB:g} are needed: clouds go by UDP, and large ones are lost", False


def stale_bytes(folder: Path = _FOLDER, *, free: bool = False) -> int:
    """Size of the segments of this user whose processes have ended [bytes]; they are removed if asked for."""
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
        found = os.fstat(descriptor)
        if found.st_uid != os.getuid() or not stat.S_ISREG(found.st_mode):
            raise PermissionError(f"{lock}: is of another user, or no regular file")
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)
