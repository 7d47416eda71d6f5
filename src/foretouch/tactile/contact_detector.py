# SPDX-License-Identifier: Apache-2.0
"""When a BioTac SP touches something, told from its counts as they come.

Rule, for one finger: a reading is compared with that of the same finger a moment ago without contact. Every change
is divided by the noise of its channel, and

    score = max(rms over the 24 electrodes of |change| / noise / electrode_limit,  |PDC change| / noise / pdc_limit)

so that contact is where the score exceeds 1. The noise is the spread at rest (1.4826 times the median absolute
deviation), but at least what sensors showed without contact: 4.4 counts (electrodes), 0.4 counts (PDC). With noise
alone the rms is 1 +- 0.14, so the limit of 3 stands far off; one electrode that moves by fifteen
deviations reaches it, and so do all together that move by 2.8. A steady touch relaxes by up to 8 counts/s: over 45 s of
such recordings the limit of 3 gives no false alarm, 2.5 gives two.

Contact begins with the first of `confirm` readings in a row above 1 and ends with the first of `confirm` in a row
below `release_level`. The reference follows drift: it is the median over `window_s` that end `lag_s` ago, and stands
still during contact. A contact that lasts longer than `longest_s` is taken for a drift, and ends.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import TactileError
from foretouch.tactile.modalities import columns
from foretouch.types import ELECTRODES, Float64

__all__ = [
    "FINGER_COLUMNS",
    "ContactChange",
    "ContactConfig",
    "ContactDetector",
    "FingerContact",
    "contact_scores",
    "find_contact",
    "resting_noise",
]

FINGER_COLUMNS: Final = {"TH": columns(("PDC_TH", "E_TH")), "MF": columns(("PDC_MF", "E_MF"))}
"""Where PDC and the electrodes of each finger stand in a vector of 50 counts."""

_MAD_TO_SIGMA: Final = 1.4826
_RENEW: Final = 10  # readings between two looks at the reference: it moves slowly, and a median takes time
_SECOND_NS: Final = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class ContactConfig(Settings):
    """Settings of the contact detector."""

    electrode_limit: float = setting(
        3.0,
        "Root mean square of the electrodes' changes that is contact",
        unit="deviations",
        minimum=1.2,
        maximum=100.0,
    )
    pdc_limit: float = setting(
        12.0, "Change of the static pressure that is contact", unit="deviations", minimum=3.0, maximum=1e4
    )
    release_level: float = setting(
        0.7, "Score below which contact has ended, relative to that of its begin", minimum=0.1, maximum=1.0
    )
    confirm: int = setting(3, "Readings in a row that decide", minimum=1, maximum=100)
    window_s: float = setting(0.5, "Time that the reference is taken over", unit="s", minimum=0.05, maximum=60.0)
    lag_s: float = setting(
        0.3,
        "Time between the reference and now: a slower contact is taken for drift",
        unit="s",
        minimum=0.0,
        maximum=60.0,
    )
    electrode_noise: float = setting(4.4, "Least deviation of an electrode at rest", unit="counts", minimum=0.1)
    pdc_noise: float = setting(0.4, "Least deviation of the static pressure at rest", unit="counts", minimum=0.01)
    longest_s: float = setting(120.0, "Contact beyond this is drift", unit="s", minimum=1.0, maximum=1e6)


@dataclass(frozen=True, kw_only=True)
class ContactChange:
    """Contact began or ended.

    Attributes:
        finger: `TH` or `MF`.
        kind: Which of both.
        stamp_ns: Of the first reading that shows it [ns]; it was decided a few readings later.
    """

    finger: str
    kind: Literal["onset", "release"]
    stamp_ns: int


class FingerContact:
    """The detector of one finger.

    Args:
        finger: Its name.
        config: Settings.
        with_pdc: Whether readings are PDC and 24 electrodes; otherwise the electrodes alone.

    Attributes:
        touching: Whether it is in contact; None before there is a reference.
        score: Of the last reading; 0 before there is a reference.
    """

    def __init__(self, finger: str, config: ContactConfig, *, with_pdc: bool = True) -> None:
        self.finger = finger
        self.config = config
        self.touching: bool | None = None
        self.score = 0.0
        self._with_pdc = with_pdc
        self._width = ELECTRODES + with_pdc
        self._recent: deque[tuple[int, Float64]] = deque()
        self._reference: Float64 | None = None
        self._noise = np.empty(0)
        self._since_renewal = 0
        self._decision = _Decision(config)

    def update(self, stamp_ns: int, counts: npt.ArrayLike) -> ContactChange | None:
        """Take a reading; stamps that go back are taken as they are.

        Args:
            stamp_ns: Of the reading [ns].
            counts: (25,) PDC and electrodes, or (24,) electrodes alone.

        Raises:
            TactileError: If the length is another.
        """
        reading = np.asarray(counts, np.float64)
        if reading.shape != (self._width,):
            raise TactileError(f"{self.finger}: {reading.shape} is not ({self._width},), a reading of one finger")
        if not self.touching:
            self._follow(stamp_ns, reading)
        if self._reference is None:
            return None
        self.score = float(_scores((reading - self._reference) / self._noise, self.config, with_pdc=self._with_pdc))
        change = self._decision.update(stamp_ns, self.score)
        self.touching = self._decision.touching
        if change is None:
            return None
        if change[0] == "release" and self.score >= self.config.release_level:
            self.forget()  # it is no release but a drift, and the reference is of no use any more
        self._recent.clear()  # what led to the contact is no reference for the next one
        return ContactChange(finger=self.finger, kind=change[0], stamp_ns=change[1])

    def forget(self) -> None:
        """Begin anew: the clock has jumped, or the sensor was away."""
        self.touching, self.score, self._reference = None, 0.0, None
        self._recent.clear()
        self._decision = _Decision(self.config)

    def _follow(self, stamp_ns: int, reading: Float64) -> None:
        """Renew the reference from the readings without contact."""
        self._recent.append((stamp_ns, reading))
        newest = stamp_ns - round(self.config.lag_s * _SECOND_NS)
        oldest = newest - round(self.config.window_s * _SECOND_NS)
        while self._recent and self._recent[0][0] < oldest:
            self._recent.popleft()
        self._since_renewal += 1
        spans = stamp_ns - self._recent[0][0] >= round((self.config.lag_s + self.config.window_s) * 0.9 * _SECOND_NS)
        if not spans or (self._reference is not None and self._since_renewal < _RENEW):
            return
        window = np.array([counts for stamp, counts in self._recent if stamp <= newest])
        if len(window) > 1:
            self._reference = np.median(window, axis=0)
            self._noise = resting_noise(window, self.config, with_pdc=self._with_pdc)
            self._since_renewal = 0


class ContactDetector:
    """The detectors of thumb and middle finger, and when both hold.

    Attributes:
        fingers: By name.
    """

    def __init__(self, config: ContactConfig | None = None) -> None:
        self.config = config or ContactConfig()
        self.fingers = {name: FingerContact(name, self.config) for name in FINGER_COLUMNS}

    @property
    def holding(self) -> bool:
        """Whether both fingers are in contact."""
        return all(finger.touching for finger in self.fingers.values())

    def update(self, stamp_ns: int, counts: npt.ArrayLike) -> list[ContactChange]:
        """Take a reading of both fingers, (50,) as `Touch.vector()`."""
        vector = np.asarray(counts)
        changes = (self.fingers[name].update(stamp_ns, vector[place]) for name, place in FINGER_COLUMNS.items())
        return [change for change in changes if change is not None]

    def forget(self) -> None:
        """Begin anew."""
        for finger in self.fingers.values():
            finger.forget()


def resting_noise(readings: npt.ArrayLike, config: ContactConfig, *, with_pdc: bool = True) -> Float64:
    """Deviation of each channel of one finger, at least that of the settings.

    Args:
        readings: (T, 25), or (T, 24) without PDC, nothing touched.
        config: Settings.
        with_pdc: Whether the first column is PDC.
    """
    values = np.asarray(readings, np.float64)
    spread = _MAD_TO_SIGMA * np.median(np.abs(values - np.median(values, axis=0)), axis=0)
    least = np.full(values.shape[1], config.electrode_noise)
    if with_pdc:
        least[0] = config.pdc_noise
    return np.asarray(np.maximum(spread, least), np.float64)


def contact_scores(counts: npt.ArrayLike, rest: npt.ArrayLike, config: ContactConfig | None = None) -> Float64:
    """(T, 2) scores of thumb and middle finger; above 1 a finger is in contact.

    Args:
        counts: (T, 50) readings.
        rest: (R, 50) readings without contact: their median is the reference.
        config: Settings.
    """
    settings = config or ContactConfig()
    values, resting = np.asarray(counts, np.float64), np.asarray(rest, np.float64)
    scores = []
    for place in FINGER_COLUMNS.values():
        noise = resting_noise(resting[:, place], settings)
        change = (values[:, place] - np.median(resting[:, place], axis=0)) / noise
        scores.append(_scores(change, settings, with_pdc=True))
    return np.stack(scores, axis=-1)


def find_contact(
    stamps_ns: Sequence[int] | npt.NDArray[np.int64],
    counts: npt.ArrayLike,
    rest: npt.ArrayLike,
    config: ContactConfig | None = None,
) -> tuple[int | None, int | None]:
    """Stamps of the first contact of thumb and middle finger in a series [ns]; None where there is none.

    Args:
        stamps_ns: (T,) [ns].
        counts: (T, 50) readings.
        rest: (R, 50) readings without contact.
        config: Settings.
    """
    settings = config or ContactConfig()
    onsets: list[int | None] = []
    for scores in contact_scores(counts, rest, settings).T:
        decision = _Decision(settings)
        changes = (decision.update(int(stamp), float(score)) for stamp, score in zip(stamps_ns, scores, strict=True))
        onsets.append(next((change[1] for change in changes if change is not None), None))
    return onsets[0], onsets[1]


class _Decision:
    """Scores to contact, with hysteresis."""

    def __init__(self, config: ContactConfig) -> None:
        self.touching = False
        self._config = config
        self._in_a_row = 0
        self._first_ns = 0
        self._since_ns = 0

    def update(self, stamp_ns: int, score: float) -> tuple[Literal["onset", "release"], int] | None:
        drift = self.touching and stamp_ns - self._since_ns > self._config.longest_s * _SECOND_NS
        against = score < self._config.release_level if self.touching else score > 1.0
        if not against and not drift:
            self._in_a_row = 0
            return None
        if self._in_a_row == 0:
            self._first_ns = stamp_ns
        self._in_a_row += 1
        if self._in_a_row < self._config.confirm and not drift:
            return None
        self.touching, self._in_a_row = not self.touching, 0
        self._since_ns = self._first_ns
        return ("onset" if self.touching else "release"), self._first_ns


def _scores(change: Float64, config: ContactConfig, *, with_pdc: bool) -> Float64:
    """Score of (..., 25) or (..., 24) changes, each in units of its channel's noise."""
    electrodes = change[..., 1:] if with_pdc else change
    score = np.sqrt(np.mean(np.square(electrodes), axis=-1)) / config.electrode_limit
    return np.asarray(np.maximum(score, np.abs(change[..., 0]) / config.pdc_limit) if with_pdc else score, np.float64)
