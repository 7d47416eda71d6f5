# SPDX-License-Identifier: Apache-2.0
"""What the stream of tactile readings shows by itself: contacts of both fingers, and whether the sensors work."""

import numpy as np

from foretouch.dataset.labelling.cut import Interval, may_freeze
from foretouch.tactile import BIOTAC, touch_faults
from foretouch.tactile.contact_detector import ContactDetector
from foretouch.types import Float32, Touch
from foretouch.types.channels import Channels

ALIVE = "alive"
NO_DATA = "no data"
_CONSTANT_SAMPLES = 3000  # of a single value with noise, 30 s at 100 Hz: PDC moves by 0.06 counts or more at rest (std)
_FROZEN_SAMPLES = 200  # the same noisy values over and over: the driver repeats an old message


class ContactEpisodes:
    """Finds episodes in which both fingers are in contact. Not thread-safe."""

    def __init__(self, channels: Channels = BIOTAC) -> None:
        self._detector = ContactDetector(channels)
        self._onset: dict[str, int] = {}
        self._holding = False
        self._last_ns = 0

    @property
    def touching(self) -> tuple[str, ...]:
        """The fingers that are in contact."""
        return tuple(name for name, finger in self._detector.fingers.items() if finger.touching)

    @property
    def held_ns(self) -> int | None:
        """Time from the touch of the other finger to the last reading [ns]; -1 if one finger touches, None if none does."""
        if self._holding:
            return self._last_ns - max(self._onset.values())
        return -1 if self.touching else None

    def update(self, stamp_ns: int, counts: Float32) -> Interval | None:
        """Add a reading of both fingers; gives the episode that ends with it, from the first touch to the first release.

        Its contact is when the other finger touched; stamps are the sensor's.
        """
        changes, self._last_ns = self._detector.update(stamp_ns, counts), stamp_ns
        for change in changes:
            if change.kind == "onset":
                self._onset[change.finger] = change.stamp_ns
        before, self._holding = self._holding, self._detector.holding
        if not before or self._holding:
            return None
        first, both = sorted(self._onset.values())
        release = min(change.stamp_ns for change in changes if change.kind == "release")
        return Interval(start=first, contact=both, release=release)

    def reset(self) -> None:
        """Restart detection, after the clock has jumped."""
        self._detector.reset()
        self._holding = False


class SensorHealth:
    """State of both fingers: `states` by finger are `alive`, `no data`, or the fault. Not thread-safe."""

    def __init__(self, channels: Channels = BIOTAC) -> None:
        self._channels = channels
        self._last: dict[str, Float32] = {}
        self._same = dict.fromkeys(channels.fingers, 0)
        first = np.cumsum([0, *(channel.size for channel in channels.channels)]).tolist()
        pairs = zip(first, channels.channels, strict=False)
        self._single = {
            k: channel.name for k, channel in pairs if channel.size == 1 and channel.noise > 0.0
        }  # by place in a finger
        self._constant = {finger: np.zeros(len(self._single), np.int64) for finger in channels.fingers}
        self.silence()

    def update(self, counts: Float32) -> None:
        """Add a reading, (D,) as `Touch.values`; NaN of a finger that was not read."""
        touch = Touch(counts.astype(np.float64), self._channels)
        for finger, columns in self._channels.finger_columns.items():
            state = self._state(finger, counts[columns])
            self.states[finger] = next(iter(touch_faults(touch, finger)), state)

    def silence(self) -> None:
        """Set the state of both fingers after no reading has come for a while."""
        self.states = dict.fromkeys(self._channels.fingers, NO_DATA)

    def _state(self, finger: str, counts: Float32) -> str:
        """Return whether all values of a finger, or a single one with noise, are the same for too long."""
        same = np.full(len(counts), False) if finger not in self._last else self._last[finger] == counts
        frozen = same.all() and may_freeze(counts, self._channels.tared[self._channels.finger_columns[finger]])
        self._same[finger] = self._same[finger] + 1 if frozen else 0
        constant = self._constant[finger] = (self._constant[finger] + 1) * same[list(self._single)]
        self._last[finger] = counts
        if self._same[finger] >= _FROZEN_SAMPLES:
            return f"frozen: the same {self._same[finger] + 1} times, or simulated without noise"
        if (constant >= _CONSTANT_SAMPLES).any():
            k, name = list(self._single.items())[constant.argmax()]
            return f"dead: {name} constant at {counts[k]:g} over {constant.max() + 1} readings"
        return ALIVE
