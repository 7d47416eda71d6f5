# SPDX-License-Identifier: Apache-2.0
"""Samples to learn from or to be judged on, with their hash and their splits."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from foretouch.dataset.samples import only_finite, open_samples
from foretouch.dataset.store import sample_digest
from foretouch.dataset.store_writer import SampleFacts
from foretouch.dataset.vision2tactile import folder_sha256
from foretouch.errors import DatasetError
from foretouch.learning.data.folds import Indices
from foretouch.learning.data.splits import SPLITS_FILE, SplitPart, make_splits, parse_splits, read_splits
from foretouch.types import GraspSample

__all__ = ["Collection", "load_collection"]


@dataclass(frozen=True, eq=False)
class Collection:
    """What lies at a path.

    Attributes:
        name: Of the file or folder.
        samples: In order; without those that the operator discarded.
        sha256: Over the samples in order: that of the training store they make.
        splits: The parts of each kind.
        aliases: Other hashes by which cards may name the same samples.
        omitted: Why these samples have no such split, by kind.
    """

    name: str
    samples: tuple[GraspSample, ...]
    sha256: str
    splits: dict[str, list[SplitPart]]
    aliases: tuple[str, ...] = ()
    omitted: dict[str, str] = field(default_factory=dict)

    def parts(self, split: str) -> list[SplitPart]:
        """The parts of a split.

        Args:
            split: `KIND`, such as "time", or `KIND/PART`, such as "labels/T50".

        Raises:
            DatasetError: If these samples have no such split; tells why, or those that they have.
        """
        kind, _, name = split.partition("/")
        if kind in self.omitted:
            raise DatasetError(f"{self.name}: split: {kind!r} cannot be made of these samples: {self.omitted[kind]}")
        if kind not in self.splits:
            raise DatasetError(f"{self.name}: split: {kind!r} is none of {', '.join(self.splits) or 'none'}")
        parts = [part for part in self.splits[kind] if name in ("", part.name)]
        if not parts:
            known = ", ".join(f"{kind}/{part.name}" for part in self.splits[kind])
            raise DatasetError(f"{self.name}: split: {split!r} is none of {known}")
        return parts

    def index(self, ids: Sequence[str]) -> Indices:
        """(S,) places of some samples, in order of the ids.

        Raises:
            DatasetError: If one is not there.
        """
        place = {sample.id: k for k, sample in enumerate(self.samples)}
        missing = [name for name in ids if name not in place]
        if missing:
            raise DatasetError(f"{self.name}: {missing[0]}: is in the split and not among the samples")
        return np.array([place[name] for name in ids], np.intp)


def load_collection(path: str | Path) -> Collection:
    """Read all samples at a path.

    Args:
        path: A recorded dataset, a training store, or folders of vision2tactile. The splits are the store's own
            where it has some, and else made with seed 0.

    Raises:
        FileError: If there are none, or what is there is damaged.
        DatasetError: If two samples have one id.
    """
    path = Path(path)
    with open_samples(path) as opened:
        samples = tuple(only_finite(record.sample) for record in opened.records())
    if len({sample.id for sample in samples}) != len(samples):
        raise DatasetError(f"{path}: two samples have one id")
    content = hashlib.sha256()
    for sample in samples:
        content.update(sample_digest(sample))
    if (path / SPLITS_FILE).is_file():
        book = read_splits(path)
    else:
        facts = [SampleFacts(s.id, s.object, s.stamp_ns, s.touch is not None) for s in samples]
        book = parse_splits(make_splits(facts))
    aliases = (folder_sha256(path),) if opened.kind == "vision2tactile" else ()
    return Collection(path.name, samples, content.hexdigest(), book.parts, aliases, book.omitted)
