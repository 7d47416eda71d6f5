# SPDX-License-Identifier: Apache-2.0
"""Statistics of a dataset: counts, ranges and the accuracy of its pairing."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.dataset.record import DISCARDED
from foretouch.dataset.samples import open_samples
from foretouch.types import TOUCH_SIZE, Float64

PAIRING_EDGES_MS: Final = (0.0, 5.0, 10.0, 20.0, 50.0, 100.0, float("inf"))
"""Bin edges of the histogram of pairing errors [ms]."""

_PARTS: Final = {"PDC_TH": slice(0, 1), "PDC_MF": slice(1, 2), "E_TH": slice(2, 26), "E_MF": slice(26, 50)}


@dataclass(kw_only=True)
class SampleSetInfo:
    """Counts and ranges of a dataset; the names are the keys of the JSON output.

    Attributes:
        kind: Name of the format.
        samples: All samples, including discarded ones.
        labelled: Samples with a touch.
        tared: Samples with a reading without contact.
        discarded: Samples that the operator discarded.
        objects: Samples by object.
        outcomes: Samples by outcome.
        flags: Samples by flag.
        first_ns, last_ns: Earliest and latest stamp [ns]; 0 if there is no sample.
        points: Minimum, median and maximum number of points of a cloud.
        ranges: Minimum and maximum of each modality [counts]; empty if no sample is labelled.
        pairing_ms: Samples by pairing error, in the bins of `PAIRING_EDGES_MS`; empty if no error is known.
        hand, camera: Their properties.
        unfinished: Recordings that were cut off and not repaired.
        accounts: Message counts by topic: received, written, dropped by reason, lost before arrival.
        edits: Descriptions of later changes.
    """

    kind: str
    samples: int = 0
    labelled: int = 0
    tared: int = 0
    discarded: int = 0
    objects: Counter[str] = field(default_factory=Counter)
    outcomes: Counter[str] = field(default_factory=Counter)
    flags: Counter[str] = field(default_factory=Counter)
    first_ns: int = 0
    last_ns: int = 0
    points: tuple[int, int, int] = (0, 0, 0)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    pairing_ms: list[int] = field(default_factory=list)
    hand: dict[str, str] = field(default_factory=dict)
    camera: dict[str, str] = field(default_factory=dict)
    unfinished: list[str] = field(default_factory=list)
    accounts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    edits: list[str] = field(default_factory=list)


def describe(path: str | Path) -> SampleSetInfo:
    """Read every sample once and collect the statistics.

    Raises:
        FileError: If there is no dataset, or a sample is damaged.
    """
    low: Float64 = np.full(TOUCH_SIZE, np.inf)
    high: Float64 = np.full(TOUCH_SIZE, -np.inf)
    sizes: list[int] = []
    stamps: list[int] = []
    errors: list[float] = []
    with open_samples(path, unfinished=True) as samples:
        info = SampleSetInfo(
            kind=samples.kind,
            hand=dict(samples.identity.hand),
            camera=dict(samples.identity.camera),
            unfinished=[file.name for file in samples.unfinished],
            accounts=samples.message_counts(),
            edits=list(samples.edits),
        )
        for record in samples.records(discarded=True):
            sample = record.sample
            info.samples += 1
            info.objects[sample.object] += 1
            info.outcomes[record.outcome] += 1
            info.flags.update(record.flags)
            info.discarded += DISCARDED in record.flags
            info.tared += sample.tare is not None
            sizes.append(sample.cloud.size)
            stamps.append(sample.stamp_ns)
            if record.pairing_error_ns is not None:
                errors.append(record.pairing_error_ns * 1e-6)
            if sample.touch is not None:
                info.labelled += 1
                vector = sample.touch.vector()
                low, high = np.minimum(low, vector), np.maximum(high, vector)
    if sizes:
        info.points = (min(sizes), int(np.median(sizes)), max(sizes))
        info.first_ns, info.last_ns = min(stamps), max(stamps)
    if info.labelled:
        info.ranges = {name: (float(low[part].min()), float(high[part].max())) for name, part in _PARTS.items()}
    if errors:
        info.pairing_ms = np.histogram(errors, PAIRING_EDGES_MS)[0].tolist()
    return info
