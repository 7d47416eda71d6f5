# SPDX-License-Identifier: Apache-2.0
"""Evaluates once for each grasp whether it will hold, from a reading of three BioTac SP, and says why where it cannot."""

import math
from collections import deque
from typing import Any, Final

import numpy as np

from foretouch.errors import TactileError
from foretouch.models.touch_hold import OUTSIDE, load_touch_hold
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.tactile.contact_detector import SETTLE_NS, contact_scores
from foretouch.tactile.description import Sensor
from foretouch.tactile.messages.described import SensorReader
from foretouch.types import Float32
from foretouch_msgs.msg import Status, TouchHold

_REST_S: Final = 1.0  # between two readings without contact that are kept


class HoldEvaluator:
    """Evaluates the grasps of a session, whose messages are of the `sensor`; `last` is the message of the latest one."""

    def __init__(self, sensor: Sensor) -> None:
        self._model, self._card = load_touch_hold()
        self._fingers = tuple(self._card["config"]["fingers"])
        self.last = self._message(0, reason="no grasp has been held yet")
        self._evaluated = False
        self._rest = deque[Float32](maxlen=2)  # the older is surely from before the contact that is found
        self._rest_s = -math.inf
        self._reader: SensorReader | None = None
        known = {finger.name for finger in sensor.config.fingers}
        if sensor.sha256 == self._card["sensor_sha256"] and known.issuperset(self._fingers):
            self._sensor = Sensor(sensor.config.replace(grasp=self._fingers), sensor.layout)
            self._reader = SensorReader(self._sensor)

    def update(self, message: Any, stamp_ns: int, held_ns: int | None, now_s: float) -> TouchHold | None:
        """Add a tactile message; gives the answer if the grasp has now been held for `SETTLE_NS`.

        Args:
            message: Of the type that the sensor's description names.
            stamp_ns: Its stamp [ns].
            held_ns: For how long both fingers that the recorder follows have touched [ns], -1 if one of them does, None at rest.
            now_s: Time of a clock that never goes back [s].
        """
        if held_ns is None:
            self._evaluated = False
            if now_s - self._rest_s >= _REST_S and self._reader is not None:
                self._rest_s = now_s
                try:
                    self._rest.append(self._reader.read(message).counts)
                except TactileError:
                    self._rest.clear()
        if self._evaluated or held_ns is None or held_ns < SETTLE_NS:
            return None
        self._evaluated = True
        try:
            self.last = self._message(stamp_ns, chance=self._chance(message))
        except TactileError as err:
            self.last = self._message(stamp_ns, reason=str(err))
        return self.last

    def _chance(self, message: Any) -> float:
        """Compute the chance that the grasp holds; a `TactileError` says why it cannot be computed."""
        if self._reader is None:
            raise TactileError(f"the sensor is not {self._card['sensor_name']} on {', '.join(self._fingers)}")
        reading = self._reader.read(message)
        if reading.invalid:
            counted = ", ".join(f"{count} {reason}" for reason, count in reading.invalid.items())
            raise TactileError(f"electrodes cannot be used: {counted}")
        if not self._rest or not np.isfinite(self._rest[0]).all():
            raise TactileError("there is no reading without contact that shows which fingers touch")
        scores = contact_scores([reading.counts], [self._rest[0]], self._sensor.channels)[0]
        apart = [finger for finger, score in zip(self._fingers, scores, strict=True) if score <= 1.0]
        if apart:
            raise TactileError(
                f"{', '.join(apart)} does not touch, and the model is of grasps with {', '.join(self._fingers)}"
            )
        # Pressures of the fingers come first, then the electrodes of each.
        readings = reading.counts[len(self._fingers) :].reshape(1, len(self._fingers), -1).astype(np.float64)
        share = self._model.outside(readings)[0]
        if share > OUTSIDE:
            raise TactileError(f"{share:.0%} of the pattern is out of the range of training")
        return float(self._model.chance(readings)[0])

    def _message(self, stamp_ns: int, *, chance: float = math.nan, reason: str = "") -> TouchHold:
        return TouchHold(
            header=header_to_msg("", stamp_ns),
            fingers=list(self._fingers),
            chance=chance,
            status=Status.REFUSED if reason else Status.OK,
            reason=reason,
            model=self._card["name"],
            model_sha256=self._card["sha256"],
        )
