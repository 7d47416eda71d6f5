# SPDX-License-Identifier: Apache-2.0
"""Readers and writers of damaged recordings: correct samples or a one-line error, and no memory for wrong lengths."""

import hashlib
import json
import struct
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recording_builders import IDENTITY, QUICK, assert_same_sample, record, write_dataset

from foretouch.dataset.info import describe
from foretouch.dataset.recording import RecordedDataset, RecordingWriter, repair_dataset, verify_dataset
from foretouch.dataset.recording.reader import sample_messages
from foretouch.dataset.recording.records import mapped, walk
from foretouch.dataset.recording.sample_codec import decode_sample, encode_sample
from foretouch.dataset.samples import export_samples
from foretouch.dataset.store_writer import StoreWriter, build_store
from foretouch.errors import DatasetError, FileError, ForetouchError

COUNT = 3


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "ds", COUNT, points=10)


def refusal(action: Callable[[], object]) -> str:
    """The one-line error of an action; "" if it succeeds."""
    try:
        action()
    except ForetouchError as err:
        return str(err)
    return ""


def read_and_compare(path: Path) -> None:
    """Every sample that is read equals the recorded one."""
    with RecordedDataset(path) as dataset:
        for stored in dataset:
            number = int(stored.record.sample.grasp.id.removeprefix("grasp-"))
            assert_same_sample(stored.record.sample, record(number, points=10).sample)


def is_one_line_of(path: Path, text: str) -> bool:
    return text == "" or (text.startswith(str(path)) and "\n" not in text)


def test_a_reader_of_flipped_bytes_gets_the_truth_or_one_line(file: Path, rng: np.random.Generator) -> None:
    good = file.read_bytes()
    for place in {*range(0, 60, 3), *map(int, rng.integers(0, len(good), 250))}:
        damaged = bytearray(good)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        assert is_one_line_of(file, refusal(lambda: read_and_compare(file)))


def test_a_reader_of_a_cut_file_gets_what_is_before_the_cut(file: Path, rng: np.random.Generator) -> None:
    good = file.read_bytes()
    for cut in {0, 1, 8, 9, 40, *map(int, rng.integers(0, len(good), 60))}:
        file.write_bytes(good[:cut])
        assert is_one_line_of(file, refusal(lambda: read_and_compare(file)))


def test_going_on_after_damage_overwrites_nothing_and_gives_no_id_twice(file: Path, rng: np.random.Generator) -> None:
    good = file.read_bytes()

    def go_on() -> None:
        with RecordingWriter(file.parent, IDENTITY, QUICK) as writer:
            writer.append(record(COUNT))

    for place in map(int, rng.integers(0, len(good), 25)):
        damaged = bytearray(good)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        assert is_one_line_of(file, refusal(go_on))
        assert file.read_bytes() == damaged
        repair_dataset(file.parent)
        assert [report.fault_lines() for report in verify_dataset(file.parent) if not report.clean] == []
        for other in set(file.parent.glob("session-*")) - {file}:
            other.unlink()


def test_going_on_after_a_crash_gives_no_id_twice_wherever_the_file_ends(file: Path) -> None:
    """A sample may be complete though its chunk is not: `repair` saves it, so its id is taken."""
    good = file.read_bytes()
    with mapped(file) as data:
        ends = [place.end for place in sample_messages(file, data)]
    for cut in (ends[-1], ends[-1] + 5, ends[-2], len(good) - 40):
        file.write_bytes(good[:cut])
        with RecordingWriter(file.parent, IDENTITY, QUICK) as writer:
            writer.append(record(COUNT))
        repair_dataset(file.parent)
        assert [report.fault_lines() for report in verify_dataset(file.parent) if not report.clean] == []
        for other in set(file.parent.glob("session-*")) - {file}:
            other.unlink()


@pytest.mark.parametrize("length", [2**31, 2**63 - 1, 2**64 - 1])
def test_no_length_of_a_record_makes_a_reader_take_memory(tmp_path: Path, length: int) -> None:
    file = write_dataset(tmp_path / "ds", 1, points=2000)
    good = file.read_bytes()
    with mapped(file) as data:
        places = [one.offset + 1 for one in walk(data, 8)]
    tracemalloc.start()
    for place in places:
        damaged = bytearray(good)
        damaged[place : place + 8] = struct.pack("<Q", length)
        file.write_bytes(damaged)
        for reader in (RecordedDataset, describe):
            assert "\n" not in refusal(lambda reader=reader: reader(file))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < len(good) + 4_000_000


def test_no_length_in_a_sample_takes_memory_though_its_digest_is_right() -> None:
    made = record(0, points=5)
    good = encode_sample(replace(made, sample=replace(made.sample, id="ball/1")), IDENTITY)[:-32]
    decode_sample(good + hashlib.sha256(good).digest())  # load everything that is cached before memory is measured
    tracemalloc.start()
    refused = []
    for place in range(4, len(good) - 3, 4):
        body = bytearray(good)
        body[place : place + 4] = b"\xff\xff\xff\x7f"
        refused.append(refusal(lambda body=body: decode_sample(bytes(body) + hashlib.sha256(body).digest())))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert sum(text != "" for text in refused) > 20
    assert not any("\n" in text for text in refused)
    assert peak < 2_000_000


@pytest.mark.parametrize("version", [0, 2, "1", None])
def test_a_dataset_of_another_version_is_read_by_nobody(tmp_path: Path, version: object) -> None:
    write_dataset(tmp_path / "ds", 1)
    manifest = tmp_path / "ds" / "manifest.json"
    manifest.write_text(json.dumps({**json.loads(manifest.read_text()), "schema_version": version}, indent=2) + "\n")
    readers: list[Callable[[], object]] = [
        lambda: RecordedDataset(tmp_path / "ds"),
        lambda: describe(tmp_path / "ds"),
        lambda: build_store([tmp_path / "ds"], tmp_path / "store"),
        lambda: RecordingWriter(tmp_path / "ds", IDENTITY),
    ]
    for reader in readers:
        with pytest.raises(FileError, match=r"manifest\.json: schema_version: .* is not 1: "):
            reader()
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["ds"]


@pytest.mark.parametrize(("name", "label"), [("../x", ".."), ("ball/../../x", "ball"), ("/etc/x", "")])
def test_names_that_lead_elsewhere_are_not_exported(tmp_path: Path, name: str, label: str) -> None:
    """A training store from another program may hold any text as an id."""
    made = record(0).sample
    with StoreWriter(tmp_path / "store", {}) as writer:
        writer.write(replace(made, id=name, object=label))
    for kind in ("npz", "vision2tactile"):
        with pytest.raises(DatasetError, match=r"^(id|object): .* is "):
            export_samples(tmp_path / "store", tmp_path / "out" / "here", kind)
    assert [p.name for p in sorted(tmp_path.iterdir())] in (["store"], ["out", "store"])
