# SPDX-License-Identifier: Apache-2.0
"""Make samples of the arrays of a grasp, whatever they were read from; what breaks a rule is named and refused."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from foretouch.dataset.identity import check_id, name_of
from foretouch.dataset.labelling.cut import PairingError, label_series
from foretouch.dataset.labelling.stamps import read_stamps, stamp_faults
from foretouch.errors import DatasetError, none_of, require_type, shown
from foretouch.tactile.description import Sensor
from foretouch.types import (
    APPROACH,
    HOLD,
    NO_CLOUD,
    NO_GRASP,
    REST,
    SECOND_NS,
    AnyArray,
    Bool,
    Cloud,
    Float64,
    Grasp,
    Int64,
    Outcome,
    Plane,
    Sample,
    Touch,
    TouchSeries,
)
from foretouch.types.arrays import is_missing, numbers
from foretouch.types.channels import Channels

Missing = Literal["refuse", "hold", "mask"]
Remarks = dict[str, list[str]]  # the samples to look at, by what is remarkable

_OUTCOMES: Final[dict[Any, Outcome]] = {True: "success", False: "failure", None: "unknown"}


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspArrays:
    """The arrays of one grasp, as pandas or h5py read them. Masked numbers, None and NA of pandas are missing, as NaN.

    Attributes:
        object: Name of the object; a whole number or bytes become its text.
        values: By modality (channel and finger, such as E_TH) the numbers of all taxels: (T, M) of T readings, also with
            more dimensions behind the first, or (M,) of one reading, which is the touch.
        id: Name of the grasp among the grasps of its object; by default a number.
        stamps_ns: (T,) whole numbers [ns] since 1970, or dates of any zone: datetime64, `datetime`, columns of pandas; those
            without a zone are in UTC. timedelta64 is the time since `start_s`.
        stamps_s: (T,) [s] since 1970 or since `start_s`; or give `rate_hz`. Of one reading a number.
        rate_hz: Readings per second, where the source has no stamps.
        start_s: Added to `stamps_s`, or the time of the first reading [s].
        rest: Number of readings without contact at the beginning. The contact detector finds the contact after them, and
            the touch is the median from 0.3 s later on.
        tare: A reading without contact by modality, (M,) each, instead of the median of the readings at rest.
        others: By name (T,) further numbers.
        outcome: True or "success", False or "failure"; None if it is not known.
        cloud: The object's points, seen before the grasp.
        grasp: The contacts that were grasped, in the frame of the cloud.
        table: Under the object, in the frame of the cloud, as `segment` finds it; None takes the camera to look straight down on it.
        note: Where it comes from.

    Raises:
        DatasetError: If a field has the wrong type.
    """

    object: str
    values: Mapping[str, npt.ArrayLike]
    id: str = ""
    stamps_ns: npt.ArrayLike | None = None
    stamps_s: npt.ArrayLike | None = None
    rate_hz: float | None = None
    start_s: float = 0.0
    rest: int = 0
    tare: Mapping[str, npt.ArrayLike] | None = None
    others: Mapping[str, npt.ArrayLike] | None = None
    outcome: bool | str | None = None
    cloud: Cloud = NO_CLOUD
    grasp: Grasp = NO_GRASP
    table: Plane | None = None
    note: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.rest, int | np.integer) or self.rest < 0:
            raise DatasetError(f"rest: {self.rest} is not a number of readings")
        if not isinstance(self.cloud, Cloud) or not isinstance(self.grasp, Grasp):
            raise DatasetError("cloud, grasp: are not a Cloud and a Grasp of foretouch")
        for name in ("start_s", "rate_hz"):
            if (value := getattr(self, name)) is None:
                continue
            number = numbers(value, name, DatasetError)
            if number.shape or not np.isfinite(number):
                raise DatasetError(f"{name}: {shown(value)} is not finite")
            object.__setattr__(self, name, float(number))

    def sample(self, sensor: Sensor, missing: Missing, remarks: Remarks) -> Sample:
        """Make the sample of the grasp.

        Args:
            sensor: The sensor that was read.
            missing: What becomes of numbers that are not finite: "refuse", "hold" takes the reading before, "mask" stores
                them as taxels that were not read.
            remarks: Gets the name of the grasp under `missing_numbers` and `no_contact`, where one of these is the case.

        Raises:
            DatasetError: If a field breaks a rule.
        """
        if missing not in get_args(Missing):
            raise DatasetError(f"missing: {none_of(missing, get_args(Missing))}")
        channels, label = sensor.channels, name_of(self.object, "object")
        own = name_of(self.id, "id")
        name = f"{label}/{own}" if own else ""
        check_id(name or f"{label}/1", label)
        counts = _joined(self.values, channels, "values")
        rows, whole, gone = _complete(counts.reshape(-1, channels.size), channels, missing, "values")
        if self.rest > len(rows):
            raise DatasetError(f"rest: {self.rest} readings without contact are more than all {len(rows)}")
        others, lost = self._others(len(rows), missing)
        flags = _range_flags(rows, channels)
        if gone + lost:
            flags.insert(0, "missing_numbers")
            remarks.setdefault(f"missing_numbers ({missing})", []).append(f"{name or label}: {gone + lost}")
        stamps = self._stamps(rows, sensor.config.update_rate)
        if self.rate_hz is not None:
            flags.append("stamped_by_rate")
        tare = None if self.tare is None else Touch(_joined(self.tare, channels, "tare").reshape(-1), channels)
        sample = Sample(
            id=name,
            object=label,
            cloud=self.cloud,
            grasp=self.grasp,
            table=self.table,
            tare=tare,
            stamp_ns=int(stamps[0]),
            outcome=_outcome(self.outcome),
            note="" if is_missing(self.note) else str(self.note),
            flags=tuple(flags),
        )
        if counts.ndim == 1:
            extra = {key: float(column[0]) for key, column in others.items()}
            return replace(sample, touch=Touch(rows[0], channels), extra=extra)
        phases = np.where(np.arange(len(rows)) < self.rest, REST, APPROACH).astype(np.uint8)
        faults = stamp_faults(stamps, sensor.config.update_rate)
        series = TouchSeries(stamps, rows.astype(np.float32), phases, others)
        sample = replace(sample, series=series, flags=(*flags, *faults))
        return self._labelled(sample, rows, whole, channels, remarks) if self.rest else sample

    def _labelled(self, sample: Sample, rows: Float64, whole: Float64, channels: Channels, remarks: Remarks) -> Sample:
        """Label a sample by the rules of the recorder; without a label, a flag or a remark says why."""
        name, series = sample.id or sample.object, sample.series
        assert series is not None  # noqa: S101  it has readings at rest
        try:
            label = label_series(series.stamps_ns, rows, self.rest, channels, complete=whole)
        except PairingError as err:
            remarks.setdefault(err.reason, []).append(f"{name}: {err}, so no touch")
            return replace(sample, flags=(*sample.flags, err.reason))
        if label.touch is None:
            found = "none found" if label.contact_ns is None else "only one of less than 0.3 s at the end"
            found += f" after {self.rest} readings at rest, so no touch"
            remarks.setdefault("no_contact", []).append(f"{name}: {found}")
        for flag, text in label.flags.items():
            if label.touch is not None or not flag.startswith("no_contact"):
                remarks.setdefault(flag, []).append(f"{name}: {text}")
        series.phases[label.hold] = HOLD
        return replace(
            sample,
            touch=label.touch,
            tare=label.tare if sample.tare is None else sample.tare,
            contact_ns=label.contact_ns,
            detector=label.detector,
            flags=(*sample.flags, *label.flags),
        )

    def _others(self, count: int, missing: Missing) -> tuple[dict[str, AnyArray], int]:
        """Return the further numbers of `count` readings as float32 by name, and how many of them are missing."""
        require_type(self.others, Mapping | None, "others", "not a mapping of names to their numbers", DatasetError)
        further = {
            name_of(key, "others"): numbers(other, f"others: {key}", DatasetError).reshape(-1)
            for key, other in (self.others or {}).items()
        }
        for key, column in further.items():
            if len(column) != count:
                raise DatasetError(f"others: {key}: {len(column)} numbers are not {count} readings")
        names = tuple(further)
        columns = np.array([further[key] for key in names]).reshape(len(names), count).T
        filled, _, lost = _complete(columns, names, missing, "others")
        return dict(zip(names, filled.T.astype(np.float32), strict=True)), lost

    def _stamps(self, rows: Float64, sensor_hz: float) -> Int64:
        """Return (T,) int64 [ns]; a `DatasetError` if there are fewer or more, they go back, or have too few digits for the readings."""
        ways = {"stamps_ns": self.stamps_ns, "stamps_s": self.stamps_s, "rate_hz": self.rate_hz}
        given = [name for name, value in ways.items() if value is not None]
        count, start = len(rows), round(self.start_s * SECOND_NS)
        if len(given) != 1 and (given or count > 1):
            raise DatasetError(f"{', '.join(ways)}: give one of them, not {' and '.join(given) or 'none'}")
        if not given or self.rate_hz is not None:
            if self.rate_hz is not None and self.rate_hz <= 0.0:
                raise DatasetError(f"rate_hz: {self.rate_hz} is not above 0")
            step = SECOND_NS / (self.rate_hz or 1.0)
            return np.asarray(start + np.rint(np.arange(count) * step).astype(np.int64))
        (name,) = given
        return np.asarray(start + read_stamps(name, ways[name], rows, sensor_hz), np.int64)


def _joined(values: Mapping[str, npt.ArrayLike], channels: Channels, what: str) -> Float64:
    """Return (T, D) or (D,) numbers of all modalities; a `DatasetError` names one that is missing, not known or of another size."""
    if not isinstance(values, Mapping):
        raise DatasetError(f"{what}: give a mapping of {', '.join(channels.modalities)} to their arrays")
    if unknown := [key for key in values if key not in channels.modalities]:
        raise DatasetError(f"{what}: {none_of(unknown[0], channels.modalities)}")
    absent = [key for key in channels.modalities if key not in values]
    if absent:
        raise DatasetError(f"{what}: {', '.join(absent)} of {channels.sensor} are missing")
    parts: list[Float64] = []
    for key in channels.modalities:
        part = numbers(values[key], f"{what}: {key}", DatasetError)
        size = channels.channel_of[key].size
        series = part.ndim > 1 or (size == 1 and part.ndim == 1 and part.size > 1)
        shape = (len(part), size) if series else (size,)
        if part.size != np.prod(shape) or (parts and parts[0].shape[:-1] != shape[:-1]):
            raise DatasetError(f"{what}: {key}: shape {part.shape} is not (readings, {size}), as many as of the others")
        parts.append(part.reshape(shape))
    if not parts[0].size:
        raise DatasetError(f"{what}: holds no reading")
    return np.concatenate(parts, axis=-1)


def _complete(
    rows: Float64, names: Channels | tuple[str, ...], missing: Missing, what: str
) -> tuple[Float64, Float64, int]:
    """Return the (T, D) numbers to store, without those that are not finite; the same with the reading before held; their number."""
    with np.errstate(over="ignore", invalid="ignore"):
        gone = ~np.isfinite(rows.astype(np.float32))
    if not gone.any():
        return rows, rows, 0
    reading, column = (int(index) for index in np.argwhere(gone)[0])
    taxels: Bool = np.zeros(rows.shape[1], np.bool_)
    if not isinstance(names, tuple):
        taxels |= names.of_taxels
    label = names[column] if isinstance(names, tuple) else _named(names, column)
    where = f"{what}: {label} of reading {reading} is {rows[reading, column]:g}"
    count = f"{gone.any(axis=1).sum()} of {len(rows)} readings hold such"
    if missing == "refuse":
        raise DatasetError(
            f"{where}; {count}: missing='hold' takes the reading before, missing='mask' stores taxels as not read"
        )
    if missing == "mask" and gone[:, ~taxels].any():
        raise DatasetError(f"{where}; {count}: only taxels can be masked: missing='hold' takes the reading before")
    if (gone.all(axis=0) & (~taxels if missing == "mask" else True)).any():
        raise DatasetError(
            f"{where}, and so in all readings: leave it out, or declare the taxel dead or absent and use missing='mask'"
        )
    last = np.where(gone, -1, np.arange(len(rows))[:, None])
    last = np.maximum.accumulate(last, axis=0)
    first = np.argmin(gone, axis=0)  # before the first reading that is finite there is none to hold
    held = np.take_along_axis(rows, np.where(last < 0, first, last), axis=0)
    if missing == "hold":
        return held, held, int(gone.sum())
    return np.where(gone, np.nan, rows), np.where(np.isfinite(held), held, 0.0), int(gone.sum())


def _named(channels: Channels, column: int) -> str:
    """Return a modality and the number of its value, such as E_TH[3], by the column of a touch."""
    key, columns = next((key, own) for key, own in channels.modality_columns.items() if column in own)
    return f"{key}[{list(columns).index(column)}]"


def _range_flags(rows: Float64, channels: Channels) -> list[str]:
    """Return a flag, if a working sensor cannot have sent some of (T, D) values; if most of a finger, they are of another unit."""
    outside = (rows < channels.low) | (rows > channels.high)
    for key, columns in channels.modality_columns.items():
        if outside[:, columns].mean() > 0.5:
            reading, column = (int(index) for index in np.argwhere(outside[:, columns])[0])
            channel, value = channels.channel_of[key], rows[reading, columns[column]]
            rule = (
                f"is not between {channel.low:g} and {channel.high:g} {channel.unit}, as most of {key}: another unit?"
            )
            raise DatasetError(f"values: {value:g} of {key}[{column}] {rule}")
    return ["out_of_range"] if outside.any() else []


def _outcome(outcome: Any) -> Outcome:
    """Return an outcome by its name or truth value; a missing one is not known."""
    known = {**_OUTCOMES, **{name: name for name in _OUTCOMES.values()}}
    if is_missing(outcome):
        return "unknown"
    plain = outcome.item() if isinstance(outcome, np.generic) else outcome
    if not isinstance(plain, str | int | float) or plain not in known:
        raise DatasetError(f"outcome: {none_of(plain, _OUTCOMES.values())}; they are also True, False and None")
    return known[plain]
