# SPDX-License-Identifier: Apache-2.0
"""Samples as NumPy archives: `<object>/<name>.npz`, one a sample; `foretouch.cloud.io.files` reads their clouds too."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.cloud.io.files import archived_cloud, read_arrays
from foretouch.dataset.record import Identity, SampleRecord, TouchSeries, check_id
from foretouch.dataset.recording.sample_codec import (
    OUTCOMES,
    parse_properties,
    parse_sensor,
    properties_text,
    sensor_text,
)
from foretouch.dataset.samples import ExportResult, SampleSet
from foretouch.errors import DatasetError, FileError, ForetouchError
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor, with_sensor
from foretouch.types import AnyArray, Grasp, GraspSample, Touch

_REQUIRED: Final = ("id", "object", "xyz", "g1", "g2", "rotation", "score", "sample_stamp_ns")
_TEXTS: Final = ("outcome", "note", "detector")
_NUMBERS: Final = ("contact_ns", "pairing_error_ns")
_SERIES: Final = ("series_stamps_ns", "series", "series_phases")
_GRASP_ARRAYS: Final = ("g1", "g2", "rotation", "score", "grasp_id", "object_id")


def export(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    """See `foretouch.dataset.formats`."""
    out.mkdir(parents=True)
    facts = {name: properties_text(getattr(samples.identity, name)) for name in ("hand", "camera")}
    if with_sensor({}, samples.sensor):
        facts["sensor"] = sensor_text(samples.sensor)
    for record in samples.records():
        progress()
        check_id(record.sample.id, record.sample.object)
        file = out / f"{record.sample.id}.npz"
        file.parent.mkdir(exist_ok=True)
        np.savez(file, allow_pickle=False, **_arrays(record), **facts)
        result.samples += 1


def _arrays(record: SampleRecord) -> dict[str, Any]:
    sample, series = record.sample, record.series
    extra = dict(sorted(sample.extra.items()))
    arrays: dict[str, Any] = {
        "id": sample.id,
        "object": sample.object,
        "xyz": sample.cloud.xyz,
        "frame_id": sample.cloud.frame_id,
        "stamp_ns": np.int64(sample.cloud.stamp_ns),
        "sample_stamp_ns": np.int64(sample.stamp_ns),
        **{name: values[0] for name, values in _grasps([sample.grasp]).items()},
        **{f"candidates_{name}": values for name, values in _grasps(record.candidates).items()},
        "extra_names": np.array(list(extra), dtype=np.str_),
        "extra_values": np.array(list(extra.values()), np.float64),
        "flags": np.array(record.flags, dtype=np.str_),
        **{name: getattr(record, name) for name in _TEXTS},
    }
    arrays |= {name: np.int64(value) for name in _NUMBERS if (value := getattr(record, name)) is not None}
    if sample.cloud.rgb is not None:
        arrays["rgb"] = sample.cloud.rgb
    for name, touch in (("touch", sample.touch), ("tare", sample.tare)):
        if touch is not None:
            arrays[name] = touch.values
    if series is not None:
        arrays |= dict(zip(_SERIES, (series.stamps_ns, series.counts, series.phases), strict=True))
        arrays["series_names"] = np.array(list(series.others), dtype=np.str_)
        arrays["series_others"] = np.array(list(series.others.values()), np.float32).reshape(-1, len(series.stamps_ns))
    return arrays


def _grasps(grasps: Any) -> dict[str, AnyArray]:
    """K grasps by field."""
    shapes = {"g1": (3,), "g2": (3,), "rotation": (3, 3), "score": ()}
    numbers = {
        name: np.array([getattr(one, name) for one in grasps], np.float64).reshape(len(grasps), *shape)
        for name, shape in shapes.items()
    }
    ids = {"grasp_id": [one.id for one in grasps], "object_id": [one.object_id for one in grasps]}
    return {**numbers, **{name: np.array(texts, dtype=np.str_) for name, texts in ids.items()}}


def _read(path: Path) -> tuple[SampleRecord, Identity, Sensor]:
    """The sample in an archive, and hand, camera and sensor; a `FileError` if it is none."""
    arrays = read_arrays(path, _REQUIRED)
    try:
        hand, camera = (parse_properties(str(arrays.get(name, "{}"))) for name in ("hand", "camera"))
        sensor = parse_sensor(str(arrays["sensor"])) if "sensor" in arrays else BIOTAC_SP
        return _record(path, arrays, sensor), Identity(hand=hand, camera=camera), sensor
    except FileError:
        raise
    except (ForetouchError, ValueError, TypeError, IndexError, OverflowError) as err:
        raise FileError(path, f"is not a sample: {' '.join(str(err).split())}") from err


def _record(path: Path, arrays: Mapping[str, AnyArray], sensor: Sensor) -> SampleRecord:
    def text(name: str) -> str:
        return str(arrays[name][()]) if name in arrays else ""

    def texts(name: str) -> list[str]:
        return [str(one) for one in arrays.get(name, np.array([], np.str_)).ravel()]

    def touch(name: str) -> Touch | None:
        return Touch(np.array(arrays[name], np.float64), sensor.channels) if name in arrays else None

    check_id(text("id"), text("object"))
    outcome = next((one for one in OUTCOMES if one == (text("outcome") or "unknown")), None)
    if outcome is None:
        raise DatasetError(f"outcome: {text('outcome')[:80]!r} is not one of {', '.join(OUTCOMES)}")
    sample = GraspSample(
        id=text("id"),
        object=text("object"),
        cloud=archived_cloud(path, arrays),
        grasp=_grasp({name: arrays.get(name, np.array("")) for name in _GRASP_ARRAYS}),
        touch=touch("touch"),
        tare=touch("tare"),
        stamp_ns=int(arrays["sample_stamp_ns"]),
        extra=dict(zip(texts("extra_names"), arrays.get("extra_values", np.empty(0)).tolist(), strict=True)),
    )
    contact_ns, error_ns = (int(arrays[name]) if name in arrays else None for name in _NUMBERS)
    candidates = {name: arrays[f"candidates_{name}"] for name in _GRASP_ARRAYS if f"candidates_{name}" in arrays}
    count = len(candidates.get("score", ()))
    return SampleRecord(
        sample=sample,
        candidates=tuple(_grasp({name: values[k] for name, values in candidates.items()}) for k in range(count)),
        outcome=outcome,
        series=_series(arrays, texts("series_names")) if "series" in arrays else None,
        note=text("note"),
        detector=text("detector"),
        flags=tuple(texts("flags")),
        contact_ns=contact_ns,
        pairing_error_ns=error_ns,
    )


def _grasp(fields: Mapping[str, Any]) -> Grasp:
    g1, g2, rotation = (np.asarray(fields[name], np.float64) for name in ("g1", "g2", "rotation"))
    return Grasp(g1, g2, rotation, float(fields["score"]), str(fields["grasp_id"]), str(fields["object_id"]))


def _series(arrays: Mapping[str, AnyArray], names: list[str]) -> TouchSeries:
    stamps_ns, counts, phases = (arrays[name] for name in _SERIES)
    others = dict(zip(names, arrays.get("series_others", np.empty((0, 0), np.float32)), strict=True))
    return TouchSeries(stamps_ns.astype(np.int64), counts.astype(np.float32), phases.astype(np.uint8), others)


def _files(path: Path) -> list[Path]:
    return sorted(path.glob("*/*.npz"))


def recognise(path: Path) -> bool:
    """Whether the first archive, whose name says where it is, names a sample; others may be clouds alone."""
    first = next(iter(_files(path)), None)
    try:
        return first is not None and bool(read_arrays(first, ["id", "g1"], []))
    except FileError:
        return False


def open_set(path: Path, _: bool) -> SampleSet:
    """The samples in archives; a `FileError` names one that is none, or of another hand."""
    files = _files(path)
    identity, sensor = _read(files[0])[1:]

    def record(k: int) -> SampleRecord:
        found, own, other = _read(files[k])
        if own != identity or other.sha256 != sensor.sha256:
            raise FileError(files[k], f"is of another hand, camera or sensor than {files[0]}")
        return found

    return SampleSet(
        path=path,
        kind="npz",
        size=len(files),
        record=record,
        name=lambda k: str(files[k]),
        identity=identity,
        sensor=sensor,
    )
