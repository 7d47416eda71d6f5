# SPDX-License-Identifier: Apache-2.0
"""A configuration that trains within a second, a store to train on, and report callbacks."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from foretouch.types import Sample
from foretouch_lab.dataset.store_writer import SampleFacts, StoreWriter
from foretouch_lab.learning.data.splits import SPLITS_FILE, make_splits
from foretouch_lab.learning.training.run_config import GROUPS, RunConfig

MODEL = {"n_points": 32, "tnet": False, "trunk_widths": [8, 16], "head_widths": [16], "outputs": ["PDC_TH"]}
BASE: dict[str, Any] = {
    "name": "tiny",
    "model": MODEL,
    "train": {"epochs": 4, "batch_size": 8, "target_scaling": "standardised"},
    "srgan": {"epochs": 4, "batch_size": 5, "learning_rate": 0.001, "generator": {"noise_length": 4, "stride": 2}},
}


def run_config(**changes: Any) -> RunConfig:
    """`BASE` with some groups replaced, without those that the method does not use."""
    given = {**BASE, **changes}
    unused = {name for name, methods in GROUPS.items() if given.get("method", "supervised") not in methods}
    return RunConfig.from_mapping({key: value for key, value in given.items() if key not in unused})


def write_store(path: Path, samples: Iterable[Sample]) -> Path:
    """A store of labelled samples with their splits."""
    facts = []
    with StoreWriter(path, {}) as writer:
        for sample in samples:
            writer.write(sample)
            facts.append(SampleFacts(sample.id, sample.object, sample.stamp_ns, labelled=True))
        writer.attach(SPLITS_FILE, make_splits(facts, 3))
    return path


def quiet(_record: Mapping[str, Any]) -> None:
    """Reports nothing."""


def stop_after(epoch: int) -> Callable[[Mapping[str, Any]], None]:
    """Interrupts the run once an epoch is on disk."""

    def report(record: Mapping[str, Any]) -> None:
        if record.get("epoch") == epoch:
            raise KeyboardInterrupt

    return report
