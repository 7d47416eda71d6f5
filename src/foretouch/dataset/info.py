# SPDX-License-Identifier: Apache-2.0
"""Statistics of a dataset: counts, ranges and the accuracy of its pairing."""

from collections import Counter
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.dataset.formats import open_samples
from foretouch.types import DISCARDED

#: Bin edges of the histogram of pairing errors [ms].
PAIRING_EDGES_MS: Final = (0.0, 5.0, 10.0, 20.0, 50.0, 100.0, float("inf"))


def describe(path: str | Path) -> dict[str, Any]:
    """Read every sample once, also discarded ones, and collect counts and ranges by their keys in the JSON output.

    Raises:
        FileError: If there is no dataset, or a sample is damaged.
    """
    samples = open_samples(path, unfinished=True)
    sensor, channels = samples.sensor, samples.sensor.channels
    objects = Counter[str]()
    outcomes = Counter[str]()
    flags = Counter[str]()
    touches = []
    sizes = []
    stamps = []
    errors = []
    tared = tables = 0
    for sample in samples.with_discarded():
        objects[sample.object] += 1
        outcomes[sample.outcome] += 1
        flags.update(sample.flags)
        tared += sample.tare is not None
        tables += sample.table is not None
        sizes.append(sample.cloud.size)
        stamps.append(sample.stamp_ns)
        if sample.pairing_error_ns is not None:
            errors.append(sample.pairing_error_ns * 1e-6)
        if sample.touch is not None:
            touches.append(sample.touch.values)
    values = {name: np.stack(touches)[:, columns] for name, columns in channels.modality_columns.items() if touches}
    return {
        "kind": samples.kind,  # name of the format
        "samples": len(sizes),
        "labelled": len(touches),
        "tared": tared,
        "tables": tables,  # samples that hold their table; of others the camera is taken to look straight down on it
        "discarded": flags[DISCARDED],
        "objects": objects,
        "outcomes": outcomes,
        "flags": flags,
        "first_ns": min(stamps, default=0),  # earliest stamp [ns]
        "last_ns": max(stamps, default=0),
        "points": (min(sizes), int(np.median(sizes)), max(sizes)) if sizes else (0, 0, 0),  # of a cloud
        "ranges": {
            name: (float(value.min()), float(value.max())) for name, value in values.items()
        },  # of each modality
        "pairing_ms": np.histogram(errors, PAIRING_EDGES_MS)[0].tolist() if errors else [],
        "sensor": f"{sensor.config.name} ({sensor.sha256[:8]})",
        "units": {name: channels.channel_of[name].unit for name in values},  # of `ranges`
        "dead": {
            finger.name: list(finger.dead) for finger in sensor.config.fingers if finger.dead
        },  # taxels that failed
        "hand": dict(samples.identity.hand),
        "camera": dict(samples.identity.camera),
        "unfinished": [file.name for file in samples.unfinished],  # recordings that were cut off and not repaired
        "accounts": samples.message_counts(),  # message counts by topic
        "edits": list(samples.edits),  # descriptions of later changes
    }
