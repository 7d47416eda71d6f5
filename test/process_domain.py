# SPDX-License-Identifier: Apache-2.0
"""The DDS domain of a test that starts the program in processes of its own."""

import itertools
import os

_FIRST, _EACH = 76, 8  # beyond the domains of the tests of nodes, and below 102, whose ports Linux hands out
_used = itertools.count(os.getpid())


def process_environment() -> dict[str, str]:
    """The environment of such a process: a domain that no other worker of these tests takes, nor the last seven tests of this one."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    domain = _FIRST + _EACH * (worker % 3) + next(_used) % _EACH
    return {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
