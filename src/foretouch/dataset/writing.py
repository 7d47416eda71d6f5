# SPDX-License-Identifier: Apache-2.0
"""Write samples of any source to a recorded dataset: `foretouch.write`.

A sample is a `Sample`, as a dataset gives it, or a mapping with the arrays of a grasp, as pandas or h5py read them.
Stamps and missing numbers are checked here, whatever the source.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.base.files import as_path
from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.dataset.files import new_folder
from foretouch.dataset.identity import Identity, name_of
from foretouch.dataset.labelling.grasp_arrays import GraspArrays, Missing, Remarks
from foretouch.dataset.labelling.stamps import stamp_faults
from foretouch.dataset.recordings.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import SampleSet
from foretouch.errors import CloudError, DatasetError, ForetouchError, checked, require_type, shown
from foretouch.grasp import closing_faults
from foretouch.grasp.reach import ASTRAY_M, EXECUTED_M, reach_faults
from foretouch.tactile import touch_faults
from foretouch.tactile.description import Sensor, load_sensor
from foretouch.types import Grasps, Sample

_ANYWHERE: Final = ObjectLimits(min_range_m=0.0)
"""Limits of objects in any frame, not only in that of a camera."""


@dataclass(kw_only=True)
class WriteResult:
    """What was written, and what to look at."""

    samples: int = 0  # samples that were written
    labelled: int = 0  # those with a touch
    tables: int = 0  # those that hold their table; of others the camera is taken to look straight down on it
    readings: int = 0  # those in their series, or a touch without one
    left_out: Counter[str] = field(default_factory=Counter)  # what was not written, by reason
    notes: tuple[str, ...] = ()  # what to look at: stamps, missing numbers, what a bag states of its files


@checked
def write(
    path: str | Path,
    samples: "SampleSet | Iterable[Sample | Mapping[str, Any]]",
    sensor: str | Path | Sensor = "biotac_sp",
    *,
    missing: Missing = "refuse",
    hand: Mapping[str, str] | None = None,
    camera: Mapping[str, str] | None = None,
    min_free_mb: float = RecordingConfig().min_free_mb,
    limits: ObjectLimits = _ANYWHERE,
) -> WriteResult:
    """Write samples to a recorded dataset, which is created or extended.

    All samples are in it at the end, or none if there is an error, so that the corrected call can be repeated. One process writes
    a dataset at a time; another is refused.

    Args:
        path: Folder of the dataset.
        samples: A dataset, or samples of any source: `Sample`, or mappings with the fields of `GraspArrays`, such as
            `{"object": "mug", "values": {"P_left": (T, M), "P_right": (T, M)}, "stamps_s": (T,), "rest": 40}`.
        sensor: Name or file of the description of the sensor. A dataset brings its own.
        missing: What becomes of numbers that are not finite in mappings. "refuse" refuses them by name; "hold" takes the
            reading before; "mask" stores them as taxels that were not read.
        hand: Name, serial number and so on of the hand; by default the name of the sensor.
        camera: The same of the camera; by default none.
        min_free_mb: Disk space that is left free [MB], as in the recorder.
        limits: Range and size of objects, as of a prediction; by default in any frame.

    Returns:
        The counts, and remarks on stamps and missing numbers, which are warned of, too.

    Raises:
        DatasetError: If there is no sample, or one breaks a rule. The message names the sample, the field, the rule, and what to do.
        FileError: If the dataset is of another hand, camera or sensor, or cannot be written.
    """
    for name, facts_given in (("hand", hand), ("camera", camera)):
        if not isinstance(facts_given, Mapping | None):
            raise DatasetError(f'{name}: {shown(facts_given)} is not a mapping, such as {{"name": "mine"}}')
    require_type(
        limits, ObjectLimits, "limits", "not ObjectLimits, such as ObjectLimits(max_extent_m=1.0)", DatasetError
    )
    if not isinstance(samples, Iterable) or getattr(samples, "ndim", None) == 0:
        raise DatasetError(f"samples: {type(samples).__name__} is neither a dataset, such as open(PATH), nor a list")
    if isinstance(samples, SampleSet):
        own = samples.sensor
        facts = samples.identity
    else:
        own = sensor if isinstance(sensor, Sensor) else load_sensor(sensor)
        facts = Identity()
    identity = Identity(
        hand=_named("hand", hand) or facts.hand or {"name": own.config.name},
        camera=_named("camera", camera) or facts.camera or {"name": "none"},
    )
    result, remarks = WriteResult(), Remarks()
    records: Iterator[Sample | Mapping[str, Any]] = iter(samples)
    start = list(islice(records, 1))
    if not start:
        raise DatasetError(f"samples: there is none to write to {path}; pass at least one sample")

    made = _made_of(chain(start, records), own, missing, remarks, limits)
    write_records(as_path(path), made, identity, own, result, remarks=remarks, min_free_mb=min_free_mb)
    for line in result.notes:
        warnings.warn(line, stacklevel=2)
    return result


def _named(what: str, facts: Mapping[str, Any] | None) -> dict[str, str]:
    """Return the properties of a hand or a camera as texts."""
    return {name_of(key, what): name_of(value, f"{what}.{shown(key)}") for key, value in (facts or {}).items()}


def _made_of(
    records: Iterable[Sample | Mapping[str, Any]],
    sensor: Sensor,
    missing: Missing,
    remarks: Remarks,
    limits: ObjectLimits,
) -> Iterator[Sample]:
    """Iterate over samples; make a sample of each mapping. What no prediction would accept is refused."""
    for number, record in enumerate(records):
        sample = record if isinstance(record, Sample) else _sample_of(number, record, sensor, missing, remarks)
        if fault := _fault(sample, limits):
            raise DatasetError(f"sample {number} ({sample.id or sample.object}): {fault}")
        yield sample


def _fault(sample: Sample, limits: ObjectLimits) -> str:
    """Name what is wrong with the grasp, the object or the readings of a sample; "" if nothing is."""
    if not sample.grasp.rotation.any():
        return "grasp: rotation: is not given; model.predict(object, grasps).grasps has it"
    if fault := place_fault(sample, limits):
        return fault
    readings = {"touch": sample.touch, "tare": sample.tare}
    faults = [(name, fault) for name, read in readings.items() if read is not None for fault in touch_faults(read)]
    return next((f"{name}: {fault}" for name, fault in faults if fault), "")


def place_fault(sample: Sample, limits: ObjectLimits) -> str:
    """Return why a grasp cannot have been executed on an object, as with millimetres or in another frame; "" if it can.

    Args:
        sample: With cloud and grasp.
        limits: Of the object and its table.
    """
    grasps, xyz = Grasps.of([sample.grasp]), sample.cloud.xyz
    try:
        check_object(xyz, limits)
        if sample.table is not None:
            check_table(sample.table, limits, xyz)
    except CloudError as err:
        return f"cloud: {err}"
    reach = reach_faults(grasps, xyz, EXECUTED_M, ASTRAY_M) if np.isfinite(xyz).any() else []
    fault = next(filter(None, (*closing_faults(grasps), *reach)), "")
    frame = "; are both in metres and in one frame?" if fault in reach else ""
    return f"grasp: {fault}{frame}" if fault else ""


def _sample_of(number: int, record: object, sensor: Sensor, missing: Missing, remarks: Remarks) -> Sample:
    """Make the sample of a mapping, which is named if it breaks a rule."""
    if not isinstance(record, Mapping):
        rule = "is neither a Sample nor a mapping; pass a list of them, or a dataset, such as open(PATH)"
        raise DatasetError(f"sample {number}: {type(record).__name__} {rule}")
    try:
        return GraspArrays(**record).sample(sensor, missing, remarks)
    except (TypeError, ValueError, AttributeError, ForetouchError) as err:  # of keys and values of other types
        given = record.get("id", "")
        name = (
            f"{shown(record.get('object'), 50)}/{number if isinstance(given, str) and not given else shown(given, 50)}"
        )
        fault = str(err).removeprefix("GraspArrays.__init__() ")
        raise DatasetError(f"sample {number} ({name}): {fault}") from err


def write_records(
    path: Path,
    records: Iterable[Sample],
    identity: Identity,
    sensor: Sensor,
    result: WriteResult,
    progress: Callable[[], None] = lambda: None,
    remarks: Remarks | None = None,
    min_free_mb: float = RecordingConfig().min_free_mb,
) -> None:
    """Write the records to a dataset and add to the result; their stamps are compared with the rate of the sensor.

    All of them are in it at the end, or none if there is an error.

    Args:
        path: Folder of the dataset, which is created if it does not exist.
        records: The samples.
        identity: Hand and camera.
        sensor: The sensor that was read.
        result: Gets the counts and notes.
        progress: Called once a sample.
        remarks: Gets names of samples by flag, for the notes.
        min_free_mb: Disk space that is left free [MB].
    """
    remarks = {} if remarks is None else remarks
    with ExitStack() as stack:
        folder = path if path.exists() else stack.enter_context(new_folder(path))
        config = RecordingConfig(fsync_samples=0, min_free_mb=min_free_mb)  # synchronised once, at the end
        with RecordingWriter(folder, identity, config, sensor=sensor, whole=True) as writer:
            for sample in records:
                name = writer.append(sample)
                series = sample.readings
                faults = (
                    {} if sample.series is None else stamp_faults(sample.series.stamps_ns, sensor.config.update_rate)
                )
                for flag, text in faults.items():
                    remarks.setdefault(flag, []).append(f"{name}: {text}")
                result.samples += 1
                result.labelled += sample.touch is not None
                result.tables += sample.table is not None
                result.readings += 0 if series is None else len(series.stamps_ns)
                progress()
    result.notes += tuple(f"{kind}: {len(texts)} samples, first {texts[0]}" for kind, texts in remarks.items())
