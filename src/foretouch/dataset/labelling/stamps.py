# SPDX-License-Identifier: Apache-2.0
"""Stamps of readings, as tables hold them: numbers of seconds or nanoseconds, and dates of any library and zone."""

from datetime import UTC, datetime, timedelta
from numbers import Number
from typing import Any, Final

import numpy as np

from foretouch.errors import DatasetError, shown
from foretouch.types import SECOND_NS, AnyArray, Float64, Int64
from foretouch.types.arrays import is_missing, numbers, unmasked

_FACTOR: Final = 2.0  # between the rate of the stamps and the rate in the sensor's description
_GAP: Final = 5.0  # usual steps from a reading to the next
_LARGEST_NS: Final = 2**62  # of a stamp
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_CURE: Final = "give numbers, or dates as pandas.to_datetime(column, utc=True) makes them"
_KINDS: Final = {"U": "texts", "S": "texts", "b": "truth values", "c": "complex numbers"}


def read_stamps(name: str, given: Any, rows: Float64, sensor_hz: float) -> Int64:
    """Read the stamps of a series.

    Args:
        name: `stamps_ns` or `stamps_s`, which says the unit of numbers.
        given: (T,) numbers, datetime64, timedelta64, or `datetime` of any zone; those without a zone are in UTC.
        rows: (T, D) the readings, which show whether stamps lost their digits.
        sensor_hz: Readings per second, by the description of the sensor.

    Returns:
        (T,) int64 ascending stamps [ns].

    Raises:
        DatasetError: If they are fewer or more, one is missing, they are no times, go back, or have too few digits for the readings.
    """
    count = len(rows)
    times, unit = _times(name, given)
    if times.shape != (count,):
        raise DatasetError(f"{name}: shape {times.shape} is not ({count},), one of each reading")
    stamps = _nanoseconds(name, times, unit, sensor_hz)
    if (back := np.flatnonzero(np.diff(stamps) < 0)).size:
        by = (stamps[back[0]] - stamps[back[0] + 1]) / SECOND_NS
        raise DatasetError(f"{name}: go back by {by:g} s at reading {back[0] + 1}")
    same = np.diff(stamps) == 0
    changing = (rows[1:] != rows[:-1])[same].any()  # else a reading was stored repeatedly
    if 2 * np.count_nonzero(same) >= count and changing:
        fault = stamp_faults(stamps, sensor_hz)["equal_stamps"]
        cure = f"write them with all digits, such as %.9f, or give rate_hz={sensor_hz:g}"
        raise DatasetError(f"{name}: {fault}: were they rounded, to whole seconds or six digits? {cure}")
    return stamps


def _times(name: str, given: Any) -> tuple[AnyArray, int]:
    """Return times as numbers, and the nanoseconds that one of them has."""
    try:
        times = np.atleast_1d(unmasked(given))
    except ValueError as err:
        raise DatasetError(f"{name}: {err}") from err
    missing = np.isnat(times) if times.dtype.kind in "mM" else np.isnan(times) if times.dtype.kind == "f" else False
    if times.dtype == object:
        missing = np.reshape([is_missing(item) for item in times.ravel()], times.shape)
    if np.any(missing):
        reading = int(np.flatnonzero(missing)[0])
        raise DatasetError(
            f"{name}: reading {reading} has no time: it is missing; leave the reading out, or give its time"
        )
    if times.dtype.kind in "mM":
        seconds = times.astype(f"{times.dtype.kind}8[s]").astype(np.int64)
        _check_range(name, float(np.abs(seconds).max(initial=0)) * SECOND_NS, 1)
        return times.astype(f"{times.dtype.kind}8[ns]").astype(np.int64), 1
    if times.dtype == object and times.size and all(isinstance(item, datetime | timedelta) for item in times.ravel()):
        stamps = [_ns_of(item) for item in times.ravel()]
        _check_range(name, float(max(map(abs, stamps))), 1)
        return np.array(stamps, np.int64).reshape(times.shape), 1
    if times.dtype == object:
        for item in times.ravel():
            if not isinstance(item, Number) or isinstance(item, complex):
                raise DatasetError(f"{name}: are of type {type(item).__name__}, such as {shown(item, 40)}: {_CURE}")
        times = numbers(times, name, DatasetError)
    if times.dtype.kind not in "iuf":
        kind = _KINDS.get(times.dtype.kind, f"of dtype {times.dtype}")
        raise DatasetError(f"{name}: are {kind}, such as {shown(times.ravel()[:1].tolist(), 40)}: {_CURE}")
    return times, 1 if name == "stamps_ns" else SECOND_NS


def _ns_of(time: datetime | timedelta) -> int:
    """Return the nanoseconds since 1970, or of a duration; those of pandas have three more digits."""
    own = getattr(time, "value", None)  # of Timestamp and Timedelta of pandas
    if isinstance(own, int):
        return own
    if isinstance(time, datetime):
        time = (time if time.tzinfo else time.replace(tzinfo=UTC)) - _EPOCH
    return (time.days * 86_400 + time.seconds) * SECOND_NS + time.microseconds * 1000


def _nanoseconds(name: str, times: AnyArray, unit: int, sensor_hz: float) -> Int64:
    """Return (T,) times as int64 [ns]; a `DatasetError` if they are no times, or their type holds too few digits."""
    if not np.isfinite(times).all():
        raise DatasetError(f"{name}: are not finite numbers")
    largest = float(np.abs(times.astype(np.float64)).max())
    _check_range(name, largest, unit)
    if times.dtype.kind != "f":
        return times.astype(np.int64) * unit
    grain = float(np.spacing(times.dtype.type(largest))) * unit / SECOND_NS
    if grain > 0.5 / sensor_hz:
        single = times.dtype.itemsize < 8
        cure = "read them as float64, or as whole nanoseconds" if single else "give whole nanoseconds"
        raise DatasetError(f"{name}: {times.dtype} holds {largest:g} in steps of {grain:g} s: {cure}")
    return np.rint(times.astype(np.float64) * unit).astype(np.int64)


def _check_range(name: str, largest: float, unit: int) -> None:
    if largest * unit > _LARGEST_NS:
        raise DatasetError(f"{name}: {largest:g} is no time in {'ns' if unit == 1 else 's'}")


def stamp_faults(stamps_ns: Int64, rate_hz: float) -> dict[str, str]:
    """Hold the stamps of a series against the rate of its sensor.

    Args:
        stamps_ns: (T,) int64 ascending stamps [ns].
        rate_hz: Readings per second, by the description of the sensor.

    Returns:
        What is wrong, in words with numbers, by flag: `equal_stamps`, `stamp_gaps`, `other_rate`.
    """
    steps = np.diff(stamps_ns)
    later = steps[steps > 0]
    faults = {}
    if len(later) < len(steps):
        runs = np.diff(np.flatnonzero(np.concatenate([[True], steps > 0, [True]])))
        faults["equal_stamps"] = (
            f"{runs.max()} readings have the same stamp, and {len(stamps_ns)} only {len(runs)} different"
        )
    if not len(later):
        return faults
    usual = float(np.median(later))
    gaps = later[later > _GAP * max(usual, SECOND_NS / rate_hz)]
    if len(gaps):
        faults["stamp_gaps"] = f"{len(gaps)} gaps, the longest of {gaps.max() / SECOND_NS:.3g} s"
    seen = SECOND_NS / usual
    if len(later) > 1 and not rate_hz / _FACTOR <= seen <= rate_hz * _FACTOR:
        unit = ": another unit?" if not 1e-2 < seen / rate_hz < 1e2 else ""
        faults["other_rate"] = f"stamps of {seen:.3g} Hz, and the sensor is described with {rate_hz:g} Hz{unit}"
    return faults
