# SPDX-License-Identifier: Apache-2.0
"""`Snapshot` as `diagnostic_msgs/DiagnosticStatus`: a level, one line for people, and the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from foretouch.ros.statistics import Snapshot

__all__ = ["Health", "diagnostic_status"]


@dataclass(frozen=True, kw_only=True)
class Health:
    """What a node knows of itself beyond its counts.

    Attributes:
        state: Lifecycle state.
        errors: What keeps it from working, such as a damaged model.
        warnings: What is wrong around it, such as mismatched QoS.
        notes: Other facts by name, such as the model's.
        expects_input_every_s: Silence beyond this is a warning; None for a node without inputs.
    """

    state: str
    errors: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: Mapping[str, str] | None = None
    expects_input_every_s: float | None = None


def diagnostic_status(name: str, now: Snapshot, before: Snapshot | None, health: Health) -> DiagnosticStatus:
    """What one node has to say.

    Args:
        name: Fully qualified name of the node.
        now: The counts.
        before: Those of the last report: drops since then are a warning.
        health: The rest.
    """
    warnings = [*health.warnings, *_silence(now, health), *_drops(now, before)]
    if health.errors:
        level, message = DiagnosticStatus.ERROR, "; ".join(health.errors)
    elif warnings:
        level, message = DiagnosticStatus.WARN, "; ".join(warnings)
    else:
        level, message = DiagnosticStatus.OK, f"{health.state}, {now.rate_hz:.1f} Hz"
    values = {"state": health.state, **_numbers(now), **(health.notes or {})}
    return DiagnosticStatus(
        level=level,
        name=name,
        message=message,
        hardware_id="none",
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def _silence(now: Snapshot, health: Health) -> list[str]:
    limit = health.expects_input_every_s
    if limit is None or health.state != "active":
        return []
    if now.idle_s is None:
        return ["no input yet"]
    return [f"no input for {now.idle_s:.1f} s"] if now.idle_s > limit else []


def _drops(now: Snapshot, before: Snapshot | None) -> list[str]:
    old = before.dropped if before else {}
    fresh = {reason: count - old.get(reason, 0) for reason, count in now.dropped.items()}
    told = [f"{count} {reason}" for reason, count in fresh.items() if count]
    lost = now.lost - (before.lost if before else 0)
    if lost:
        told.append(f"{lost} lost on the way")
    return [f"dropped: {', '.join(told)}"] if told else []


def _numbers(now: Snapshot) -> dict[str, str]:
    numbers = {
        "rate_hz": f"{now.rate_hz:.2f}",
        "received": str(now.received),
        "used": str(now.used),
        "dropped": str(sum(now.dropped.values())),
        **{f"dropped.{reason}": str(count) for reason, count in sorted(now.dropped.items())},
        "waiting": str(now.waiting),
        "lost_on_the_way": str(now.lost),
    }
    for key, pair in (("input_age_ms", now.input_age_ms), ("latency_ms", now.latency_ms)):
        if pair is not None:
            numbers[f"{key}.p50"], numbers[f"{key}.p95"] = (f"{value:.2f}" for value in pair)
    return numbers
