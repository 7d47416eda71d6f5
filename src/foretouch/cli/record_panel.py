# SPDX-License-Identifier: Apache-2.0
"""The live panel of `foretouch record`: draws a `RecorderStatus`."""

from __future__ import annotations

import math
from os.path import commonpath
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from foretouch_msgs.msg import RecorderStatus, TopicAccount


_GB = 1e9


def record_panel(status: RecorderStatus, title: str) -> Panel:
    """Samples, rejected grasps, sensors, message counts and the time left on the disk, at a glance."""
    parts: list[RenderableType] = [_samples(status), _grasps(status), _sensors(status), _topics(status.topics)]
    if status.reason:
        parts.append(Text(status.reason, "red"))
    return Panel(Group(*parts), title=title, title_align="left")


def _samples(status: RecorderStatus) -> Text:
    minutes, seconds = divmod(status.duration.sec, 60)
    text = Text(f"{minutes}:{seconds:02d}  ", "bold" if status.recording else "dim")
    text.append(f"{status.samples} samples", "bold green" if status.samples else "bold")
    text.append(f" + {status.unlabelled} without touch")
    if status.samples and status.duration.sec:
        text.append(f", {60.0 * status.samples / status.duration.sec:.1f} a minute")
    if status.last_sample:
        text.append(f"; last {status.last_sample}")
    text.append(f"  {status.bytes_written / _GB:.3f} GB, ")
    text.append(_disk(status.disk_left))
    return text


def _disk(seconds: float) -> str:
    if seconds == float("inf"):
        return "disk: -"
    return f"disk full in {seconds / 60.0:.0f} min" if seconds < 1e6 else "disk: weeks"


def _grasps(status: RecorderStatus) -> Text:
    text = Text("grasps executed: ")
    pairs = list(zip(status.outcomes, status.outcome_counts, strict=True))
    for name, count in pairs:
        text.append(f"{count} {name.replace('_', ' ')}  ", "green" if name == "recorded" else "yellow")
    if not pairs:
        text.append("none yet  ", "dim")
    if not math.isnan(status.pairing_error):
        text.append(f"pairing error {1e3 * status.pairing_error:.0f} ms, at most {1e3 * status.pairing_error_max:.0f}")
    return text


def _sensors(status: RecorderStatus) -> Text:
    text = Text("sensors: ")
    for name, state in zip(status.sensors, status.sensor_states, strict=True):
        text.append(f"{name} {state}  ", "green" if state == "alive" else "red")
    return text


def _topics(topics: Sequence[TopicAccount]) -> Table:
    table = Table(expand=True, box=SIMPLE_HEAD)
    for name in ("topic", "Hz", "received", "written", "queue", "lost", "dropped"):
        table.add_column(name, justify="left" if name == "topic" else "right", no_wrap=name != "dropped")
    common = (
        commonpath([topic.topic for topic in topics[1:]] or ["/"]).rstrip("/") + "/"
    )  # the first topic is the hand's
    for topic in topics:
        drops = zip(topic.drop_reasons, topic.drop_counts, strict=True)
        dropped = " ".join(f"{count} {reason}" for reason, count in drops)
        table.add_row(
            Text(topic.topic.removeprefix(common), "" if topic.reliable else "yellow"),
            f"{topic.rate:.1f}",
            str(topic.received),
            str(topic.written),
            str(topic.waiting),
            Text(str(topic.lost), "red" if topic.lost else ""),
            Text(dropped or "0", "red" if dropped else ""),
        )
    return table
