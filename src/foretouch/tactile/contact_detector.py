# SPDX-License-Identifier: Apache-2.0
"""Online contact detection from the counts of a BioTac SP.

Each reading of a finger is compared with a recent reference of the same finger without contact. Every change is
divided by the noise of its channel, and

    score = max(rms over the 24 electrodes of |change| / noise / electrode_limit,  |PDC change| / noise / pdc_limit)

so that a score above 1 is contact. The noise is the spread at rest (1.4826 times the median absolute deviation), but
at least what sensors showed without contact: 4.4 counts (electrodes), 0.4 counts (PDC). With noise alone the rms is
1 +- 0.14, far below the limit of 3; one electrode that moves by fifteen deviations reaches it, and so do all
together that move by 2.8. A steady touch relaxes by up to 8 counts/s: over 45 s of such recordings the limit of 3
causes no false alarm, 2.5 causes two.

Contact begins with the first of `confirm` consecutive readings above 1 and ends with the first of `confirm` consecutive
readings below `release_level`. The reference follows drift: it is the median over `window_s` that end `lag_s` ago, and
is frozen during contact. A contact that lasts longer than `longest_s` is considered drift and is ended.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.tactile import columns
from foretouch.tactile.description import packaged_sensor
from foretouch.types import Float64, Int64

#: Columns of PDC and the electrodes of each finger in a vector of 50 counts.
FINGER_COLUMNS: Final = {"TH": columns(("PDC_TH", "E_TH")), "MF": columns(("PDC_MF", "E_MF"))}

_REFERENCE_INTERVAL: Final = 10  # readings between two updates of the reference: it drifts slowly, a median is costly
_MAX_READINGS: Final = 20_000  # of the longest window and lag, 120 s, at 100 Hz; stamps may repeat
_SECOND_NS: Final = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class ContactConfig(Settings):
    """Settings of the contact detector."""

    electrode_limit: float = setting(
        3.0,
        "Root mean square of the electrodes' changes that counts as contact",
        unit="deviations",
        bounds=(1.2, 100.0),
    )
    pdc_limit: float = setting(
        12.0, "Change of the static pressure that counts as contact", unit="deviations", bounds=(3.0, 1e4)
    )
    release_level: float = setting(
        0.7, "Score below which contact ends, relative to the score at which it begins", bounds=(0.1, 1.0)
    )
    confirm: int = setting(3, "Consecutive readings that confirm a change", bounds=(1, 100))
    window_s: float = setting(0.5, "Time over which the reference is computed", bounds=(0.05, 60.0))
    lag_s: float = setting(
        0.3, "Time between the reference and now: a slower contact is considered drift", bounds=(0.0, 60.0)
    )
    longest_s: float = setting(120.0, "Longer contacts are considered drift", bounds=(1.0, 1e6))


class ContactEvent(NamedTuple):
    """The onset or the release of a contact."""

    finger: str  # `TH` or `MF`
    kind: Literal["onset", "release"]
    stamp_ns: int  # stamp of the first reading that shows it [ns]; it is confirmed a few readings later


class FingerContact:
    """Contact detector of one finger.

    Attributes:
        touching: Whether the finger is in contact; None until a reference exists.
        score: Score of the last reading; 0 until a reference exists.
    """

    def __init__(self, finger: str, config: ContactConfig) -> None:
        self.finger = finger
        self.config = config
        self.touching: bool | None = None
        self.score = 0.0
        self._recent: deque[tuple[int, Float64]] = deque(maxlen=_MAX_READINGS)
        self._reference: Float64 | None = None
        self._noise = np.empty(0)
        self._since_update = 0
        self._state = _Hysteresis(config)

    def update(self, stamp_ns: int, counts: npt.ArrayLike) -> ContactEvent | None:
        """Process a reading, (25,) PDC and electrodes with its stamp [ns]; stamps may go back."""
        reading = np.asarray(counts, np.float64)
        if not self.touching:
            self._update_reference(stamp_ns, reading)
        if self._reference is None:
            return None
        self.score = float(_scores((reading - self._reference) / self._noise, self.config))
        change = self._state.update(stamp_ns, self.score)
        self.touching = self._state.touching
        if change is None:
            return None
        if change[0] == "release" and self.score >= self.config.release_level:
            self.reset()  # not a release but drift: the reference is no longer valid
        self._recent.clear()  # readings before this contact are no reference for the next one
        return ContactEvent(self.finger, *change)

    def reset(self) -> None:
        """Discard the reference, for instance after a clock jump or a sensor dropout."""
        self.touching, self.score, self._reference = None, 0.0, None
        self._recent.clear()
        self._state = _Hysteresis(self.config)

    def _update_reference(self, stamp_ns: int, reading: Float64) -> None:
        """Compute the reference from the recent readings without contact."""
        self._recent.append((stamp_ns, reading))
        newest = stamp_ns - round(self.config.lag_s * _SECOND_NS)
        oldest = newest - round(self.config.window_s * _SECOND_NS)
        while self._recent and self._recent[0][0] < oldest:
            self._recent.popleft()
        self._since_update += 1
        spans = stamp_ns - self._recent[0][0] >= round((self.config.lag_s + self.config.window_s) * 0.9 * _SECOND_NS)
        if not spans or (self._reference is not None and self._since_update < _REFERENCE_INTERVAL):
            return
        window = np.array([counts for stamp, counts in self._recent if stamp <= newest])
        if len(window) > 1:
            self._reference = np.median(window, axis=0)
            self._noise = _resting_noise(window)
            self._since_update = 0


class ContactDetector:
    """Contact detectors of thumb and middle finger.

    Attributes:
        fingers: Detector of each finger, by name.
    """

    def __init__(self, config: ContactConfig | None = None) -> None:
        self.config = config or ContactConfig()
        self.fingers = {name: FingerContact(name, self.config) for name in FINGER_COLUMNS}

    @property
    def holding(self) -> bool:
        """Whether both fingers are in contact."""
        return all(finger.touching for finger in self.fingers.values())

    def update(self, stamp_ns: int, counts: npt.ArrayLike) -> list[ContactEvent]:
        """Process a reading of both fingers, (50,) as `Touch.values`."""
        vector = np.asarray(counts)
        events = (self.fingers[name].update(stamp_ns, vector[index]) for name, index in FINGER_COLUMNS.items())
        return [event for event in events if event is not None]

    def reset(self) -> None:
        """Discard the references of both fingers."""
        for finger in self.fingers.values():
            finger.reset()


def _resting_noise(readings: Float64) -> Float64:
    """(25,) standard deviation of each channel in (T, 25) readings without contact, at least what sensors showed."""
    spread = 1.4826 * np.median(np.abs(readings - np.median(readings, axis=0)), axis=0)
    sensor = packaged_sensor("biotac_sp")
    noise = {one.name: one.noise or 0.0 for one in (*sensor.config.scalars, *sensor.config.values)}
    return np.asarray(np.maximum(spread, [noise["PDC"], *[noise["E"]] * sensor.size]), np.float64)


def contact_scores(counts: npt.ArrayLike, rest: npt.ArrayLike, config: ContactConfig | None = None) -> Float64:
    """(T, 2) scores of thumb and middle finger; above 1 a finger is in contact.

    Args:
        counts: (T, 50) readings.
        rest: (R, 50) readings without contact: their median is the reference.
        config: Settings.
    """
    settings = config or ContactConfig()
    values, resting = np.asarray(counts, np.float64), np.asarray(rest, np.float64)
    scores = [
        _scores((values[:, index] - np.median(resting[:, index], axis=0)) / _resting_noise(resting[:, index]), settings)
        for index in FINGER_COLUMNS.values()
    ]
    return np.stack(scores, axis=-1)


def find_contact(
    stamps_ns: Sequence[int] | Int64, counts: npt.ArrayLike, rest: npt.ArrayLike, config: ContactConfig | None = None
) -> tuple[int | None, int | None]:
    """First contacts of thumb and middle finger among (T,) stamps [ns], None without one (see `contact_scores`)."""
    settings = config or ContactConfig()
    onsets: list[int | None] = []
    for scores in contact_scores(counts, rest, settings).T:
        state = _Hysteresis(settings)
        changes = (state.update(int(stamp), float(score)) for stamp, score in zip(stamps_ns, scores, strict=True))
        onsets.append(next((change[1] for change in changes if change is not None), None))
    return onsets[0], onsets[1]


class _Hysteresis:
    """Contact state from scores, with hysteresis and confirmation."""

    def __init__(self, config: ContactConfig) -> None:
        self.touching = False
        self._config = config
        self._consecutive = 0
        self._first_ns = 0
        self._since_ns = 0

    def update(self, stamp_ns: int, score: float) -> tuple[Literal["onset", "release"], int] | None:
        drift = self.touching and stamp_ns - self._since_ns > self._config.longest_s * _SECOND_NS
        against = score < self._config.release_level if self.touching else score > 1.0
        if not against and not drift:
            self._consecutive = 0
            return None
        if self._consecutive == 0:
            self._first_ns = stamp_ns
        self._consecutive += 1
        if self._consecutive < self._config.confirm and not drift:
            return None
        self.touching, self._consecutive = not self.touching, 0
        self._since_ns = self._first_ns
        return ("onset" if self.touching else "release"), self._first_ns


def _scores(change: Float64, config: ContactConfig) -> Float64:
    """(...) scores of (..., 25) changes in units of each channel's noise."""
    score = np.sqrt(np.mean(np.square(change[..., 1:]), axis=-1)) / config.electrode_limit
    return np.asarray(np.maximum(score, np.abs(change[..., 0]) / config.pdc_limit), np.float64)
