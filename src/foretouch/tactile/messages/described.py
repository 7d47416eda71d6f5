# SPDX-License-Identifier: Apache-2.0
"""Readings of any sensor that has a description, by the field paths in it; no code of its own is needed for a message type."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from foretouch.errors import TactileError, shown
from foretouch.tactile.description import STAMP_UNITS, FingerConfig, Sensor
from foretouch.tactile.field_path import FieldPath
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Bool, Float32, Float64


@dataclass(frozen=True, eq=False)
class SensorReading:
    """The content of one message: F fingers, N taxels, C values of a taxel, S scalars of a finger."""

    stamp_ns: int | None  # time of measurement [ns]; None where the messages have none
    values: Float32  # (F, N, C) float32, as sent; NaN of a finger that was not read
    scalars: Float32  # (F, S) float32; NaN where one was not read or is out of range
    valid: Bool  # (F, N) taxels of which all values can be used
    invalid: Mapping[str, int]  # taxels that are not valid, by reason: `not_read`, `dead`, `out_of_range`


class SensorReader:
    """Decoder of the messages of a described sensor.

    Args:
        sensor: The sensor.
        fingers: Names of the fingers to read; by default those that grasp.

    Raises:
        ConfigError: If the sensor has no such finger.
    """

    def __init__(self, sensor: Sensor, fingers: Sequence[str] = ()) -> None:
        config = sensor.config
        self.sensor = sensor
        self._fingers = [(one, FieldPath(one.field)) for one in config.chosen_fingers(fingers)]
        self._values = [(FieldPath(one.field), *one.limits) for one in config.values]
        self._scalars = [(FieldPath(one.field), *one.limits) for one in config.scalars]
        self._marks = [one.name in config.source.invalid for one in config.scalars]
        self._stamp = FieldPath(config.source.stamp)

    def read(self, message: Any) -> SensorReading:
        """Decode a message; a `TactileError` names the finger and the field that it lacks, or whose length is another."""
        size = (len(self._fingers), self.sensor.size)
        values = np.full((*size, len(self._values)), np.nan)
        scalars, valid = np.full((size[0], len(self._scalars)), np.nan), np.zeros(size, np.bool_)
        invalid: Counter[str] = Counter()
        for number, (finger, path) in enumerate(self._fingers):
            try:
                self._read_finger(finger, path.get(message), values[number], scalars[number], valid[number], invalid)
            except TactileError as err:
                raise TactileError(f"{self.sensor.config.name}: {finger.name}: {err}") from err
        counts = {reason: count for reason, count in invalid.items() if count}
        return SensorReading(
            self._stamp_ns(message), values.astype(np.float32), scalars.astype(np.float32), valid, counts
        )

    def _read_finger(
        self, finger: FingerConfig, content: Any, values: Float64, scalars: Float64, valid: Bool, invalid: Counter[str]
    ) -> None:
        for column, (path, low, high) in enumerate(self._scalars):
            (value,) = _numbers(path, content, 1)
            scalars[column] = value if low <= value <= high else np.nan
        if np.isnan(scalars[self._marks]).any():
            invalid["not_read"] += len(valid)
            return
        inside = np.ones(len(valid), np.bool_)
        for column, (path, low, high) in enumerate(self._values):
            values[:, column] = _numbers(path, content, len(valid))
            inside &= (low <= values[:, column]) & (values[:, column] <= high)
        dead = np.isin(np.arange(len(valid)), finger.dead)
        valid[:] = inside & ~dead
        invalid.update(dead=int(dead.sum()), out_of_range=int((~inside & ~dead).sum()))

    def _stamp_ns(self, message: Any) -> int | None:
        if not self._stamp.text:
            return None
        found = self._stamp.get(message)
        if hasattr(found, "nanosec"):
            return stamp_ns(found)
        if isinstance(found, np.generic):
            found = found.item()
        unit_ns = STAMP_UNITS[self.sensor.config.source.stamp_unit]
        if not isinstance(found, int | float) or not 0 <= found < 2**63 / unit_ns:  # NaN is not either
            raise TactileError(f"{self._stamp.text}: {shown(found)} is no time")
        whole = int(found // 1)
        return whole * unit_ns + round(float(found - whole) * unit_ns)


def _numbers(path: FieldPath, content: Any, count: int) -> Float64:
    try:
        found = np.asarray(path.get(content), np.float64)
    except (TypeError, ValueError):
        raise TactileError(f"{path.text}: holds no numbers") from None
    if found.size != count:
        raise TactileError(f"{path.text}: {found.size} numbers, not {count}")
    return found.ravel()
