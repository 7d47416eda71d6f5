# SPDX-License-Identifier: Apache-2.0
"""All splits of a dataset in one file, by sample ids: part of the dataset, made once from a seed.

    random   five folds of shuffled samples
    object   five folds of whole objects, or leave-one-out where there are fewer
    time     five blocks of each object's recording
    labels   P2's ratios: the same test samples, 200 of each object, and of the rest 10, 30, 50, 70 or 90 %
             without their labels (T10...T90); of an object with fewer than 1000 samples, a fifth is tested

Unlabelled samples are in no fold; they are listed with the unlabelled part of each ratio.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from foretouch.errors import DatasetError, FileError, shown
from foretouch.files import TEXT_LIMIT, json_in, read_bytes, require_schema
from foretouch_lab.dataset.store_writer import SampleFacts
from foretouch_lab.learning.data.folds import FOLDS, Indices, group_folds, make_folds

SPLITS_FILE: Final = "splits.json"
RATIOS: Final = (10, 30, 50, 70, 90)
_KINDS: Final = ("random", "object", "time", "labels")  # in this order, which seeds them
_TEST_PER_OBJECT: Final = 200  # of P2's 1000
_TEST_SHARE: Final = 0.2
_VERSION: Final = 1
_PART: Final = {"name": str, "train?": [str], "test?": [str], "unlabelled?": [str]}


@dataclass(frozen=True)
class SplitPart:
    """One partition of the samples, by id."""

    name: str  # such as "random 0" or "T30"
    train: tuple[str, ...]
    test: tuple[str, ...]
    unlabelled: tuple[str, ...] = ()  # samples to train on without their labels

    def __post_init__(self) -> None:
        """Raise `DatasetError`, with the split and an id, if an id is in two parts."""
        seen: set[str] = set()
        for side in (self.train, self.test, self.unlabelled):
            both = seen.intersection(side)
            if both or len(set(side)) != len(side):
                raise DatasetError(f"split {self.name}: {min(both or side)} is listed twice")
            seen.update(side)


DatasetSplits: TypeAlias = tuple[dict[str, list[SplitPart]], dict[str, str]]


def _label_ratios(
    groups: Sequence[str], rng: np.random.Generator
) -> tuple[Indices, dict[str, tuple[Indices, Indices]]]:
    """The test samples, and for each of P2's T10...T90 the training samples with and without their labels.

    A sample without its label at one ratio has none at higher ratios. With too few samples it raises `DatasetError`.
    """
    names = np.asarray(groups, dtype=str)
    test: list[int] = []
    for name in np.unique(names):
        members = rng.permutation(np.flatnonzero(names == name))
        if len(members) < 2:
            raise DatasetError(f"labels: {name} has {len(members)} sample, too few to test on one")
        test.extend(members[: max(1, min(_TEST_PER_OBJECT, round(_TEST_SHARE * len(members))))])
    rest = rng.permutation(np.setdiff1d(np.arange(len(names)), test))
    if len(rest) < 2:
        raise DatasetError(f"labels: {len(rest)} samples remain to train on")
    cuts = {f"T{ratio}": round(len(rest) * ratio / 100) for ratio in RATIOS}
    parts = {name: (np.sort(rest[cut:]), np.sort(rest[:cut])) for name, cut in cuts.items()}
    return np.sort(np.asarray(test, np.intp)), parts


def make_splits(samples: Sequence[SampleFacts], seed: int = 0) -> str:
    """All splits as the text of `splits.json`.

    Args:
        samples: In the order of the store.
        seed: Seed of every choice; the same samples and seed give the same text.

    Returns:
        JSON. A split for which there are too few samples is missing; `omitted` gives the reason.
    """
    splits: dict[str, list[dict[str, Any]]] = {}
    omitted: dict[str, str] = {}
    for number, kind in enumerate(_KINDS):
        try:
            splits[kind] = [_plain(part) for part in _parts(kind, samples, np.random.default_rng([seed, number]))]
        except DatasetError as err:
            omitted[kind] = str(err)
    content = {"schema_version": _VERSION, "seed": seed, "splits": splits, "omitted": omitted}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def read_splits(path: str | Path) -> DatasetSplits:
    """Read the splits of a dataset, or those of a `splits.json`: by kind its parts; and why there are too few samples for a kind.

    Raises:
        FileError: If there is no such file, it is damaged or of another version, or an id is in two parts.
    """
    path = Path(path)
    file = path / SPLITS_FILE if path.is_dir() else path
    return parse_splits(read_bytes(file, TEXT_LIMIT), file)


def parse_splits(text: bytes, file: str | Path = SPLITS_FILE) -> DatasetSplits:
    """Parse the text of a `splits.json`; raises `FileError`, which names `file`, as `read_splits`."""
    content = require_schema(file, json_in(file, text), dict)
    if (version := content.get("schema_version")) != _VERSION:
        raise FileError(file, f"{shown(version)} is not {_VERSION}", field="schema_version")
    require_schema(file, content, {"splits": dict, "omitted?": dict})
    kinds, omitted = content["splits"], content.get("omitted", {})
    require_schema(file, kinds, {kind: [_PART] for kind in kinds}, "splits")
    require_schema(file, omitted, dict.fromkeys(omitted, str), "omitted")
    try:
        return {kind: [_part(entry) for entry in entries] for kind, entries in kinds.items()}, omitted
    except DatasetError as err:
        raise FileError(file, str(err)) from err


def _parts(kind: str, samples: Sequence[SampleFacts], rng: np.random.Generator) -> Iterator[SplitPart]:
    labelled = [sample for sample in samples if sample.labelled]
    if not labelled:
        raise DatasetError("no sample is labelled")
    groups = [sample.object for sample in labelled]
    if kind == "labels":
        never = tuple(sample.id for sample in samples if not sample.labelled)
        test, parts = _label_ratios(groups, rng)
        for name, (train, without) in parts.items():
            yield SplitPart(name, _ids(labelled, train), _ids(labelled, test), _ids(labelled, without) + never)
        return
    by_fives = kind == "object" and len(set(groups)) >= FOLDS
    folds = group_folds(groups, FOLDS, rng) if by_fives else make_folds(labelled, kind, rng)
    for fold in folds:
        yield SplitPart(fold.name, _ids(labelled, fold.train), _ids(labelled, fold.test))


def _ids(samples: Sequence[SampleFacts], index: Indices) -> tuple[str, ...]:
    return tuple(samples[int(k)].id for k in index)


def _plain(part: SplitPart) -> dict[str, Any]:
    unlabelled = {"unlabelled": list(part.unlabelled)} if part.unlabelled else {}
    return {"name": part.name, "train": list(part.train), "test": list(part.test), **unlabelled}


def _part(entry: Any) -> SplitPart:
    return SplitPart(entry["name"], *(tuple(entry.get(side, ())) for side in ("train", "test", "unlabelled")))
