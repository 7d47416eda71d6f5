# SPDX-License-Identifier: Apache-2.0
"""The touch and the tare of one grasp, cut out of the stream of readings by header stamps.

The clocks of robot and sensor may disagree, and stamps may jitter, by up to `guard_s` together. Therefore no reading
within `guard_s` of a change is used: the touch is the median over [contact + guard, release - guard], the tare the
median over at most `tare_s` that end at start - guard. As long as the error of the clocks is below the guard, both
intervals hold readings of the right kind only. A grasp is rejected if an interval has no reading for longer than
`tolerance_s`, or if the clocks differ by more than `clock_s`.
"""

from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting
from foretouch.dataset.pairing.buffers import TouchBuffer, TouchWindow
from foretouch.errors import DatasetError
from foretouch.tactile import touch_faults
from foretouch.tactile.contact_detector import contact_scores, find_contact
from foretouch.tactile.readings import rest_of
from foretouch.types import APPROACH, HOLD, REST, SECOND_NS, Bool, Float32, Int64, Sample, Touch, TouchSeries, UInt8
from foretouch.types.channels import Channels

_FROZEN_S = 0.5  # the noisy values of a finger do not repeat together for so long
_MIN_TARE_S = 0.1
_HOLD_LEAST_S = 0.05  # shortest steady contact, without the margins
_MIN_TARE_READINGS = 5


@dataclass(frozen=True, kw_only=True)
class PairingConfig(Settings):
    """Settings of the pairing of grasps, tactile readings and clouds."""

    tolerance_s: float = setting(0.1, "Longest time without a reading within an interval", bounds=(0.001, 10.0))
    guard_s: float = setting(
        0.1,
        "Tolerated error of clocks and stamps: this margin is left out at both ends of an interval",
        bounds=(0.0, 10.0),
    )
    clock_s: float = setting(0.25, "Difference of the clocks above which grasps are rejected", bounds=(0.001, 60.0))
    tare_s: float = setting(0.5, "Longest time over which the tare is taken", bounds=(0.01, 60.0))
    kept_s: float = setting(
        60.0, "How long clouds, grasps and readings are kept for a grasp that is reported later", bounds=(1.0, 3600.0)
    )
    kept_mb: float = setting(300.0, "Largest memory for these clouds; the oldest are dropped", bounds=(1.0, 100_000.0))
    wait_s: float = setting(
        2.0, "How long a grasp waits for readings, clouds and labels that are still to come", bounds=(0.0, 60.0)
    )


class PairingError(DatasetError):
    """A grasp cannot become a sample; `reason` is a short word by which such grasps are counted."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A grasp in time, by the robot's clock [ns], or a contact by the sensor's clock."""

    start: int  # when the hand began to close; before it, nothing was touched
    contact: int  # when contact was steady
    release: int  # when the hand began to open

    def overlaps(self, other: "Interval") -> bool:
        """Return whether another one overlaps from start to release."""
        return self.start < other.release and other.start < self.release


def cut_touch(
    buffer: TouchBuffer, interval: Interval, config: PairingConfig, not_before_ns: int | None = None
) -> Sample:
    """Cut the touch of one grasp out of the stream.

    Args:
        buffer: The readings.
        interval: When the grasp was executed.
        config: Settings.
        not_before_ns: End of the previous grasp; the tare begins after it.

    Returns:
        A sample with touch, tare and the readings from the tare to the release, and no more: neither object, cloud nor grasp. Its
        `extra` has the difference of the clocks, and the medians of the further channels by name, in contact and, after
        `tare_`, before it.

    Raises:
        PairingError: `bad_interval`, `short_hold`, `no_tactile`, `no_tare`, `restless_tare`, `pairing_error`,
            `clock_offset`, `late_readings`, `sensor_fault` or `frozen_sensor`.
    """
    guard, tolerance = _ns(config.guard_s), _ns(config.tolerance_s)
    if not 0 < interval.start <= interval.contact < interval.release:
        raise PairingError("bad_interval", f"start, contact and release are not in this order: {interval}")
    low, high = interval.contact + guard, interval.release - guard
    if high - low < _ns(_HOLD_LEAST_S):
        length = _s(interval.release - interval.contact)
        raise PairingError("short_hold", f"{length} of contact is too short for the margins and the shortest contact")
    tare_end = interval.start - guard
    tare_start = tare_end - _ns(config.tare_s)
    if not_before_ns is not None:
        tare_start = max(tare_start, not_before_ns + guard)
    window = buffer.between(tare_start, interval.release)
    hold, rest = buffer.between(low, high), buffer.between(tare_start, tare_end)
    if not len(hold):
        raise PairingError("no_tactile", "no reading within the contact")
    channels = buffer.channels
    _require_tare(rest, tare_end - tare_start, channels)
    error = max(_longest_gap_ns(hold, low, high), _longest_gap_ns(rest, tare_start, tare_end))
    if error > tolerance:
        raise PairingError("pairing_error", f"{_s(error)} without a reading, at most {_s(tolerance)} is tolerated")
    clock = _clock_offset_ns(window, config)
    touch, tare = (Touch(np.median(part.counts, axis=0), channels) for part in (hold, rest))
    _require_working(window, touch, tare)
    onsets = find_contact(window.stamps_ns, window.counts, rest.counts, channels)
    contact_ns = min((onset for onset in onsets if onset is not None), default=None)
    extra = {"clock_offset_s": clock * 1e-9, **_medians(buffer, hold, ""), **_medians(buffer, rest, "tare_")}
    others = {name: window.others[:, k].copy() for k, name in enumerate(buffer.others)}
    return Sample(
        id="",
        object="",
        touch=touch,
        tare=rest_of(tare.values, channels),
        extra=extra,
        series=TouchSeries(window.stamps_ns, window.counts, _phases(window, interval), others),
        contact_ns=contact_ns,
        detector="" if contact_ns is None else "change against the tare (foretouch.tactile.contact_detector)",
        pairing_error_ns=error,
        flags=_flags(window, onsets, channels),
    )


def _phases(window: TouchWindow, interval: Interval) -> UInt8:
    """Return (T,) uint8: whether the hand rested, approached or held at each reading."""
    phases = np.full(len(window), REST, np.uint8)
    phases[window.stamps_ns >= interval.start] = APPROACH
    phases[window.stamps_ns >= interval.contact] = HOLD
    return phases


def _medians(buffer: TouchBuffer, part: TouchWindow, prefix: str) -> dict[str, float]:
    """Return the medians of the further channels, by their names with a prefix."""
    medians = np.median(part.others, axis=0).tolist()
    return {f"{prefix}{name}": value for name, value in zip(buffer.others, medians, strict=True)}


def _clock_offset_ns(window: TouchWindow, config: PairingConfig) -> int:
    """Return the smallest difference of reception time and stamp [ns]: steady if clocks differ, varying if a computer is busy."""
    behind = window.received_ns - window.stamps_ns
    least, most = int(behind.min()), int(behind.max())
    if abs(least) <= _ns(config.clock_s):
        return least
    if least > 0 and most - least > _ns(config.clock_s):
        text = f"readings were received {_s(least)} to {_s(most)} after their stamps: a computer is overloaded"
        raise PairingError("late_readings", text)
    text = f"stamps of the sensor differ from the time of reception by {_s(least)}: the clocks differ"
    raise PairingError("clock_offset", f"{text}, or a computer is overloaded" if least > 0 else text)


def _longest_gap_ns(window: TouchWindow, low_ns: int, high_ns: int) -> int:
    """Return the longest time in [low, high] without a reading [ns]."""
    return int(np.diff(np.concatenate([[low_ns], window.stamps_ns, [high_ns]])).max())


def _require_tare(rest: TouchWindow, length_ns: int, channels: Channels) -> None:
    if length_ns < _ns(_MIN_TARE_S) or len(rest) < _MIN_TARE_READINGS:
        raise PairingError("no_tare", f"{len(rest)} readings in {_s(max(0, length_ns))} of rest before the grasp")
    half = len(rest) // 2
    if (np.median(contact_scores(rest.counts[half:], rest.counts[:half], channels), axis=0) > 1.0).any():
        raise PairingError("restless_tare", "something was touched before the grasp")


def _require_working(window: TouchWindow, touch: Touch, tare: Touch) -> None:
    for name, reading in (("contact", touch), ("tare", tare)):
        if faults := touch_faults(reading):
            raise PairingError("sensor_fault", f"{name}: {'; '.join(faults)}")
    for finger, columns in touch.channels.finger_columns.items():
        counts = window.counts[:, columns]
        if (counts == counts[0]).all():
            raise PairingError("frozen_sensor", f"{finger}: the same {len(counts)} times, through rest and contact")


def _flags(window: TouchWindow, onsets: tuple[int | None, ...], channels: Channels) -> tuple[str, ...]:
    flags = [f"no_contact_{finger}" for finger, onset in zip(channels.fingers, onsets, strict=True) if onset is None]
    for finger, columns in channels.finger_columns.items():
        same = (np.diff(window.counts[:, columns], axis=0) == 0).all(axis=1)
        same &= may_freeze(window.counts[1:, columns], channels.tared[columns])
        if _longest_run_ns(same, window.stamps_ns) > _ns(_FROZEN_S):
            flags.append(f"frozen_{finger}")
    if (np.diff(window.stamps_ns) == 0).any():
        flags.append("duplicate_stamps")
    return tuple(flags)


def may_freeze(values: Float32, tared: Bool) -> Bool:
    """Return (...) whether (..., M) values of a finger that repeat are a fault; forces at rest may be zero for any time."""
    return np.asarray((tared | (values != 0.0)).any(axis=-1), np.bool_)


def _longest_run_ns(same: Bool, stamps_ns: Int64) -> int:
    """Return the longest time over which neighbouring readings are the same [ns]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    return max((int(stamps_ns[last] - stamps_ns[first]) for first, last in edges.reshape(-1, 2)), default=0)


def _ns(seconds: float) -> int:
    return round(seconds * SECOND_NS)


def _s(nanoseconds: int) -> str:
    return f"{nanoseconds * 1e-9:.3f} s"
