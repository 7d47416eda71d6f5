# SPDX-License-Identifier: Apache-2.0
"""What the recorder tells: a session's view and the queue before it as `RecorderStatus`. Pure functions, no node."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from foretouch.dataset.recording import SAMPLE_TOPIC, TopicAccount
from foretouch.ros.messages.conversions import duration_to_msg, header_to_msg
from foretouch.ros.recorder.session import SessionView
from foretouch_msgs.msg import RecorderStatus, Status
from foretouch_msgs.msg import TopicAccount as TopicAccountMsg

__all__ = ["AFTER_CLOSE", "TopicStatistics", "status_to_msg"]

AFTER_CLOSE = "after close"
"""Why messages are dropped that come when the disk is full: the one reason that stands in no file."""


@dataclass(frozen=True, kw_only=True)
class TopicStatistics:
    """What is known of a topic beside the session's accounts.

    Attributes:
        waiting: Messages in the queue.
        late: Messages that came after the session had ended by itself: its file was closed and cannot tell of them.
        reliable: Whether lost messages are sent again.
        rate_hz: Of arrival [Hz].
    """

    waiting: int = 0
    late: int = 0
    reliable: bool = True
    rate_hz: float = 0.0


def status_to_msg(
    view: SessionView,
    inflows: Mapping[str, TopicStatistics],
    *,
    path: str,
    recording: bool,
    duration_s: float,
    reason: str,
    now_ns: int,
) -> RecorderStatus:
    """The recorder's state.

    Args:
        view: Of the session at hand, or of the last one.
        inflows: By topic.
        path: Of the dataset, "" before the first session.
        recording: Whether it goes on.
        duration_s: Since it began, or of the last one [s].
        reason: What went wrong, or "".
        now_ns: Stamp of the message [ns].
    """
    received = {name: account for name, account in view.accounts.items() if name != SAMPLE_TOPIC}  # made here
    accounts = {name: received.get(name, TopicAccount()) for name in (*inflows, *received)}
    topics = [_topic(name, account, inflows.get(name, TopicStatistics())) for name, account in accounts.items()]
    drops: Counter[str] = sum((account.dropped for account in accounts.values()), Counter())
    drops[AFTER_CLOSE] += sum(inflow.late for inflow in inflows.values())
    errors = [error * 1e-9 for error in view.pairing_errors_ns]
    flowing = recording and view.bytes_per_s > 0.0
    return RecorderStatus(
        header=header_to_msg("", now_ns),
        recording=recording,
        path=path,
        duration=duration_to_msg(duration_s),
        bytes_written=view.bytes_written,
        samples=view.samples,
        unlabelled=view.unlabelled,
        received=sum(topic.received for topic in topics),
        used=sum(topic.written for topic in topics),
        **_counts("drop_reasons", "drop_counts", drops),
        status=Status.FAILED if reason else Status.OK,
        reason=reason,
        lost=sum(topic.lost for topic in topics),
        topics=topics,
        **_counts("outcomes", "outcome_counts", view.outcomes),
        last_sample=view.last_sample,
        pairing_error=errors[-1] if errors else math.nan,
        pairing_error_max=max(errors) if errors else math.nan,
        sensors=list(view.sensors),
        sensor_states=list(view.sensors.values()),
        disk_left=view.free_bytes / view.bytes_per_s if flowing else math.inf,
    )


def _topic(name: str, account: TopicAccount, inflow: TopicStatistics) -> TopicAccountMsg:
    return TopicAccountMsg(
        topic=name,
        received=account.received + inflow.waiting + inflow.late,
        written=account.written,
        waiting=account.pending + inflow.waiting,
        **_counts("drop_reasons", "drop_counts", account.dropped + Counter({AFTER_CLOSE: inflow.late})),
        lost=account.lost,
        reliable=inflow.reliable,
        rate=inflow.rate_hz,
    )


def _counts(names: str, counts: str, counted: Counter[str]) -> dict[str, Sequence[str] | Sequence[int]]:
    present = {name: count for name, count in sorted(counted.items()) if count > 0}
    return {names: list(present), counts: list(present.values())}
