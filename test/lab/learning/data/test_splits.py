# SPDX-License-Identifier: Apache-2.0
"""Splits as part of the data: no id on both sides, P2's label ratios, the same for the same seed."""

import json
from pathlib import Path

import numpy as np
import pytest
from every_case import every_refusal

from foretouch.errors import DatasetError, FileError
from foretouch_lab.dataset.store_writer import SampleFacts
from foretouch_lab.learning.data.folds import group_folds, make_folds
from foretouch_lab.learning.data.splits import RATIOS, SPLITS_FILE, _label_ratios, make_splits, read_splits


def facts(objects: int = 6, each: int = 20, unlabelled: int = 7) -> list[SampleFacts]:
    numbers = [(k, o) for k in range(each) for o in range(objects)]
    labelled = [SampleFacts(f"o{o}/{k:06d}", f"o{o}", 1000 * o + k, labelled=True) for k, o in numbers]
    return labelled + [SampleFacts(f"o0/9{k:05d}", "o0", k, labelled=False) for k in range(unlabelled)]


@pytest.fixture
def book(tmp_path: Path) -> dict[str, list[dict]]:
    (tmp_path / SPLITS_FILE).write_text(make_splits(facts(), 3))
    return read_splits(tmp_path)[0]


def test_folds_are_even_and_seeded_blocks_of_time_are_consecutive_and_objects_stay_whole(rng) -> None:
    stamps = rng.permutation(18)
    samples = [SampleFacts(str(k), "aaaaaaabbbbbcccccc"[k], int(stamps[k]), labelled=True) for k in range(18)]
    names = np.array([sample.object for sample in samples])
    one, again, other = (make_folds(samples, "random", seed) for seed in (3, 3, 4))
    assert {len(fold.test) for fold in one} == {3, 4}
    assert all(np.array_equal(a.test, b.test) for a, b in zip(one, again, strict=True))
    assert any(not np.array_equal(a.test, b.test) for a, b in zip(one, other, strict=True))
    for fold in make_folds(samples, "time", 0):
        for name in "abc":
            test, train = (np.sort(stamps[side[names[side] == name]]) for side in (fold.test, fold.train))
            assert test.size > 0
            assert not np.any((train > test[0]) & (train < test[-1]))
    for kind in (
        "random",
        "time",
        "object",
        "two groups",
    ):  # each sample is tested once, and not where it is learned from
        grouped = kind == "two groups"
        folds = group_folds(names, 2, np.random.default_rng(0)) if grouped else make_folds(samples, kind, 0)
        assert sorted(np.concatenate([fold.test for fold in folds])) == list(range(18))
        assert all(sorted([*fold.train, *fold.test]) == list(range(18)) for fold in folds)
        if grouped or kind == "object":
            assert all(not set(names[fold.train]) & set(names[fold.test]) for fold in folds)
    assert [fold.name for fold in make_folds(samples, "object", 0)] == ["a", "b", "c"]
    cases = (
        ("4 samples are fewer than 5 folds", "random", samples[:4]),
        ("4 samples of b are fewer than 5 folds", "time", samples[:11]),
        ("folds: all samples are of a; to keep groups apart takes 2", "object", samples[:4]),
        ("'blocks' is not one of random, time, object", "blocks", samples),
    )
    every_refusal(DatasetError, cases, lambda split, some: make_folds(some, split, 0))


def test_label_ratios_share_their_test_are_nested_and_of_the_papers_numbers(book: dict[str, list[dict]]) -> None:
    parts = book["labels"]
    assert [part["name"] for part in parts] == [f"T{ratio}" for ratio in RATIOS]
    never = {sample.id for sample in facts() if not sample.labelled}
    without: set[str] = set()
    for ratio, part in zip(RATIOS, parts, strict=True):
        assert part["test"] == parts[0]["test"]
        assert len(part["test"]) == 6 * 4
        assert len(set(part["unlabelled"]) - never) == round(96 * ratio / 100)
        assert len(part["train"]) == 96 - round(96 * ratio / 100)
        assert without < set(part["unlabelled"])
        assert never < set(part["unlabelled"])
        without = set(part["unlabelled"])
    # P2: 4 objects x 1000 grasps, 200 of each for test, T10 leaves 10 % of 3200 without labels.
    groups = [name for name in "abcd" for _ in range(1000)]
    test, parts = _label_ratios(groups, np.random.default_rng(0))
    assert [np.sum(np.asarray(groups)[test] == name) for name in "abcd"] == [200, 200, 200, 200]
    sizes = {name: (len(train), len(without)) for name, (train, without) in parts.items()}
    assert sizes == {f"T{share}": (32 * (100 - share), 32 * share) for share in (10, 30, 50, 70, 90)}


def test_the_seed_decides_and_what_cannot_be_split_is_told() -> None:
    assert make_splits(facts(), 1) == make_splits(facts(), 1)
    assert make_splits(facts(), 1) != make_splits(facts(), 2)
    book = json.loads(make_splits(facts(objects=1, each=6, unlabelled=0)))
    assert book["splits"].keys() == {"random", "time", "labels"}
    assert book["omitted"] == {"object": "folds: all samples are of o0; to keep groups apart takes 2"}
    assert set(json.loads(make_splits([]))["omitted"]) == {"random", "object", "time", "labels"}


def test_an_id_on_two_sides_and_other_files_are_refused(tmp_path: Path) -> None:
    def read(content: object) -> None:
        (tmp_path / SPLITS_FILE).write_text(json.dumps(content))
        read_splits(tmp_path)

    part = {"name": "fold", "train": ["a"], "test": ["a"]}
    twice = [part, {"name": "fold", "train": ["a", "a"]}, {"name": "fold", "test": ["a"], "unlabelled": ["a"]}]
    cases = [
        *(("split fold: a is listed twice", {"schema_version": 1, "splits": {"random": [one]}}) for one in twice),
        (r"\[\] is not a mapping", []),
        ("schema_version: 2 is not 1", {"schema_version": 2}),
        (
            r"splits.a\[0\].train\[0\]: 7 is not a text",
            {"schema_version": 1, "splits": {"a": [{**part, "train": [7]}]}},
        ),
        ("omitted.a: .* is not a text", {"schema_version": 1, "splits": {}, "omitted": {"a": None}}),
    ]
    every_refusal(FileError, cases, read)
