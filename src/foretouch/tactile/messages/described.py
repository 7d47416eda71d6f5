# SPDX-License-Identifier: Apache-2.0
"""Readings of any sensor that has a description, by the field paths in it; a message type needs no code.

In a reading for a touch, a taxel that is not valid has the mean of the nearest valid ones, as a dead pixel of a camera has; a
finger of which half or more are not valid was not read.
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from foretouch.errors import ConfigError, TactileError, shown
from foretouch.tactile.description import STAMP_UNITS, Sensor
from foretouch.tactile.field_path import FieldPath
from foretouch.tactile.messages.table import ARRIVAL_STAMPED, TactileConfig, TactileReader, TactileReading
from foretouch.types import Bool, Float64, stamp_ns

_FLOAT32 = float(np.finfo(np.float32).max)


def make_reader(config: TactileConfig) -> TactileReader:
    """Return the decoder of the sensor that is described, for the chosen fingers; a `ConfigError` for an unknown finger, or a channel without noise and range."""
    sensor = config.described
    _require_noise(sensor)
    names = [scalar.name for scalar in sensor.config.scalars if not scalar.predicted]
    others = tuple(f"{name}_{finger}" for finger in sensor.channels.fingers for name in names)
    flags = () if sensor.config.source.stamp else (ARRIVAL_STAMPED,)
    return TactileReader(SensorReader(sensor, config.fingers).read, others, flags, sensor)


def _require_noise(sensor: Sensor) -> None:
    """Refuse a channel of floats with neither noise nor range: there is no least change that means contact."""
    for scalar in (*sensor.config.scalars, *sensor.config.values):
        if scalar.predicted and not scalar.noise and not all(map(math.isfinite, scalar.limits)):
            raise ConfigError(
                f"sensor: {sensor.config.name}: {scalar.name}: state its noise or its range in the description"
            )


class SensorReader:
    """Decoder of the messages of a described sensor: F fingers, N taxels, C values of a taxel, S scalars of a finger.

    Args:
        sensor: The sensor.
        fingers: Names of the fingers to read; by default those that grasp.

    Raises:
        ConfigError: If the sensor has no such finger.
    """

    def __init__(self, sensor: Sensor, fingers: Sequence[str] = ()) -> None:
        config = sensor.config
        self.sensor = sensor
        self._fingers = [
            (finger.name, FieldPath(finger.field), np.isin(np.arange(sensor.size), finger.dead))
            for finger in config.chosen_fingers(fingers)
        ]
        self._values, self._scalars = (
            [FieldPath(channel.field) for channel in part] for part in (config.values, config.scalars)
        )
        self._range = np.clip([value.limits for value in config.values], -_FLOAT32, _FLOAT32).T
        self._marks = np.array([scalar.name in config.source.invalid for scalar in config.scalars], np.bool_)
        self._mark_range = np.array([scalar.limits for scalar in config.scalars]).reshape(-1, 2).T
        self._stamp = FieldPath(config.source.stamp)
        self._predicted_scalars = np.array([scalar.predicted for scalar in config.scalars], np.bool_)
        self._predicted_values = np.array([value.predicted for value in config.values], np.bool_)

    def read(self, message: Any) -> TactileReading:
        """Decode a message; values of a finger that was not read are NaN.

        A `TactileError` names the finger and the field that it lacks, or whose length is another, or a scalar that is not
        finite. Taxels that are not valid are counted by reason: `not_read`, `dead`, `out_of_range`.
        """
        size = (len(self._fingers), self.sensor.size)
        values = np.full((*size, len(self._values)), np.nan)
        scalars, valid = np.full((size[0], len(self._scalars)), np.nan), np.zeros(size, np.bool_)
        invalid: Counter[str] = Counter()
        for number, (finger, path, dead) in enumerate(self._fingers):
            try:
                content = path.get(message)
                scalars[number] = [_numbers(scalar, content, 1)[0] for scalar in self._scalars]
                if (self._marks & ~_within(scalars[number], self._mark_range)).any():
                    invalid["not_read"] += size[1]
                    continue
                series = [_numbers(value, content, self.sensor.series_size) for value in self._values]
                values[number] = np.transpose(series)[self.sensor.places]
            except TactileError as err:
                raise TactileError(f"{self.sensor.config.name}: {finger}: {err}") from err
            inside = _within(values[number], self._range).all(axis=1)
            valid[number] = inside & ~dead
            invalid.update(dead=int(dead.sum()), out_of_range=int((~inside & ~dead).sum()))
        stamp = self._stamp_ns(message)
        with np.errstate(over="ignore"):  # what exceeds float32 is not valid
            sent, numbers = values.astype(np.float32), scalars.astype(np.float32)
        if not np.isfinite(numbers).all():
            raise TactileError(f"{self.sensor.config.name}: a scalar is not finite")
        touched = numbers[:, self._predicted_scalars]
        for row, usable in enumerate(valid):
            if 2 * np.count_nonzero(usable) <= len(usable):
                sent[row], touched[row] = np.nan, np.nan
            elif not usable.all():
                self.sensor.layout.fill(sent[row], usable)
        counts = np.concatenate([touched.T.ravel(), sent[..., self._predicted_values].transpose(2, 0, 1).ravel()])
        reasons = {reason: count for reason, count in invalid.items() if count}
        return TactileReading(stamp, counts, numbers[:, ~self._predicted_scalars].ravel(), invalid=reasons)

    def _stamp_ns(self, message: Any) -> int | None:
        if not self._stamp.text:
            return None
        stamp = self._stamp.get(message)
        if hasattr(stamp, "nanosec"):
            return stamp_ns(stamp)
        if isinstance(stamp, np.generic):
            stamp = stamp.item()
        unit_ns = STAMP_UNITS[self.sensor.config.source.stamp_unit]
        if not isinstance(stamp, int | float) or not 0 <= stamp < 2**63 / unit_ns:  # NaN is not either
            raise TactileError(f"{self._stamp.text}: {shown(stamp)} is not a time")
        whole = int(stamp // 1)
        return whole * unit_ns + round(float(stamp - whole) * unit_ns)


def _within(values: Float64, limits: Float64) -> Bool:
    return np.asarray((values >= limits[0]) & (values <= limits[1]), np.bool_)  # NaN is not


def _numbers(path: FieldPath, content: Any, count: int) -> Float64:
    try:
        numbers = np.asarray(path.get(content), np.float64)
    except (TypeError, ValueError):
        raise TactileError(f"{path.text}: holds no numbers") from None
    if numbers.size != count:
        raise TactileError(f"{path.text}: {numbers.size} numbers, not {count}")
    return numbers.ravel()
