# SPDX-License-Identifier: Apache-2.0
"""Online contact detection, and the tare, from the readings of a tactile sensor.

Each reading of a finger is compared with a recent reference of the same finger without contact. Every change is
divided by the noise of its channel, and

    score = max over the channels of the rms over the channel's values of |change| / noise / limit

so that a score above 1 is contact. The limit is `_TAXEL_LIMIT` for a channel of taxels, `_SINGLE_LIMIT` for one of a single
value. The noise is the spread at rest (1.4826 times the median absolute deviation), but at least what the description
states, or the resolution of the channel where it states none. That of the BioTac SP states what sensors showed without
contact: 4.4 counts (electrodes), 0.4 counts (PDC). With noise alone the rms over its 24 electrodes is 1 +- 0.14, far below
the limit of 3; one electrode that moves by fifteen deviations reaches it, and so do all together that move by 2.8. A steady
touch relaxes by up to 8 counts/s: over 45 s of such recordings the limit of 3 causes no false alarm, 2.5 causes two.

Contact begins with the first of `_CONFIRM` consecutive readings above 1 and ends with the first of `_CONFIRM` consecutive
readings below `RELEASE_LEVEL`. The reference follows drift: it is the median over `_WINDOW_NS` that end `_LAG_NS` ago, and
is frozen during contact. A contact that lasts longer than `LONGEST_S` is considered drift and is ended.
"""

from collections import deque
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.tactile.channels import BIOTAC
from foretouch.tactile.readings import rest_of, touch_faults
from foretouch.types import SECOND_NS, Bool, Float32, Float64, Int64, Touch
from foretouch.types.channels import Channels

_TAXEL_LIMIT: Final = 3.0  # rms of the taxels' changes that counts as contact [deviations]
_SINGLE_LIMIT: Final = 12.0  # change of a finger's single value, such as PDC [deviations]
RELEASE_LEVEL: Final = 0.7  # score below which contact ends
_CONFIRM: Final = 3  # consecutive readings that confirm a change
_WINDOW_NS: Final = 500_000_000  # over which the reference is computed [ns]
SETTLE_NS: Final = 300_000_000
"""From first to steady contact; a shorter one is a glitch or lost packets [ns]."""

_SOON_NS: Final = 100_000_000  # after the onset, within which a contact differs from the readings before [ns]
_DRIFTED: Final = 0.5  # score of a reference against the rest, above which the finger has drifted
_LAG_NS: Final = 300_000_000  # between the reference and now: a slower contact is considered drift [ns]
LONGEST_S: Final = 120.0  # of a contact; longer ones are considered drift [s]
_REFERENCE_INTERVAL: Final = 10  # readings between two updates of the reference: it drifts slowly, a median is costly
_MAX_READINGS: Final = 20_000  # far more than the window and the lag hold at any rate; stamps may repeat


class ContactEvent(NamedTuple):
    """The onset or the release of a contact."""

    finger: str  # such as `TH`
    kind: Literal["onset", "release"]
    stamp_ns: int  # stamp of the first reading that shows it [ns]; it is confirmed a few readings later


class SeriesContact(NamedTuple):
    """The contact of a finger in a series of readings."""

    onset: int | None  # number of its first reading; None without contact
    end: int  # number of the first reading after it
    several: bool  # whether there are more, of which it is the longest
    drifted: bool  # whether the finger drifted out of its rest before, so that its reference had to follow
    early: bool  # whether it began within the readings at rest


class FingerContact:
    """Contact detector of one finger.

    Attributes:
        touching: Whether the finger is in contact; None until a reference exists.
        score: Score of the last reading; 0 until a reference exists.
    """

    def __init__(self, finger: str, channels: Channels = BIOTAC) -> None:
        self.finger = finger
        self._channels = channels
        self.touching: bool | None = None
        self.score = 0.0
        self._recent: deque[tuple[int, Float64]] = deque(maxlen=_MAX_READINGS)
        self._reference: Float64 | None = None
        self._noise = np.empty(0)
        self._since_update = 0  # readings
        self._against = 0  # consecutive readings that speak for the other state
        self._first_ns = self._since_ns = 0  # stamps of the first of these, and of the first reading of the state

    def update(self, stamp_ns: int, counts: npt.ArrayLike) -> ContactEvent | None:
        """Process a reading, (M,) values of the finger with its stamp [ns]; stamps may go back."""
        reading = np.asarray(counts, np.float64)
        if not self.touching:
            self._update_reference(stamp_ns, reading)
        if self._reference is None:
            return None
        self.score = float(_scores((reading - self._reference) / self._noise, self._channels))
        touching = bool(self.touching)
        drift = touching and stamp_ns - self._since_ns > LONGEST_S * SECOND_NS
        if not drift and not (self.score < RELEASE_LEVEL if touching else self.score > 1.0):
            self.touching, self._against = touching, 0
            return None
        self._first_ns = self._first_ns if self._against else stamp_ns
        self._against += 1
        if self._against < _CONFIRM and not drift:
            self.touching = touching
            return None
        self.touching = not touching
        self._against = 0
        self._since_ns = self._first_ns
        event = ContactEvent(self.finger, "release" if touching else "onset", self._first_ns)
        if touching and self.score >= RELEASE_LEVEL:
            self.reset()  # not a release but drift: the reference is no longer valid
        self._recent.clear()  # readings before this contact are no reference for the next one
        return event

    def reset(self) -> None:
        """Discard the reference, for instance after a clock jump or a sensor dropout."""
        self.touching = None
        self.score = 0.0
        self._reference = None
        self._recent.clear()
        self._against = 0

    def _update_reference(self, stamp_ns: int, reading: Float64) -> None:
        """Compute the reference from the recent readings without contact."""
        self._recent.append((stamp_ns, reading))
        newest = stamp_ns - _LAG_NS
        while self._recent and self._recent[0][0] < newest - _WINDOW_NS:
            self._recent.popleft()
        self._since_update += 1
        spans = stamp_ns - self._recent[0][0] >= 0.9 * (_LAG_NS + _WINDOW_NS)
        if not spans or (self._reference is not None and self._since_update < _REFERENCE_INTERVAL):
            return
        window = np.array([counts for stamp, counts in self._recent if stamp <= newest])
        if len(window) > 1:
            self._reference = np.median(window, axis=0)
            self._noise = _resting_noise(window, self._channels)
            self._since_update = 0


class ContactDetector:
    """Contact detectors of both fingers.

    Attributes:
        fingers: Detector of each finger, by name.
    """

    def __init__(self, channels: Channels = BIOTAC) -> None:
        self.fingers = {name: FingerContact(name, channels) for name in channels.fingers}
        self._columns = channels.finger_columns

    @property
    def holding(self) -> bool:
        """Whether both fingers are in contact."""
        return all(finger.touching for finger in self.fingers.values())

    def update(self, stamp_ns: int, counts: npt.ArrayLike) -> list[ContactEvent]:
        """Process a reading of both fingers, (D,) as `Touch.values`."""
        vector = np.asarray(counts)
        events = (self.fingers[name].update(stamp_ns, vector[index]) for name, index in self._columns.items())
        return [event for event in events if event is not None]

    def reset(self) -> None:
        """Discard the references of both fingers."""
        for finger in self.fingers.values():
            finger.reset()


class LiveTare:
    """The tare of a stream of readings of a sensor: its readings while it touches nothing. Not thread-safe.

    A reading is at rest if neither finger is in contact, nor will be within `_LAG_NS`: a contact is detected a moment after it has begun.
    The tare is the median over the last `_WINDOW_NS` of rest, and 0 for channels whose rest level is zero; during a grasp, the tare from
    before is kept, and ages.

    Args:
        channels: What the values of a reading are.

    Attributes:
        fault: Why the last rest gives no tare, such as a dead sensor.
    """

    def __init__(self, channels: Channels = BIOTAC) -> None:
        self.fault = ""
        self._channels = channels
        self._detector = ContactDetector(channels)
        self._recent: deque[tuple[int, Float32]] = deque(maxlen=_MAX_READINGS)
        self._rest: list[Float32] = []
        self._rest_ns = 0
        self._rest_s = 0.0
        self._tare: Touch | None = None
        self._since_renewal = 0

    def update(self, stamp_ns: int, counts: Float32, now_s: float) -> None:
        """Add a reading (D,), as `Touch.values`, whose stamp [ns] the `TouchBuffer` has accepted.

        `now_s` is the time of a clock that never goes back [s].
        """
        self._detector.update(stamp_ns, counts)
        touching = [finger.touching for finger in self._detector.fingers.values()]
        if any(touching):
            self._recent.clear()  # its end may belong to the contact; the rest before it is kept
            return
        self._recent.append((stamp_ns, counts))
        while self._recent[0][0] < stamp_ns - _LAG_NS - _WINDOW_NS:
            self._recent.popleft()
        self._since_renewal += 1
        if self._since_renewal >= _REFERENCE_INTERVAL and None not in touching:
            self._renew(stamp_ns, now_s)

    def tare(self, now_s: float, max_age_s: float) -> Touch | None:
        """Return the median of the last rest; None if there is no recent one, or a sensor does not work."""
        if self.age_s(now_s) > max_age_s:
            return None
        if self._tare is None and not self.fault:
            touch = rest_of(np.median(self._rest, axis=0), self._channels)
            self.fault = "; ".join(touch_faults(touch))
            self._tare = None if self.fault else touch
        return self._tare

    def age_s(self, now_s: float) -> float:
        """Return the time since the last rest [s]; infinite if there was none."""
        return now_s - self._rest_s if self._rest else float("inf")

    def exclude(self, contact_ns: int, release_ns: int) -> None:
        """Reset a tare from within a reported grasp [ns, ns), such as where the stream began in contact."""
        if self._rest and contact_ns <= self._rest_ns < release_ns:
            self.reset()

    def reset(self) -> None:
        """Restart, after the clock has jumped or a contact was taken for rest."""
        self._detector.reset()
        self._recent.clear()
        self._rest = []
        self._tare = None
        self.fault = ""

    def _renew(self, stamp_ns: int, now_s: float) -> None:
        newest = stamp_ns - _LAG_NS
        rest = [counts for stamp, counts in self._recent if stamp <= newest]
        if len(rest) >= 5 and newest - self._recent[0][0] >= 0.8 * _WINDOW_NS:
            self._rest = rest
            self._rest_ns = newest
            self._rest_s = now_s - _LAG_NS / SECOND_NS
            self._tare = None
            self.fault = ""
            self._since_renewal = 0


def _resting_noise(readings: Float64, channels: Channels) -> Float64:
    """Return (M,) standard deviation of each value in (T, M) readings of a finger without contact, at least what is stated."""
    spread = 1.4826 * np.median(np.abs(readings - np.median(readings, axis=0)), axis=0)
    stated = [value for channel in channels.channels for value in [channel.noise or channel.resolution] * channel.size]
    return np.asarray(np.maximum(spread, stated), np.float64)


def contact_scores(counts: npt.ArrayLike, rest: npt.ArrayLike, channels: Channels = BIOTAC) -> Float64:
    """Return (T, F) scores of the fingers; above 1 a finger is in contact.

    Args:
        counts: (T, D) readings.
        rest: (R, D) readings without contact: their median is the reference.
        channels: Of a touch.
    """
    values, resting = np.asarray(counts, np.float64), np.asarray(rest, np.float64)
    scores = []
    for index in channels.finger_columns.values():
        still = resting[:, index]
        change = (values[:, index] - np.median(still, axis=0)) / _resting_noise(still, channels)
        scores.append(_scores(change, channels))
    return np.stack(scores, axis=-1)


def find_contact(
    stamps_ns: Int64, counts: npt.ArrayLike, rest: int, channels: Channels = BIOTAC
) -> tuple[SeriesContact, ...]:
    """Find the contact of each finger in a series of readings, by `contact_scores`.

    It is looked for after the readings at rest. What is slower than `_LAG_NS` is drift and no contact, as online, and what ends within
    `SETTLE_NS` is a glitch, such as lost packets.

    Args:
        stamps_ns: (T,) int64 ascending stamps [ns].
        counts: (T, D) readings.
        rest: How many of them are at rest, at the beginning; at least one.
        channels: What the D values are.
    """
    values = np.asarray(counts, np.float64)
    return tuple(_contact_of(stamps_ns, values[:, own], rest, channels) for own in channels.finger_columns.values())


def _contact_of(stamps_ns: Int64, values: Float64, rest: int, channels: Channels) -> SeriesContact:
    """Find the longest contact of a finger, in its (T, M) values."""
    noise = _resting_noise(values[:rest], channels)

    def scores(part: Float64, reference: Float64) -> Float64:
        return _scores((part - reference) / noise, channels)

    score = scores(values, np.median(values[:rest], axis=0))
    begin, drifted, found = rest, False, list[tuple[int, int]]()
    while (onset := _first_run(score > 1.0, begin)) < len(values):
        onset_ns = stamps_ns[onset]
        first, last, soon = np.searchsorted(
            stamps_ns, [onset_ns - _LAG_NS - _WINDOW_NS, onset_ns - _LAG_NS, onset_ns + _SOON_NS]
        )
        recent, after = values[first:last], values[onset : max(soon, onset + _CONFIRM)]
        if len(recent) >= _CONFIRM:
            reference = np.median(recent, axis=0)
            if _first_run(scores(after, reference) > 1.0, 0) == len(after):
                drifted |= bool(scores(reference, np.median(values[:rest], axis=0)) > _DRIFTED)
                score, begin = scores(values, reference), onset
                continue
        begin = _first_run(score < RELEASE_LEVEL, onset)
        if begin == len(values) or stamps_ns[begin] - onset_ns >= SETTLE_NS:
            found.append((onset, begin))
    if not found:
        return SeriesContact(None, 0, several=False, drifted=drifted, early=False)
    onset, end = max(found, key=lambda pair: int(stamps_ns[pair[1] - 1] - stamps_ns[pair[0]]))
    early = onset == rest and bool(score[rest - 1] > 1.0)
    return SeriesContact(onset, end, several=len(found) > 1, drifted=drifted, early=early)


def _first_run(true: Bool, begin: int) -> int:
    """Return the first of `_CONFIRM` consecutive readings from one on for which something is true; their number if there are none."""
    later = true[begin:]
    if len(later) < _CONFIRM:
        return len(true)
    run = np.lib.stride_tricks.sliding_window_view(later, _CONFIRM).all(axis=1)
    return begin + int(run.argmax()) if run.any() else len(true)


def _scores(change: Float64, channels: Channels) -> Float64:
    """Return (...) scores of (..., M) changes of a finger in units of each value's noise."""
    scores, first = [], 0
    for channel in channels.channels:
        part, first = change[..., first : first + channel.size], first + channel.size
        if channel.size == 1:
            scores.append(np.abs(part[..., 0]) / _SINGLE_LIMIT)
        else:
            scores.append(np.sqrt(np.mean(np.square(part), axis=-1)) / _TAXEL_LIMIT)
    return np.asarray(np.maximum.reduce(scores), np.float64)
