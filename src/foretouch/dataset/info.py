# SPDX-License-Identifier: Apache-2.0
"""What a set of samples holds, in numbers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.dataset.recording import RecordedDataset
from foretouch.dataset.samples import DISCARDED, SampleSetKind, open_samples
from foretouch.types import TOUCH_SIZE, Float64

__all__ = ["PAIRING_EDGES_MS", "SampleSetInfo", "describe"]

PAIRING_EDGES_MS: Final = (0.0, 5.0, 10.0, 20.0, 50.0, 100.0, float("inf"))
"""Edges of the histogram of pairing errors [ms]."""

_PARTS: Final = {"PDC_TH": slice(0, 1), "PDC_MF": slice(1, 2), "E_TH": slice(2, 26), "E_MF": slice(26, 50)}


@dataclass(kw_only=True)
class SampleSetInfo:
    """Counts and ranges of a set of samples.

    Attributes:
        kind: What the set is.
        samples: All, the discarded ones included.
        labelled: Those with a touch.
        tared: Those with a reading without contact.
        discarded: Those that the operator does not want.
        objects: Samples by object.
        outcomes: Samples by outcome.
        flags: Samples by flag.
        first_ns, last_ns: Earliest and latest stamp [ns]; 0 where there is no sample.
        points: Least, median and most points of a cloud.
        ranges: Least and most of each modality [counts]; empty where nothing is labelled.
        pairing_ms: Samples by pairing error, beside `PAIRING_EDGES_MS`; empty where none is known.
        hand, camera: Their identities.
        unfinished: Recordings that were cut off and not repaired.
        accounts: What became of every message, by topic: received, written, dropped by reason, lost on the way.
        edits: What was changed afterwards, in words.
    """

    kind: SampleSetKind
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
    accounts: dict[str, dict[str, Any]] = field(default_factory=dict)
    edits: list[str] = field(default_factory=list)


def describe(path: str | Path) -> SampleSetInfo:
    """Read every sample once and count.

    Raises:
        FileError: If there are no samples, or one is damaged.
    """
    low: Float64 = np.full(TOUCH_SIZE, np.inf)
    high: Float64 = np.full(TOUCH_SIZE, -np.inf)
    sizes: list[int] = []
    stamps: list[int] = []
    errors: list[float] = []
    with open_samples(path, unfinished=True) as samples:
        info = SampleSetInfo(kind=samples.kind, hand=dict(samples.identity.hand), camera=dict(samples.identity.camera))
        info.unfinished = [file.name for file in samples.unfinished]
        if samples.kind == "recording":
            with RecordedDataset(path) as recorded:
                info.accounts, info.edits = recorded.accounts().to_record(), recorded.edits.told()
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
