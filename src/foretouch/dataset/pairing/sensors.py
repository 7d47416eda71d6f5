# SPDX-License-Identifier: Apache-2.0
"""What the stream of tactile readings shows by itself: contacts of both fingers, and whether the sensors work."""

import numpy as np

from foretouch.dataset.pairing.cut import Interval
from foretouch.tactile import FULL_SCALE, biotac_touch, touch_faults
from foretouch.tactile.contact_detector import FINGER_COLUMNS, ContactConfig, ContactDetector
from foretouch.types import Float32

ALIVE = "alive"
NO_DATA = "no data"
_CONSTANT_SAMPLES = 3000  # of PDC, 30 s at 100 Hz: that of a working sensor moves by 0.06 counts or more at rest (std)
_FROZEN_SAMPLES = 200  # the same 25 noisy counts over and over: the driver repeats an old message


class ContactEpisodes:
    """Finds episodes in which both fingers are in contact. Not thread-safe."""

    def __init__(self, config: ContactConfig | None = None) -> None:
        self._detector = ContactDetector(config)
        self._onset: dict[str, int] = {}
        self._holding = False

    @property
    def touching(self) -> tuple[str, ...]:
        """The fingers that are in contact."""
        return tuple(name for name, finger in self._detector.fingers.items() if finger.touching)

    def update(self, stamp_ns: int, counts: Float32) -> Interval | None:
        """Add a reading of both fingers; gives the episode that ends with it, from the first touch to the first release.

        Its contact is when the other finger touched; stamps are the sensor's.
        """
        changes = self._detector.update(stamp_ns, counts)
        for change in changes:
            if change.kind == "onset":
                self._onset[change.finger] = change.stamp_ns
        before, self._holding = self._holding, self._detector.holding
        if not before or self._holding:
            return None
        first, both = sorted(self._onset.values())
        release = min(one.stamp_ns for one in changes if one.kind == "release")
        return Interval(start=first, contact=both, release=release)

    def reset(self) -> None:
        """Restart detection, after the clock has jumped."""
        self._detector.reset()
        self._holding = False


class SensorHealth:
    """State of thumb and middle finger: `states` by finger are `alive`, `no data`, or the fault. Not thread-safe."""

    def __init__(self) -> None:
        self.states = dict.fromkeys(FINGER_COLUMNS, NO_DATA)
        self._last: dict[str, Float32] = {}
        self._same = dict.fromkeys(FINGER_COLUMNS, 0)
        self._same_pdc = dict.fromkeys(FINGER_COLUMNS, 0)

    def update(self, counts: Float32) -> None:
        """Add a reading, (50,) as `Touch.values`."""
        plausible = float(counts.min()) > 0.0 and float(counts.max()) <= FULL_SCALE
        faults = () if plausible else touch_faults(biotac_touch(counts))
        for finger, columns in FINGER_COLUMNS.items():
            own = (fault for fault in faults if fault.partition(":")[0].partition("[")[0].endswith(finger.lower()))
            self.states[finger] = next(own, self._state(finger, counts[columns]))

    def silence(self) -> None:
        """No reading has come for a while."""
        self.states = dict.fromkeys(FINGER_COLUMNS, NO_DATA)

    def _state(self, finger: str, counts: Float32) -> str:
        """Whether counts or PDC alone, (25,), are the same for too long."""
        same = np.full(len(counts), False) if finger not in self._last else self._last[finger] == counts
        self._same_pdc[finger] = self._same_pdc[finger] + 1 if same[0] else 0
        self._same[finger] = self._same[finger] + 1 if same.all() else 0
        self._last[finger] = counts
        if self._same[finger] >= _FROZEN_SAMPLES:
            return f"frozen: the same {self._same[finger] + 1} times, or simulated without noise"
        if self._same_pdc[finger] >= _CONSTANT_SAMPLES:
            return f"dead: PDC constant at {counts[0]:g} over {self._same_pdc[finger] + 1} readings"
        return ALIVE
