# SPDX-License-Identifier: Apache-2.0
"""Frees the shared memory that Fast DDS leaves behind in a process that was killed: about 67 MB each with our profile.

Fast DDS holds a lock on `<segment>_el` as long as the owner of a segment lives, which `fastdds shm clean` tests too.
"""

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

_FOLDER: Final = Path("/dev/shm")  # noqa: S108  where Fast DDS puts its segments
_LOCK: Final = "_el"


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
