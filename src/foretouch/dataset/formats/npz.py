# SPDX-License-Identifier: Apache-2.0
"""Samples as NumPy archives: `<object>/<name>.npz`, one a sample; `foretouch.cloud.io.files` reads their clouds too."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from foretouch.cloud.io.arrays import read_arrays
from foretouch.cloud.io.files import archived_cloud
from foretouch.cloud.messages import cloud_fields, header_fields
from foretouch.dataset.identity import Identity, check_id
from foretouch.dataset.recordings.sample_codec import StoredSample, sample_fields, stored_sample
from foretouch.dataset.samples import Each, ExportResult, SampleSet
from foretouch.errors import DatasetError, FileError, ForetouchError, none_of
from foretouch.grasp.messages import encode_grasp
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.types import OUTCOMES, AnyArray, Grasp, Sample

_REQUIRED: Final = ("id", "object", "xyz", "g1", "g2", "rotation", "score", "sample_stamp_ns")
_NAMES: Final = {
    "contact": "contact_ns",
    "pairing_error": "pairing_error_ns",
    "series_stamps": "series_stamps_ns",
    "series_phase": "series_phases",
    "other_names": "series_names",
    "others": "series_others",
}
"""Names of arrays that differ from the fields of a `foretouch_msgs/GraspSample`."""
_NESTED: Final = ("header", "cloud", "grasp", "candidates", "score", "sha256")
_TEXTS: Final = ("other_names", "flags", "extra_names")
_GRASP: Final = {"g1": (3,), "g2": (3,), "rotation": (3, 3), "score": (), "grasp_id": (), "object_id": ()}


def export(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    """Write samples in this format (arguments: `export` in `foretouch.dataset.formats`)."""
    out.mkdir(parents=True)
    for sample in samples:
        progress()
        arrays = _arrays(sample, samples.identity, samples.sensor)
        file = out / f"{sample.id}.npz"
        file.parent.mkdir(exist_ok=True)
        np.savez(file, allow_pickle=False, **arrays)
        result.samples += 1


def _arrays(sample: Sample, identity: Identity, sensor: Sensor) -> dict[str, Any]:
    cloud = sample.cloud
    fields = vars(sample_fields(sample, identity, sensor)).items()
    arrays = {
        _NAMES.get(name, name): np.array(value, np.str_ if name in _TEXTS else None)
        for name, value in fields
        if name not in _NESTED and (name not in ("touch", "tare") or len(value))
    }
    arrays["series"] = arrays["series"].reshape(-1, sensor.channels.size)
    arrays["series_others"] = arrays["series_others"].reshape(len(arrays["series_names"]), len(arrays["series"]))
    colours = {} if cloud.rgb is None else {"rgb": cloud.rgb}
    return {
        **arrays,
        **colours,
        "outcome": sample.outcome,
        "xyz": cloud.xyz,
        "frame_id": cloud.frame_id,
        "stamp_ns": np.int64(cloud.stamp_ns),
        "sample_stamp_ns": np.int64(sample.stamp_ns),
        **{name: values[0] for name, values in _grasps([sample.grasp]).items()},
        **{f"candidates_{name}": values for name, values in _grasps(sample.candidates).items()},
    }


def _grasps(grasps: Sequence[Grasp]) -> dict[str, AnyArray]:
    """Return the fields of K grasps by name."""
    kinds = {name: np.str_ if name.endswith("_id") else np.float64 for name in _GRASP}
    return {
        name: np.array([getattr(grasp, name.removeprefix("grasp_")) for grasp in grasps], kinds[name]).reshape(
            -1, *shape
        )
        for name, shape in _GRASP.items()
    }


def _read(path: Path) -> StoredSample:
    """Return the sample in an archive; a `FileError` if it is none."""
    arrays = read_arrays(path, _REQUIRED)
    try:
        cloud = archived_cloud(path, arrays)
        default = Sample(id="a/1", object="a")
        fields = vars(sample_fields(default, Identity(), BIOTAC_SP))
        for name in fields.keys() - _NESTED:
            if (array := arrays.get(_NAMES.get(name, name))) is not None:
                fields[name] = array.tolist() if array.dtype.kind == "U" or not array.shape else array
        if "outcome" in arrays:
            if fields["outcome"] not in OUTCOMES:
                raise DatasetError(f"outcome: {none_of(fields['outcome'], OUTCOMES)}")
            fields["outcome"] = OUTCOMES.index(fields["outcome"])
        check_id(fields["id"], fields["object"])
        count = len(arrays.get("candidates_score", ()))
        candidates = [{name: arrays[f"candidates_{name}"][k] for name in _GRASP} for k in range(count)]
        fields |= {
            "header": header_fields(int(arrays["sample_stamp_ns"]), cloud.frame_id, "sample_stamp_ns"),
            "cloud": cloud_fields(cloud),
            "grasp": encode_grasp(_grasp({name: arrays.get(name, np.array("")) for name in _GRASP})),
            "candidates": [encode_grasp(_grasp(candidate)) for candidate in candidates],
            "score": float(arrays["score"]),
            "labelled": np.size(fields["touch"]) > 0,
            "tared": np.size(fields["tare"]) > 0,
        }
        return stored_sample(SimpleNamespace(**fields))
    except FileError:
        raise
    except (ForetouchError, ValueError, TypeError, IndexError, OverflowError) as err:
        raise FileError(path, f"is not a sample: {' '.join(str(err).split())}") from err


def _grasp(fields: Mapping[str, Any]) -> Grasp:
    g1, g2, rotation = (np.asarray(fields[name], np.float64) for name in ("g1", "g2", "rotation"))
    return Grasp(g1, g2, rotation, float(fields["score"]), str(fields["grasp_id"]), str(fields["object_id"]))


def _files(path: Path) -> list[Path]:
    return sorted(path.glob("*/*.npz"))


def recognise(path: Path) -> bool:
    """Return whether the first archive, whose name says where it is, names a sample; others may be clouds alone."""
    first = next(iter(_files(path)), None)
    try:
        return first is not None and bool(read_arrays(first, ["id", "g1"], []))
    except FileError as err:
        if isinstance(err.__cause__, OSError):
            raise
        return False


def open_set(path: Path, _: bool) -> SampleSet:
    """Return the samples in archives; a `FileError` names one that is none, or of another hand."""
    files = _files(path)
    first = _read(files[0])
    return SampleSet(
        path=path,
        kind="npz",
        size=len(files),
        read=Each(files, partial(_read_as, first, files[0])),
        name=Each(files, str),
        identity=first.identity,
        sensor=first.sensor,
    )


def _read_as(first: StoredSample, beside: Path, path: Path) -> Sample:
    """Return the sample in an archive; a `FileError` if it is of another hand, camera or sensor than the first one."""
    sample, identity, sensor = _read(path)
    if identity != first.identity or sensor.sha256 != first.sensor.sha256:
        raise FileError(path, f"is of another hand, camera or sensor than {beside}")
    return sample
