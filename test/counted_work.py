# SPDX-License-Identifier: Apache-2.0
"""Work that is counted: how many functions a block calls. It is the same on every machine, whatever else runs there."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class TooMuchWork(BaseException):
    """More calls than a block may make; no `except Exception` of the code under test stops it."""


@contextmanager
def calls_at_most(limit: int) -> Iterator[list[int]]:
    """End the block where this thread has called more functions, of Python or C, than a limit.

    Yields:
        The number of calls so far, as the only item.
    """
    counted, before = [0], sys.getprofile()

    def count(frame: Any, event: str, argument: Any) -> None:
        if event in ("call", "c_call"):
            counted[0] += 1
            if counted[0] > limit:
                sys.setprofile(before)
                raise TooMuchWork(f"more than {limit} calls")

    sys.setprofile(count)
    try:
        yield counted
    except TooMuchWork as err:
        raise AssertionError(str(err)) from err
    finally:
        sys.setprofile(before)
