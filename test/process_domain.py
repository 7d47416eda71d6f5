# SPDX-License-Identifier: Apache-2.0
"""The DDS domain of a test, which no other program of tests on this computer is in, also of another checkout."""

import fcntl
import itertools
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

_FIRST, _EACH = 76, 8  # beyond the domains of the tests of nodes, and below 102, whose ports Linux hands out
_used = itertools.count(os.getpid())
_locks: dict[int, int] = {}  # descriptors by domain, open until the tests end


def take_domain(candidates: Iterable[int]) -> int:
    """The first of some domains that no other program of tests has taken; the last one if all are."""
    domain = 0
    for domain in candidates:
        if domain in _locks:
            return domain
        path = Path(tempfile.gettempdir(), f"foretouch-tests-domain-{domain}")
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
        else:
            _locks[domain] = descriptor
            return domain
    return domain


def process_environment() -> dict[str, str]:
    """The environment of such a process: a domain that no other worker of these tests takes, nor the last seven tests of this one."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    domain = take_domain(_FIRST + _EACH * (worker % 3) + next(_used) % _EACH for _ in range(_EACH))
    return {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
