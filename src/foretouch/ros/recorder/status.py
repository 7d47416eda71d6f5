# SPDX-License-Identifier: Apache-2.0
"""The `RecorderStatus` message: state of the session and statistics of the topics. Pure functions, no node."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from foretouch.dataset.recording import SAMPLE_TOPIC, TopicCounts
from foretouch.ros.messages.conversions import duration_to_msg, header_to_msg
from foretouch.ros.recorder.session import SessionStatus
from foretouch.ros.recorder.subscriptions import TopicStatistics
from foretouch_msgs.msg import RecorderStatus, Status
from foretouch_msgs.msg import TopicAccount as TopicAccountMsg

_AFTER_CLOSE = "after close"  # why messages are dropped that come when the disk is full: the only reason in no file


def status_to_msg(
    session: SessionStatus,
    statistics: Mapping[str, TopicStatistics],
    *,
    path: str,
    recording: bool,
    duration_s: float,
    reason: str,
    now_ns: int,
) -> RecorderStatus:
    """The recorder's state as a message with a stamp [ns]: of the current session, or of the last one.

    `statistics` are by topic, `path` is that of the dataset, "" before the first session, and `reason` what went wrong.
    """
    received = {name: account for name, account in session.accounts.items() if name != SAMPLE_TOPIC}  # made here
    accounts = {name: received.get(name, TopicCounts()) for name in (*statistics, *received)}
    topics = [_topic(name, account, statistics.get(name, TopicStatistics())) for name, account in accounts.items()]
    drops: Counter[str] = sum((account.dropped for account in accounts.values()), Counter())
    drops[_AFTER_CLOSE] += sum(one.late for one in statistics.values())
    errors = [error * 1e-9 for error in session.pairing_errors_ns]
    flowing = recording and session.bytes_per_s > 0.0
    return RecorderStatus(
        header=header_to_msg("", now_ns),
        recording=recording,
        path=path,
        duration=duration_to_msg(duration_s),
        bytes_written=session.bytes_written,
        samples=session.samples,
        unlabelled=session.unlabelled,
        received=sum(topic.received for topic in topics),
        used=sum(topic.written for topic in topics),
        **_counts("drop_reasons", "drop_counts", drops),
        status=Status.FAILED if reason else Status.OK,
        reason=reason,
        lost=sum(topic.lost for topic in topics),
        topics=topics,
        **_counts("outcomes", "outcome_counts", session.results),
        last_sample=session.last_sample,
        pairing_error=errors[-1] if errors else math.nan,
        pairing_error_max=max(errors) if errors else math.nan,
        sensors=list(session.sensors),
        sensor_states=list(session.sensors.values()),
        disk_left=session.free_bytes / session.bytes_per_s if flowing else math.inf,
    )


def _topic(name: str, account: TopicCounts, topic: TopicStatistics) -> TopicAccountMsg:
    return TopicAccountMsg(
        topic=name,
        received=account.received + topic.waiting + topic.late,
        written=account.written,
        waiting=account.pending + topic.waiting,
        **_counts("drop_reasons", "drop_counts", account.dropped + Counter({_AFTER_CLOSE: topic.late})),
        lost=account.lost,
        reliable=topic.reliable,
        rate=topic.rate_hz,
    )


def _counts(names: str, counts: str, counted: Counter[str]) -> dict[str, Sequence[str] | Sequence[int]]:
    present = {name: count for name, count in sorted(counted.items()) if count > 0}
    return {names: list(present), counts: list(present.values())}
