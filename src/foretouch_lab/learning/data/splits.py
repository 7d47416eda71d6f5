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
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from foretouch.base.files import TEXT_LIMIT, json_in, read_bytes, require_schema
from foretouch.errors import DatasetError, FileError, shown
from foretouch_lab.dataset.store_writer import SampleFacts
from foretouch_lab.learning.data.folds import FOLDS, Indices, group_folds, make_folds

SPLITS_FILE: Final = "splits.json"
RATIOS: Final = (10, 30, 50, 70, 90)
_KINDS: Final = ("random", "object", "time", "labels")  # in this order, which seeds them
_TEST_PER_OBJECT: Final = 200  # of P2's 1000
_TEST_SHARE: Final = 0.2
_VERSION: Final = 1
SIDES: Final = ("train", "test", "unlabelled")
"""Of a part: samples to learn from with their labels, to test on, and to learn from without their labels."""

_PART: Final = {"name": str, **{f"{side}?": [str] for side in SIDES}}


DatasetSplits: TypeAlias = tuple[dict[str, list[dict[str, Any]]], dict[str, str]]
"""By kind its parts, by ids as in `splits.json`; and why there are too few samples for a kind."""


def _label_ratios(
    groups: Sequence[str], rng: np.random.Generator
) -> tuple[Indices, dict[str, tuple[Indices, Indices]]]:
    """Return the test samples, and for each of P2's T10...T90 the training samples with and without their labels.

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
    """Return all splits as the text of `splits.json`.

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
            splits[kind] = list(_parts(kind, samples, np.random.default_rng([seed, number])))
        except DatasetError as err:
            omitted[kind] = str(err)
    content = {"schema_version": _VERSION, "seed": seed, "splits": splits, "omitted": omitted}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def read_splits(path: str | Path) -> DatasetSplits:
    """Read the splits of a dataset, or of a `splits.json`.

    Raises:
        FileError: If there is no such file, it is damaged or of another version, or an id is in two parts.
    """
    path = Path(path)
    file = path / SPLITS_FILE if path.is_dir() else path
    return parse_splits(read_bytes(file, TEXT_LIMIT), file)


def parse_splits(text: bytes, file: str | Path = SPLITS_FILE) -> DatasetSplits:
    """Parse the text of a `splits.json`; raises `FileError`, which names `file`, as `read_splits`."""
    content = require_schema(file, json_in(file, text), dict)
    version = content.get("schema_version")
    if version != _VERSION:
        raise FileError(file, f"{shown(version)} is not {_VERSION}", field="schema_version")
    require_schema(file, content, {"splits": dict, "omitted?": dict})
    kinds, omitted = content["splits"], content.get("omitted", {})
    require_schema(file, kinds, {kind: [_PART] for kind in kinds}, "splits")
    require_schema(file, omitted, dict.fromkeys(omitted, str), "omitted")
    for part in (part for parts in kinds.values() for part in parts):
        ids = Counter(sample_id for side in SIDES for sample_id in part.get(side, ()))
        if twice := [sample_id for sample_id, count in ids.items() if count > 1]:
            raise FileError(file, f"split {shown(part['name'])}: {shown(min(twice))} is listed twice")
    return kinds, omitted


def _parts(kind: str, samples: Sequence[SampleFacts], rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    labelled = [sample for sample in samples if sample.labelled]
    if not labelled:
        raise DatasetError("no sample is labelled")
    groups = [sample.object for sample in labelled]

    def ids(index: Indices) -> list[str]:
        return [labelled[k].id for k in index]

    if kind == "labels":
        never = [sample.id for sample in samples if not sample.labelled]
        test, ratios = _label_ratios(groups, rng)
        for name, (train, without) in ratios.items():
            unlabelled = {"unlabelled": unlabelled_ids} if (unlabelled_ids := ids(without) + never) else {}
            yield {"name": name, "train": ids(train), "test": ids(test), **unlabelled}
        return
    by_fives = kind == "object" and len(set(groups)) >= FOLDS
    for fold in group_folds(groups, FOLDS, rng) if by_fives else make_folds(labelled, kind, rng):
        yield {"name": fold.name, "train": ids(fold.train), "test": ids(fold.test)}
