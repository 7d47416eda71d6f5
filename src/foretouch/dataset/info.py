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
from foretouch.types import Float64

#: Bin edges of the histogram of pairing errors [ms].
PAIRING_EDGES_MS: Final = (0.0, 5.0, 10.0, 20.0, 50.0, 100.0, float("inf"))


@dataclass(kw_only=True)
class SampleSetInfo:
    """Counts and ranges of a dataset; the names are the keys of the JSON output."""

    kind: str  # name of the format
    samples: int = 0  # all, including discarded ones
    labelled: int = 0  # those with a touch
    tared: int = 0  # those with a reading without contact
    discarded: int = 0  # those that the operator discarded
    objects: Counter[str] = field(default_factory=Counter)  # samples by object
    outcomes: Counter[str] = field(default_factory=Counter)  # samples by outcome
    flags: Counter[str] = field(default_factory=Counter)  # samples by flag
    first_ns: int = 0  # earliest stamp [ns]; 0 if there is no sample
    last_ns: int = 0  # latest stamp [ns]
    points: tuple[int, int, int] = (0, 0, 0)  # minimum, median and maximum of a cloud
    ranges: dict[str, tuple[float, float]] = field(
        default_factory=dict
    )  # of each modality, in the unit of its channel; empty without touch
    pairing_ms: list[int] = field(default_factory=list)  # samples in the bins of `PAIRING_EDGES_MS`; empty if unknown
    sensor: str = ""  # its name and the first digits of the hash of its description
    units: dict[str, str] = field(default_factory=dict)  # of `ranges`
    dead: dict[str, list[int]] = field(default_factory=dict)  # taxels that are declared to have failed, by finger
    hand: dict[str, str] = field(default_factory=dict)
    camera: dict[str, str] = field(default_factory=dict)
    unfinished: list[str] = field(default_factory=list)  # recordings that were cut off and not repaired
    accounts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # message counts by topic
    edits: list[str] = field(default_factory=list)  # descriptions of later changes


def describe(path: str | Path) -> SampleSetInfo:
    """Read every sample once and collect the statistics.

    Raises:
        FileError: If there is no dataset, or a sample is damaged.
    """
    touches: list[Float64] = []
    sizes: list[int] = []
    stamps: list[int] = []
    errors: list[float] = []
    samples = open_samples(path, unfinished=True)
    sensor, channels = samples.sensor, samples.sensor.channels
    info = SampleSetInfo(
        kind=samples.kind,
        sensor=f"{sensor.config.name} ({sensor.sha256[:8]})",
        dead={one.name: list(one.dead) for one in sensor.config.fingers if one.dead},
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
            touches.append(sample.touch.values)
    if sizes:
        info.points = (min(sizes), int(np.median(sizes)), max(sizes))
        info.first_ns, info.last_ns = min(stamps), max(stamps)
    info.labelled = len(touches)
    for name in channels.modalities if touches else ():
        counts = np.stack(touches)[:, channels.columns([name])]
        info.ranges[name] = (float(counts.min()), float(counts.max()))
        info.units[name] = channels.channel_of[name].unit
    if errors:
        info.pairing_ms = np.histogram(errors, PAIRING_EDGES_MS)[0].tolist()
    return info
