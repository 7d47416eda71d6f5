# SPDX-License-Identifier: Apache-2.0
"""Export to NumPy archives: `<object>/<name>.npz`, one a sample; `foretouch.cloud.io.files` reads their clouds."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.dataset.record import SampleRecord, check_id
from foretouch.dataset.samples import DatasetFormat, ExportResult, SampleSet


def _export(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    out.mkdir(parents=True)
    for record in samples.records():
        progress()
        check_id(record.sample.id, record.sample.object)
        file = out / f"{record.sample.id}.npz"
        file.parent.mkdir(exist_ok=True)
        np.savez(file, **_arrays(record))
        result.written += 1


def _arrays(record: SampleRecord) -> dict[str, Any]:
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


DATASET_FORMAT = DatasetFormat(export=_export)
