# SPDX-License-Identifier: Apache-2.0
"""Samples from wherever they lie: a recorded dataset or one of its files, a training store, folders of vision2tactile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from foretouch.dataset.recording.reader import RecordedDataset, holds_samples
from foretouch.dataset.recording.record import DISCARDED, Identity, SampleRecord
from foretouch.dataset.store import Store, is_store
from foretouch.dataset.vision2tactile import is_sample_folder, read_sample, sample_folders
from foretouch.errors import DatasetError, FileError
from foretouch.types import GraspSample

__all__ = ["DISCARDED", "SampleSet", "SampleSetKind", "is_sample_set", "only_finite", "open_samples"]

SampleSetKind = Literal["recording", "store", "vision2tactile"]

_COLLECTION = Identity(
    hand={"name": "Shadow Hand with BioTac SP", "source": "vision2tactile"},
    camera={"source": "vision2tactile"},
)


@dataclass(frozen=True, eq=False)
class SampleSet:
    """An ordered, repeatable walk over samples; a context manager where files stay open.

    Attributes:
        path: Where they lie.
        kind: As what.
        size: Number of samples, the discarded ones included.
        identity: Hand and camera, so far as they are known.
        record: Reads one sample by its number; raises `FileError` with file and place.
        name: Tells where one lies.
        closes: What to call in the end.
        unfinished: Recordings that were cut off, where those may be read.
    """

    path: Path
    kind: SampleSetKind
    size: int
    identity: Identity
    record: Callable[[int], SampleRecord]
    name: Callable[[int], str]
    closes: Callable[[], None]
    unfinished: tuple[Path, ...] = ()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.closes()

    def __len__(self) -> int:
        return self.size

    def records(self, *, discarded: bool = False) -> Iterator[SampleRecord]:
        """The samples in order.

        Args:
            discarded: Whether those are among them that the operator does not want.
        """
        for k in range(self.size):
            record = self.record(k)
            if discarded or DISCARDED not in record.flags:
                yield record


def is_sample_set(path: str | Path) -> bool:
    """Whether samples lie at the path, of a kind that `open_samples` knows."""
    path = Path(path)
    return holds_samples(path) or is_store(path) or _is_collection(path)


def open_samples(path: str | Path, *, unfinished: bool = False) -> SampleSet:
    """Open whatever samples lie at a path.

    Args:
        path: Where.
        unfinished: Whether to read recordings that were cut off, up to there.

    Raises:
        FileError: If there are none, or what is there is damaged, cut off or of another version.
    """
    path = Path(path)
    if holds_samples(path):
        return _recorded(path, unfinished=unfinished)
    if is_store(path):
        return _stored(path)
    if _is_collection(path):
        return _collected(path)
    rule = "holds no samples: no recorded dataset, no training store, no vision2tactile folders"
    raise FileError(path, rule if path.exists() else "does not exist")


def only_finite(sample: GraspSample) -> GraspSample:
    """The sample with its cloud unorganised and without the points that have no depth."""
    cloud = sample.cloud
    finite: npt.NDArray[np.bool_] = np.asarray(np.isfinite(cloud.xyz).all(axis=-1))
    if not cloud.organised and finite.all():
        return sample
    return replace(sample, cloud=cloud.take(finite))


def _recorded(path: Path, *, unfinished: bool) -> SampleSet:
    dataset = RecordedDataset(path)
    cut = tuple(dataset.unfinished)
    if cut and not unfinished:
        dataset.close()
        raise FileError(cut[0], "is not finished: `foretouch dataset repair` makes it whole")
    identity = dataset[0].identity if len(dataset) else Identity(hand={}, camera={})
    return SampleSet(
        path, "recording", len(dataset), identity, lambda k: dataset[k].record, dataset.name, dataset.close, cut
    )


def _stored(path: Path) -> SampleSet:
    store = Store(path)
    about: Any = store.manifest.get("about", {})
    identity = Identity(hand=about.get("hand", {}), camera=about.get("camera", {}))

    def name(k: int) -> str:
        return f"{path}[{k}]"

    return SampleSet(path, "store", len(store), identity, lambda k: SampleRecord(sample=store[k]), name, _nothing)


def _collected(path: Path) -> SampleSet:
    folders = sample_folders(path)

    def record(k: int) -> SampleRecord:
        return SampleRecord(sample=read_sample(folders[k]))

    return SampleSet(path, "vision2tactile", len(folders), _COLLECTION, record, lambda k: str(folders[k]), _nothing)


def _is_collection(path: Path) -> bool:
    if not path.is_dir():
        return False
    try:
        return is_sample_folder(sample_folders(path)[0])
    except DatasetError:
        return False


def _nothing() -> None:
    """Folders and memory-mapped shards need no closing."""
