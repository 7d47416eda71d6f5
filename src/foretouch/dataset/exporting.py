# SPDX-License-Identifier: Apache-2.0
"""Writes samples in the formats of others: folders as vision2tactile has them, NumPy archives, rosbag2.

What is written is read back equal, number by number; what a format has no place for is counted and told.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, Protocol, get_args

import numpy as np

from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.recording.messages import SAMPLE_TOPIC, SAMPLE_TYPE, check_id, encode_sample
from foretouch.dataset.recording.record import SampleRecord
from foretouch.dataset.samples import SampleSet, only_finite, open_samples
from foretouch.dataset.vision2tactile import CLOUD_FILE, GRASP_FILE, TOUCH_FILE
from foretouch.errors import DatasetError, FileError
from foretouch.types import GraspSample

__all__ = ["FORMATS", "ExportFormat", "ExportResult", "export_samples"]

ExportFormat = Literal["vision2tactile", "npz", "rosbag2"]
FORMATS: Final[tuple[ExportFormat, ...]] = get_args(ExportFormat)

CLOUD_TOPIC: Final = "/foretouch/object_cloud"
_NS_PER_S: Final = 1_000_000_000


@dataclass(kw_only=True)
class ExportResult:
    """What was written, and what was not.

    Attributes:
        written: Samples.
        left_out: Samples that the format cannot hold, by reason.
        lost: What it has no place for, by name, with the number of samples that had it.
    """

    written: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)


class _Exporter(Protocol):
    def __call__(self, samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None: ...


def export_samples(
    source: str | Path, out: str | Path, kind: ExportFormat, progress: Callable[[], None] = lambda: None
) -> ExportResult:
    """Write the samples of a source in another format.

    Args:
        source: See `open_samples`.
        out: Folder to be made; must not exist.
        kind: The format.
        progress: Called once a sample.

    Raises:
        FileError: If `out` exists or cannot be written, or the source is damaged; nothing is left at `out` then.
        DatasetError: If a sample's id cannot be the name of a file.
    """
    out = Path(out)
    if out.exists():
        raise FileError(out, "exists already and is not overwritten")
    result = ExportResult()
    part = out.with_name(f".{out.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        with open_samples(source) as samples:
            _EXPORTERS[kind](samples, part, result, progress)
        part.rename(out)
    except OSError as err:
        raise FileError(out, f"{err.strerror or err} (errno {err.errno})") from err
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return result


def _to_folders(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    out.mkdir(parents=True)
    for record in samples.records():
        progress()
        sample = only_finite(record.sample)
        check_id(sample.id, sample.object)
        if sample.touch is None:
            result.left_out["unlabelled"] += 1
            continue
        folder = _free_folder(out / sample.object, sample)
        folder.mkdir(parents=True)
        write_cloud(folder / CLOUD_FILE, sample.cloud)
        (folder / GRASP_FILE).write_text(_numbers([*sample.grasp.g1, *sample.grasp.g2]), encoding="ascii")
        (folder / TOUCH_FILE).write_text("," + _numbers(_fingers(sample)), encoding="ascii")
        result.written += 1
        kept = {f"{name}_{finger}" for name in ("PAC0", "PAC1", "TAC", "TDC") for finger in ("MF", "TH")}
        result.lost["tare"] += sample.tare is not None
        result.lost["series"] += record.series is not None
        result.lost["extra"] += bool(sample.extra.keys() - kept)
        result.lost["id"] += folder.name != sample.id.partition("/")[2]


def _free_folder(parent: Path, sample: GraspSample) -> Path:
    """Named by the second of the recording, or by the next that is free: the format knows no other names."""
    second = sample.stamp_ns // _NS_PER_S
    while (parent / str(second)).exists():
        second += 1
    return parent / str(second)


def _fingers(sample: GraspSample) -> list[float]:
    """Middle finger, then thumb: 24 electrodes, PAC0, PAC1, PDC, TAC, TDC; 0 where the sample does not have them."""
    touch = sample.touch
    if touch is None:
        raise DatasetError(f"{sample.id}: has no touch")
    values: list[float] = []
    for finger, electrodes, pdc in (("MF", touch.e_mf, touch.pdc_mf), ("TH", touch.e_th, touch.pdc_th)):
        pac0, pac1, tac, tdc = (sample.extra.get(f"{name}_{finger}", 0.0) for name in ("PAC0", "PAC1", "TAC", "TDC"))
        values += [*electrodes, pac0, pac1, pdc, tac, tdc]
    return values


def _numbers(values: list[float]) -> str:
    """With as many digits as it takes to read the same numbers back."""
    return ",".join(f"{int(value)}" if float(value).is_integer() else repr(float(value)) for value in values)


def _to_archives(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    out.mkdir(parents=True)
    for record in samples.records():
        progress()
        sample = record.sample
        check_id(sample.id, sample.object)
        head, _, name = sample.id.partition("/")
        (out / head).mkdir(exist_ok=True)
        np.savez(out / head / f"{name}.npz", **_arrays(record))
        result.written += 1


def _arrays(record: SampleRecord) -> dict[str, Any]:
    """The arrays of one archive; clouds are named as `foretouch.cloud.io.files` reads them."""
    sample = record.sample
    extra = dict(sorted(sample.extra.items()))
    arrays: dict[str, Any] = {
        "id": sample.id,
        "object": sample.object,
        "xyz": sample.cloud.xyz,
        "frame_id": sample.cloud.frame_id,
        "stamp_ns": np.int64(sample.cloud.stamp_ns),
        "sample_stamp_ns": np.int64(sample.stamp_ns),
        "g1": sample.grasp.g1,
        "g2": sample.grasp.g2,
        "rotation": sample.grasp.rotation,
        "score": np.float64(sample.grasp.score),
        "extra_names": np.array(list(extra), dtype=np.str_),
        "extra_values": np.array(list(extra.values()), np.float64),
    }
    if sample.cloud.rgb is not None:
        arrays["rgb"] = sample.cloud.rgb
    for name, touch in (("touch", sample.touch), ("tare", sample.tare)):
        if touch is not None:
            arrays[name] = touch.vector()
    if record.series is not None:
        arrays |= {"series_stamps_ns": record.series.stamps_ns, "series": record.series.counts}
        arrays["series_phases"] = record.series.phases
    return arrays


def _to_bag(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    from foretouch.dataset.bag_writer import BagWriter
    from foretouch.dataset.recording.definitions import Definitions

    with BagWriter(out) as writer:
        writer.define(SAMPLE_TYPE, Definitions().text(SAMPLE_TYPE))
        writer.add_topic(SAMPLE_TOPIC, SAMPLE_TYPE)
        for k in range(len(samples)):
            progress()
            record = samples.record(k)
            data = encode_sample(record, samples.identity)
            writer.write(SAMPLE_TOPIC, SAMPLE_TYPE, record.sample.stamp_ns, data)
            writer.write_cloud(record.sample.cloud, CLOUD_TOPIC, bag_time_ns=record.sample.stamp_ns)
            result.written += 1


_EXPORTERS: Final[dict[ExportFormat, _Exporter]] = {
    "vision2tactile": _to_folders,
    "npz": _to_archives,
    "rosbag2": _to_bag,
}
