# SPDX-License-Identifier: Apache-2.0
"""The touch and the tare of one grasp, cut out of the stream of readings by header stamps.

The clocks of robot and sensor may disagree, and stamps may jitter, by up to `guard_s` together. Therefore no reading
within `guard_s` of a change is used: the touch is the median over [contact + guard, release - guard], the tare the
median over at most `tare_s` that end at start - guard. As long as the error of the clocks is below the guard, both
intervals hold readings of the right kind only. A grasp is rejected if an interval has no reading for longer than
`tolerance_s`, or if the clocks differ by more than `clock_s`.

`label_series` has the rules for the readings themselves. The recorder, the import of bags and `foretouch.write` use them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting
from foretouch.dataset.labelling.buffers import TouchBuffer, TouchWindow
from foretouch.errors import DatasetError
from foretouch.tactile import touch_faults
from foretouch.tactile.contact_detector import SETTLE_NS, SeriesContact, contact_scores, find_contact
from foretouch.tactile.readings import rest_of
from foretouch.types import (
    APPROACH,
    HOLD,
    REST,
    SECOND_NS,
    Bool,
    Float64,
    Floating,
    Int64,
    Sample,
    Touch,
    TouchSeries,
    UInt8,
)
from foretouch.types.channels import Channels

_FROZEN_S = 0.5  # the noisy values of a finger do not repeat together for so long
_MIN_TARE_S = 0.1
_HOLD_LEAST_S = 0.05  # shortest steady contact, without the margins
_MIN_TARE_READINGS = 5
_RAMP = 0.5  # of what contact changed; a reading that goes on to change by more while the hand holds drifts
_DETECTOR = "change against the tare (foretouch.tactile.contact_detector)"


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
        raise PairingError("no_tactile", _without_readings(buffer))
    if tare_end - tare_start < _ns(_MIN_TARE_S):
        raise PairingError("no_tare", _too_short(len(rest), tare_end - tare_start))
    require_rest(rest.counts, buffer.channels)
    error = max(_longest_gap_ns(hold, low, high), _longest_gap_ns(rest, tare_start, tare_end))
    if error > tolerance:
        raise PairingError("pairing_error", f"{_s(error)} without a reading, at most {_s(tolerance)} is tolerated")
    clock = _clock_offset_ns(window, config)
    held = (window.stamps_ns >= low) & (window.stamps_ns < high)
    label = label_series(window.stamps_ns, window.counts, len(rest), buffer.channels, hold=held)
    extra = {"clock_offset_s": clock * 1e-9, **_medians(buffer, hold, ""), **_medians(buffer, rest, "tare_")}
    others = {name: window.others[:, k].copy() for k, name in enumerate(buffer.others)}
    return Sample(
        id="",
        object="",
        touch=label.touch,
        tare=label.tare,
        extra=extra,
        series=TouchSeries(window.stamps_ns, window.counts, _phases(window, interval), others),
        contact_ns=label.contact_ns,
        detector=label.detector,
        pairing_error_ns=error,
        flags=(*label.flags, *(["duplicate_stamps"] if (np.diff(window.stamps_ns) == 0).any() else [])),
    )


@dataclass(frozen=True, eq=False)
class SeriesLabel:
    """What a series of readings is labelled with."""

    touch: Touch | None  # None without a steady contact
    tare: Touch
    contact_ns: int | None  # stamp of the first reading in contact [ns]
    hold: Bool  # (T,) readings of which the touch is the median
    flags: Mapping[str, str]  # what to look at, by flag, with its explanation

    @property
    def detector(self) -> str:
        """How the contact was found; "" without one."""
        return "" if self.contact_ns is None else _DETECTOR


def label_series(
    stamps_ns: Int64,
    counts: Floating,
    rest: int,
    channels: Channels,
    *,
    hold: Bool | None = None,
    complete: Floating | None = None,
) -> SeriesLabel:
    """Label the readings around one grasp, by the same rules and flags for every source.

    Args:
        stamps_ns: (T,) int64 ascending stamps [ns].
        counts: (T, D) readings, NaN for taxels that were not read.
        rest: How many of them are without contact, at the beginning.
        channels: What the D values are.
        hold: (T,) readings in steady contact; by default those that the contact detector finds.
        complete: (T, D) the readings with a number in the place of each NaN; by default there is none.

    Raises:
        PairingError: `no_tare`, `restless_tare`, `sensor_fault` or `frozen_sensor`.
    """
    whole = counts if complete is None else complete
    require_rest(whole[:rest], channels)
    contacts = find_contact(stamps_ns, whole, rest, channels)
    onsets = [int(stamps_ns[contact.onset]) for contact in contacts if contact.onset is not None]
    contact_ns = min(onsets, default=None)
    if hold is None:
        hold = np.zeros(len(stamps_ns), np.bool_)
        for contact in contacts:
            hold[slice(contact.onset or 0, contact.end)] = True
        hold &= stamps_ns >= (contact_ns or 0) + SETTLE_NS
    tare = Touch(_median(counts[:rest]), channels)
    touch = Touch(_median(counts[hold]), channels) if hold.any() else None
    _require_working(whole, touch, tare)
    return SeriesLabel(
        touch=touch,
        tare=rest_of(tare.values, channels),
        contact_ns=contact_ns,
        hold=hold,
        flags=_flags(stamps_ns, whole, tare, hold, contacts),
    )


def _median(rows: Floating) -> Float64:
    """Return (D,) medians of (T, D) readings, of those that were read; NaN where none was."""
    medians = np.full(rows.shape[1], np.nan)
    read = ~np.isnan(rows)
    if read.all():
        medians[:] = np.median(rows, axis=0)
    else:
        some = read.any(axis=0)
        medians[some] = np.nanmedian(rows[:, some], axis=0)
    return medians


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


def _without_readings(buffer: TouchBuffer) -> str:
    """Return why there is no reading in the contact, as far as the stamps show it."""
    if buffer.newest_ns == 0:
        return "no reading within the contact: the stamps of all readings are 0, which their driver does not set"
    return "no reading within the contact"


def _longest_gap_ns(window: TouchWindow, low_ns: int, high_ns: int) -> int:
    """Return the longest time in [low, high] without a reading [ns]."""
    return int(np.diff(np.concatenate([[low_ns], window.stamps_ns, [high_ns]])).max())


def require_rest(counts: Floating, channels: Channels) -> None:
    """Refuse (R, D) readings that are no rest: `no_tare` if they are too few, `restless_tare` if something is touched in them."""
    if len(counts) < _MIN_TARE_READINGS:
        raise PairingError("no_tare", _too_short(len(counts)))
    half = len(counts) // 2
    if (np.median(contact_scores(counts[half:], counts[:half], channels), axis=0) > 1.0).any():
        raise PairingError("restless_tare", "something was touched before the grasp")


def _too_short(count: int, length_ns: int | None = None) -> str:
    span = "" if length_ns is None else f" in {_s(max(0, length_ns))}"
    return f"{count} readings{span} of rest before the grasp, fewer than {_MIN_TARE_READINGS} or {_MIN_TARE_S:g} s"


def _require_working(counts: Floating, touch: Touch | None, tare: Touch) -> None:
    for name, reading in (("contact", touch), ("tare", tare)):
        if reading is not None and (faults := touch_faults(reading)):
            raise PairingError("sensor_fault", f"{name}: {'; '.join(faults)}")
    for finger, columns in tare.channels.finger_columns.items():
        own = counts[:, columns]
        if (own == own[0]).all() and may_freeze(own[0], tare.channels.tared[columns]):
            raise PairingError("frozen_sensor", f"{finger}: the same {len(own)} times, through rest and contact")


def _flags(
    stamps_ns: Int64, counts: Floating, tare: Touch, hold: Bool, contacts: tuple[SeriesContact, ...]
) -> dict[str, str]:
    flags, channels = {}, tare.channels
    for (finger, columns), contact in zip(channels.finger_columns.items(), contacts, strict=True):
        own = counts[:, columns]
        same = (np.diff(own, axis=0) == 0).all(axis=1) & may_freeze(own[1:], channels.tared[columns])
        frozen_ns = _longest_run_ns(same, stamps_ns)
        if contact.onset is None:
            flags[f"no_contact_{finger}"] = f"{finger} is not in contact"
        if frozen_ns > _ns(_FROZEN_S):
            flags[f"frozen_{finger}"] = f"{finger} sends the same numbers for {_s(frozen_ns)}"
        if contact.drifted or (contact.onset is not None and _is_ramp(own[hold], tare.values[columns])):
            flags[f"drift_{finger}"] = f"{finger} changes too slowly for a contact, or all the time"
        if contact.early:
            flags[f"contact_in_rest_{finger}"] = f"{finger} is in contact before the readings at rest end"
        if contact.several:
            flags[f"several_contacts_{finger}"] = f"{finger} is in contact several times, of which the longest counts"
    return flags


def _is_ramp(held: Floating, tare: Float64) -> bool:
    """Return whether (H, M) readings of a finger that holds go on to change, by more than half of what contact changed."""
    if len(held) < 2 * _MIN_TARE_READINGS:
        return False
    half = len(held) // 2
    change = np.median(held[half:], axis=0) - np.median(held[:half], axis=0)
    step = np.nan_to_num(np.median(held, axis=0) - tare)  # NaN of a taxel that was not read at rest
    return float(np.linalg.norm(change)) > _RAMP * float(np.linalg.norm(step))


def may_freeze(values: Floating, tared: Bool) -> Bool:
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
