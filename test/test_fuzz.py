# SPDX-License-Identifier: Apache-2.0
"""Changed files, messages and requests of every kind: each is read or refused in one line, with a bounded number of calls, and answers are finite.

`FORETOUCH_FUZZ=5000 pytest test/test_fuzz.py` is the campaign, with so many other cases of each kind; what they found is in `benchmarks/fuzz`.
"""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from corpus import files
from corpus.changes import Draw
from counted_work import calls_at_most
from every_case import every_case
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from foretouch.errors import ForetouchError

CASES = int(os.environ.get("FORETOUCH_FUZZ", "0"))
LONGEST = 3000  # characters of a refusal
MOST_CALLS = 1_000_000  # of functions, for a file or message

pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.timeout(600 + CASES)]


def judge(read: Callable[[], object]) -> None:
    try:
        with calls_at_most(MOST_CALLS):
            read()
    except ForetouchError as err:
        text = str(err)
        assert text
        assert "\n" not in text
        assert len(text) < LONGEST


def fuzz(change: Callable[[Draw], Callable[[], object]], usual: int, weight: float) -> None:
    """Judge cases; those of a campaign are other ones each time."""
    count = max(3, round((CASES or usual) * weight))

    @settings(
        max_examples=count, deadline=None, derandomize=not CASES, database=None, suppress_health_check=HealthCheck
    )
    @given(st.data())
    def check(data: st.DataObject) -> None:
        judge(change(data.draw))

    check()


@pytest.mark.slow
def test_a_changed_file_is_read_as_it_was_written_or_refused_and_no_file_outside_is_changed(tmp_path: Path) -> None:
    def check(name: str) -> None:
        (tmp_path / name).mkdir()
        fuzz(files.Changed(files.KINDS[name], tmp_path / name).change, 20, files.KINDS[name].weight)

    every_case(list(files.KINDS), check)


@pytest.mark.ros
def test_what_the_nodes_make_of_a_changed_message_is_finite_or_refused() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    from corpus import messages

    def check(name: str) -> None:
        valid, read = messages.KINDS[name]()
        fuzz(messages.changed(valid, read), 40, messages.WEIGHTS.get(name, 1.0))

    every_case(list(messages.KINDS), check)
