# SPDX-License-Identifier: Apache-2.0
"""Write samples of any source to a recorded dataset: `foretouch.write`.

A sample is a `SampleRecord`, as a dataset gives it, or a mapping with the arrays of a grasp, as pandas or h5py read them.
Stamps and missing numbers are checked here, whatever the source.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from foretouch.dataset.files import new_folder
from foretouch.dataset.pairing.matcher import SETTLE_NS
from foretouch.dataset.record import (
    APPROACH,
    HOLD,
    REST,
    Identity,
    Outcome,
    SampleRecord,
    TouchSeries,
    check_id,
    readings,
)
from foretouch.dataset.recording.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import SampleSet
from foretouch.errors import DatasetError, ForetouchError, none_of
from foretouch.files import system_errors
from foretouch.tactile.contact_detector import RELEASE_LEVEL, contact_scores, find_contact
from foretouch.tactile.description import Sensor, load_sensor
from foretouch.tactile.readings import rest_of
from foretouch.types import NO_CLOUD, NO_GRASP, SECOND_NS, AnyArray, Bool, Cloud, Float64, Grasp, Int64, Sample, Touch
from foretouch.types.channels import Channels

Missing = Literal["refuse", "hold", "mask"]
Remarks = dict[str, tuple[int, str]]  # number of samples and the first of them, by what is remarkable

_OUTCOMES: Final[dict[Any, Outcome]] = {True: "success", False: "failure", None: "unknown"}
_FACTOR: Final = 2.0  # between the rate of the stamps and that of the sensor's description
_GAP: Final = 5.0  # usual steps from a reading to the next


@dataclass(kw_only=True)
class WriteResult:
    """What was written, and what to look at."""

    samples: int = 0  # samples that were written
    labelled: int = 0  # those with a touch
    readings: int = 0  # those in their series, or a touch without one
    left_out: Counter[str] = field(default_factory=Counter)  # what was not written, by reason
    notes: tuple[str, ...] = ()  # what to look at: stamps, missing numbers, what a bag states of its files


def write(
    path: str | Path,
    samples: "SampleSet | Iterable[SampleRecord | Sample | Mapping[str, Any]]",
    sensor: str | Path | Sensor = "biotac_sp",
    *,
    missing: Missing = "refuse",
    hand: Mapping[str, str] | None = None,
    camera: Mapping[str, str] | None = None,
) -> WriteResult:
    """Write samples to a recorded dataset, which is created or extended.

    Args:
        path: Folder of the dataset. A new one appears as a whole or not at all.
        samples: A dataset, or samples of any source: `Sample`, `SampleRecord`, or mappings with the arguments of `sample_of`, such as
            `{"object": "mug", "values": {"P_left": (T, M), "P_right": (T, M)}, "stamps_s": (T,), "rest": 40}`.
        sensor: Name or file of the description of the sensor. A dataset brings its own.
        missing: What becomes of numbers that are not finite in mappings. "refuse" refuses them by name; "hold" takes the
            reading before; "mask" stores them as taxels that were not read.
        hand: Name, serial number and so on of the hand; by default the name of the sensor.
        camera: The same of the camera; by default none.

    Returns:
        The counts, and remarks on stamps and missing numbers, which are warned of, too.

    Raises:
        DatasetError: If a sample breaks a rule. The message names the sample, the field, the rule, and what to do.
        FileError: If the dataset is of another hand, camera or sensor, or cannot be written.
    """
    records: Iterable[SampleRecord | Sample | Mapping[str, Any]]
    if isinstance(samples, SampleSet):
        own, facts, records = samples.sensor, samples.identity, samples.records()
    else:
        own, facts, records = sensor if isinstance(sensor, Sensor) else load_sensor(sensor), Identity(), samples
    identity = Identity(
        hand=hand or facts.hand or {"name": own.config.name}, camera=camera or facts.camera or {"name": "none"}
    )
    result, remarks = WriteResult(), Remarks()

    def made() -> Iterable[SampleRecord]:
        for number, record in enumerate(records):
            if isinstance(record, SampleRecord | Sample):
                yield record if isinstance(record, SampleRecord) else SampleRecord(sample=record)
                continue
            try:
                yield sample_of(own, missing=missing, remarks=remarks, **record)
            except (TypeError, ValueError, AttributeError, ForetouchError) as err:  # of keys and values of other types
                name = (
                    f"{record.get('object')}/{record.get('id') or number}"
                    if isinstance(record, Mapping)
                    else type(record).__name__
                )
                raise DatasetError(f"sample {number} ({name}): {str(err).removeprefix('sample_of() ')}") from err

    write_records(Path(path), made(), identity, own, result, remarks=remarks)
    for line in result.notes:
        warnings.warn(line, stacklevel=2)
    return result


def write_records(
    path: Path,
    records: Iterable[SampleRecord],
    identity: Identity,
    sensor: Sensor,
    result: WriteResult,
    progress: Callable[[], None] = lambda: None,
    remarks: Remarks | None = None,
) -> None:
    """Write the records to a dataset and add to the result; their stamps are held against the rate of the sensor; see `write`."""
    remarks = {} if remarks is None else remarks
    with ExitStack() as stack:
        folder = path if path.exists() else stack.enter_context(new_folder(path))
        config = RecordingConfig(fsync_samples=0)  # synchronised once, at the end
        with system_errors(path), RecordingWriter(folder, identity, config, sensor=sensor) as writer:
            for record in records:
                series = readings(record)
                faults = (
                    {} if record.series is None else stamp_faults(record.series.stamps_ns, sensor.config.update_rate)
                )
                name = writer.append(record)
                for flag, text in faults.items():
                    _remark(remarks, flag, f"{name}: {text}")
                result.samples += 1
                result.labelled += record.sample.touch is not None
                result.readings += 0 if series is None else len(series.stamps_ns)
                progress()
    result.notes += tuple(f"{kind}: {count} samples, first {first}" for kind, (count, first) in remarks.items())


def _remark(remarks: Remarks | None, kind: str, text: str) -> None:
    if remarks is not None:
        count, first = remarks.get(kind, (0, text))
        remarks[kind] = (count + 1, first)


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


def sample_of(
    sensor: Sensor,
    *,
    object: str,  # noqa: A002  as it is called in samples
    values: Mapping[str, npt.ArrayLike],
    id: str = "",  # noqa: A002
    stamps_ns: npt.ArrayLike | None = None,
    stamps_s: npt.ArrayLike | None = None,
    rate_hz: float | None = None,
    start_s: float = 0.0,
    rest: int = 0,
    tare: Mapping[str, npt.ArrayLike] | None = None,
    others: Mapping[str, npt.ArrayLike] | None = None,
    outcome: bool | str | None = None,
    cloud: Cloud = NO_CLOUD,
    grasp: Grasp = NO_GRASP,
    note: str = "",
    missing: Missing = "refuse",
    remarks: Remarks | None = None,
) -> SampleRecord:
    """Make the record of a grasp from arrays.

    Args:
        sensor: That was read.
        object: Name of the object.
        values: By modality (channel and finger, such as E_TH) the numbers of all taxels: (T, M) of T readings, also with more
            dimensions behind the first, or (M,) of one reading, which is the touch.
        id: Name of the grasp among those of its object; by default a number.
        stamps_ns: (T,) whole numbers [ns] since 1970, or datetime64.
        stamps_s: (T,) [s] since 1970 or since `start_s`; or give `rate_hz`. Of one reading a number.
        rate_hz: Readings per second, where the source has no stamps.
        start_s: Added to `stamps_s`, or the time of the first reading [s].
        rest: Number of readings without contact at the beginning. The contact detector finds the contact after them, and the
            touch is the median from 0.3 s later on.
        tare: A reading without contact by modality, (M,) each, instead of the median of those at rest.
        others: By name (T,) further numbers.
        outcome: True or "success", False or "failure"; None if it is not known.
        cloud: The object's points, seen before the grasp.
        grasp: The contacts that were grasped, in the frame of the cloud.
        note: Where it comes from.
        missing: See `write`.
        remarks: Are added to.

    Raises:
        DatasetError: If a field breaks a rule.
    """
    if missing not in ("refuse", "hold", "mask"):
        raise DatasetError(f"missing: {none_of(missing, ('refuse', 'hold', 'mask'))}")
    if not isinstance(rest, int | np.integer) or rest < 0:
        raise DatasetError(f"rest: {rest} is not a number of readings")
    if not isinstance(cloud, Cloud) or not isinstance(grasp, Grasp):
        raise DatasetError("cloud, grasp: are not a Cloud and a Grasp of foretouch")
    if not np.isfinite(start_s):
        raise DatasetError(f"start_s: {start_s} is not finite")
    object, id, note = str(object), str(id), str(note)  # noqa: A001  tables hold numbers of objects
    channels, name = sensor.channels, f"{object}/{id}" if id else ""
    check_id(name or f"{object}/1", object)
    counts = _joined(values, channels, "values")
    single = not counts.shape[1:]
    rows = counts.reshape(-1, channels.size)
    further = {key: np.asarray(other, np.float64).reshape(-1) for key, other in (others or {}).items()}
    if wrong := next((key for key, column in further.items() if len(column) != len(rows)), None):
        raise DatasetError(f"others: {wrong}: {len(further[wrong])} numbers are not {len(rows)} readings")
    rows, whole, gone = _complete(rows, channels, missing, "values")
    names = tuple(further)
    filled, _, lost = _complete(
        np.array([further[key] for key in names]).reshape(len(names), len(rows)).T, names, missing, "others"
    )
    if gone + lost:
        _remark(remarks, f"missing_numbers ({missing})", f"{name or object}: {gone + lost}")
    flags = [*(["missing_numbers"] if gone + lost else []), *_range_flags(rows, channels)]
    stamps = _stamps(len(rows), sensor.config.update_rate, rows, stamps_ns, stamps_s, rate_hz, start_s)
    if rate_hz is not None:
        flags.append("stamped_by_rate")
    columns = dict(zip(names, filled.T.astype(np.float32), strict=True))
    result = _outcome(outcome)
    resting = None if tare is None else Touch(_joined(tare, channels, "tare").reshape(-1), channels)
    sample = Sample(id=name, object=object, cloud=cloud, grasp=grasp, tare=resting, stamp_ns=int(stamps[0]))
    if single:
        extra = {key: float(column[0]) for key, column in columns.items()}
        sample = replace(sample, touch=Touch(rows[0], channels), extra=extra)
        return SampleRecord(sample=sample, outcome=result, note=note, flags=tuple(flags))
    flags += stamp_faults(stamps, sensor.config.update_rate)
    touch, rested, phases, contact_ns = _cut(stamps, rows, whole, rest, channels)
    if rest and touch is None:
        _remark(remarks, "no_contact", f"{name or object}: none found after {rest} readings at rest, so no touch")
    return SampleRecord(
        sample=replace(sample, touch=touch, tare=rested if resting is None else resting),
        outcome=result,
        note=note,
        series=TouchSeries(stamps, rows.astype(np.float32), phases, columns),
        contact_ns=contact_ns,
        detector="" if contact_ns is None else "contact_detector",
        flags=tuple(flags),
    )


def _joined(values: Mapping[str, npt.ArrayLike], channels: Channels, what: str) -> Float64:
    """Return (T, D) or (D,) numbers of all modalities; a `DatasetError` names one that is missing, not known or of another size."""
    if not isinstance(values, Mapping):
        raise DatasetError(f"{what}: give a mapping of {', '.join(channels.modalities)} to their arrays")
    if unknown := [key for key in values if key not in channels.modalities]:
        raise DatasetError(f"{what}: {none_of(unknown[0], channels.modalities)}")
    if absent := [key for key in channels.modalities if key not in values]:
        raise DatasetError(f"{what}: {', '.join(absent)} of {channels.sensor} are missing")
    parts: list[Float64] = []
    for key in channels.modalities:
        try:
            part = np.asarray(values[key], np.float64)
        except (TypeError, ValueError) as err:
            raise DatasetError(f"{what}: {key}: {' '.join(str(err).split())}") from err
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
    plain = outcome.item() if isinstance(outcome, np.generic) else outcome
    known = {**_OUTCOMES, **{name: name for name in _OUTCOMES.values()}}
    if plain not in known:
        raise DatasetError(f"outcome: {none_of(plain, _OUTCOMES.values())}; they are also True, False and None")
    return known[plain]


def _stamps(
    count: int,
    sensor_hz: float,
    rows: Float64,
    stamps_ns: npt.ArrayLike | None,
    stamps_s: npt.ArrayLike | None,
    rate_hz: float | None,
    start_s: float,
) -> Int64:
    """Return (T,) int64 [ns]; a `DatasetError` if they are of another number, go back, or too few digits for the readings."""
    given = [
        name
        for name, value in (("stamps_ns", stamps_ns), ("stamps_s", stamps_s), ("rate_hz", rate_hz))
        if value is not None
    ]
    if len(given) != 1 and (given or count > 1):
        raise DatasetError(f"stamps_ns, stamps_s, rate_hz: give one of them, not {' and '.join(given) or 'none'}")
    start = round(start_s * SECOND_NS)
    if not given or rate_hz is not None:
        if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0.0):
            raise DatasetError(f"rate_hz: {rate_hz} is not above 0")
        return np.asarray(start + np.rint(np.arange(count) * (SECOND_NS / (rate_hz or 1.0))).astype(np.int64))
    name, times = given[0], np.atleast_1d(np.asarray(stamps_ns if stamps_s is None else stamps_s))
    if times.dtype.kind == "M":
        times = times.astype("datetime64[ns]").astype(np.int64)
        name = "stamps_ns"
    if times.shape != (count,):
        raise DatasetError(f"{name}: shape {times.shape} is not ({count},), one of each reading")
    if times.dtype.kind not in "iuf" or not np.isfinite(times).all():
        raise DatasetError(f"{name}: are not finite numbers")
    unit = 1 if name == "stamps_ns" else SECOND_NS
    largest = float(np.abs(times).max())
    if largest * unit > 2.0**62:
        raise DatasetError(f"{name}: {largest:g} is no time in {name[-2:].strip('_')}")
    if times.dtype.kind == "f":
        grain = float(np.spacing(times.dtype.type(largest))) * unit / SECOND_NS
        if grain > 0.5 / sensor_hz:
            cure = (
                "read them as float64, or as whole nanoseconds"
                if times.dtype.itemsize < 8
                else "give whole nanoseconds"
            )
            raise DatasetError(f"{name}: {times.dtype} holds {largest:g} in steps of {grain:g} s: {cure}")
    ticks = times.astype(np.int64) if times.dtype.kind in "iu" else None
    stamps = ticks * unit if ticks is not None else np.rint(times.astype(np.float64) * unit).astype(np.int64)
    if (back := np.flatnonzero(np.diff(stamps) < 0)).size:
        by = (stamps[back[0]] - stamps[back[0] + 1]) / SECOND_NS
        raise DatasetError(f"{name}: go back by {by:g} s at reading {back[0] + 1}")
    same = np.diff(stamps) == 0
    if (
        2 * np.count_nonzero(same) >= count and (rows[1:] != rows[:-1])[same].any()
    ):  # else a reading was stored repeatedly
        fault = stamp_faults(stamps, sensor_hz)["equal_stamps"]
        cure = f"write them with all digits, such as %.9f, or give rate_hz={sensor_hz:g}"
        raise DatasetError(f"{name}: {fault}: were they rounded, to whole seconds or six digits? {cure}")
    return np.asarray(start + stamps, np.int64)


def _cut(
    stamps: Int64, values: Float64, whole: Float64, rest: int, channels: Channels
) -> tuple[Touch | None, Touch | None, AnyArray, int | None]:
    """Cut touch and tare out of (T, D) readings, the phase of each, and the first contact [ns]; what is not there is None.

    Contact is found in the readings without gaps, `whole`.
    """
    phases, resting = np.full(len(stamps), APPROACH, np.uint8), whole[:rest]
    phases[: len(resting)] = REST
    if not len(resting):
        return None, None, phases, None
    tare = rest_of(np.median(resting, axis=0), channels)
    onsets = [onset for onset in find_contact(stamps, whole, resting, channels) if onset is not None]
    if not onsets:
        return None, tare, phases, None
    touching = (contact_scores(whole, resting, channels) >= RELEASE_LEVEL).any(axis=1)
    held = touching & (stamps >= min(onsets) + SETTLE_NS) & (phases != REST)
    phases[held] = HOLD
    if not held.any():
        return None, tare, phases, min(onsets)
    read = np.isfinite(values[held]).any(axis=0)
    touch = np.full(channels.size, np.nan)
    touch[read] = np.nanmedian(values[held][:, read], axis=0)
    return Touch(touch, channels), tare, phases, min(onsets)
