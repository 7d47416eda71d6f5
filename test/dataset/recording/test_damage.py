# SPDX-License-Identifier: Apache-2.0
"""Damage of every kind: `verify` finds it, `repair` keeps all intact samples, and neither needs more memory than the file."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from recording_builders import IDENTITY, QUICK, record, write_dataset

from foretouch.dataset.recording import RecordedDataset, RecordingWriter, repair_dataset, verify_dataset
from foretouch.dataset.recording.reader import sample_messages
from foretouch.dataset.recording.records import mapped
from foretouch.dataset.recording.verify import verify_file
from foretouch.errors import FileError

COUNT = 4


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "ds", COUNT, points=10)


def spans(path: Path) -> list[tuple[int, int]]:
    """Start and end of each sample [bytes]."""
    with mapped(path) as data:
        return [(place.start, place.end) for place in sample_messages(path, data)]


def numbers(path: Path) -> list[int]:
    """The numbers of the samples in a file, from their contents."""
    with RecordedDataset(path) as dataset:
        return [int(stored.record.sample.grasp.id.removeprefix("grasp-")) for stored in dataset]


def check_repaired(path: Path, kept: set[int]) -> None:
    original = path.read_bytes()
    report = repair_dataset(path)[0]
    assert report.changed
    assert report.original is not None
    assert report.original.read_bytes() == original
    assert verify_file(path).fault_lines() == []
    assert set(numbers(path)) == kept
    assert report.samples == len(kept)
    assert not repair_dataset(path)[0].changed


def test_a_clean_file_is_left_alone(file: Path) -> None:
    before = file.read_bytes(), file.stat().st_mtime_ns
    assert verify_file(file).clean
    assert not repair_dataset(file)[0].changed
    assert (file.read_bytes(), file.stat().st_mtime_ns) == before
    assert [p.name for p in file.parent.glob("session*")] == [file.name]


def test_every_flipped_bit_is_found_and_costs_at_most_the_sample_it_is_in(file: Path, rng: np.random.Generator) -> None:
    good = file.read_bytes()
    places = spans(file)
    near = {place + step for start, end in places for place in (start, end) for step in range(-50, 20, 7)}
    edges = set(range(0, 60, 5)) | {len(good) - k for k in range(1, 60, 4)}
    for place in sorted(near | edges | set(map(int, rng.integers(0, len(good), 60)))):
        if not 0 <= place < len(good):
            continue
        damaged = bytearray(good)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        report = verify_file(file)
        assert not report.clean, f"byte {place} of {len(good)}"
        assert all(line.startswith(f"{file}: byte ") and "\n" not in line for line in report.fault_lines())
        check_repaired(file, {n for n, (start, end) in enumerate(places) if not start <= place < end})
        for kept in file.parent.glob("*.before-repair*"):
            kept.unlink()


def test_a_cut_anywhere_keeps_all_samples_before_it(file: Path, rng: np.random.Generator) -> None:
    good = file.read_bytes()
    places = spans(file)
    for cut in sorted({0, 3, 8, 20, len(good) - 1, len(good) - 8, *map(int, rng.integers(0, len(good), 40))}):
        file.write_bytes(good[:cut])
        report = verify_file(file)
        assert not report.clean
        assert not report.finished or cut >= len(good) - 8  # the last bytes only say that the file ends
        check_repaired(file, {n for n, (_, end) in enumerate(places) if end <= cut})
        for kept in file.parent.glob("*.before-repair*"):
            kept.unlink()


def test_a_hole_in_the_middle_costs_the_samples_in_it(file: Path) -> None:
    good = bytearray(file.read_bytes())
    places = spans(file)
    start, end = places[1][0] - 200, places[2][0] + 20
    good[start:end] = b"\xff" * (end - start)
    file.write_bytes(good)
    check_repaired(file, {0, 3})


def test_a_piece_taken_out_of_the_middle_is_found(file: Path) -> None:
    good = file.read_bytes()
    places = spans(file)
    file.write_bytes(good[: places[1][0] + 7] + good[places[1][0] + 100 :])
    check_repaired(file, {0, 2, 3})


@pytest.mark.parametrize("length", [0, 1, 2**31, 2**63 - 1, 2**64 - 1])
def test_a_length_that_lies_takes_no_memory(tmp_path: Path, length: int) -> None:
    file = write_dataset(tmp_path / "ds", 2, points=20_000)
    good = file.read_bytes()
    (start, end), _ = spans(file)
    head = start - 31
    data = bytearray(good)
    assert data[head] == 5
    data[head + 1 : head + 9] = struct.pack("<Q", length)
    file.write_bytes(data)
    tracemalloc.start()
    report = verify_file(file)
    repair_dataset(file)[0]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert not report.clean
    assert numbers(file) == [0, 1]
    assert peak < len(good) + 4_000_000  # definitions of messages, and copies of a sample or two
    del end


def test_other_files_are_no_recordings(tmp_path: Path) -> None:
    other = tmp_path / "photo.mcap"
    other.write_bytes(bytes(range(256)) * 40)
    (report,) = verify_dataset(other)
    assert report.fault_lines()[0] == f"{other}: byte 0: is no MCAP file: it does not begin as one"
    with pytest.raises(FileError, match="is no MCAP file, and holds no part of one"):
        repair_dataset(other)
    assert other.read_bytes() == bytes(range(256)) * 40
    with pytest.raises(FileError, match="does not exist"):
        verify_dataset(tmp_path / "nothing")


def test_an_id_in_two_sessions_is_a_fault(tmp_path: Path) -> None:
    first = write_dataset(tmp_path / "ds", 2)
    (tmp_path / "ds" / "session-0002.mcap").write_bytes(first.read_bytes())
    reports = verify_dataset(tmp_path / "ds")
    assert reports[0].clean
    assert any("id ball/000001 is in session-0001.mcap too" in line for line in reports[1].fault_lines())


def test_every_byte_of_the_manifest_counts(file: Path) -> None:
    manifest = file.parent / "manifest.json"
    good = manifest.read_bytes()
    for place in range(len(good)):
        data = bytearray(good)
        data[place] ^= 1
        manifest.write_bytes(data)
        with pytest.raises(FileError):
            verify_dataset(file.parent)


def test_the_original_of_an_earlier_repair_is_kept_too(file: Path) -> None:
    for _ in range(3):
        file.write_bytes(file.read_bytes()[:-30])
        assert repair_dataset(file)[0].changed
    kept = sorted(p.name for p in file.parent.glob("*.before-repair*"))
    assert kept == [f"{file.name}.before-repair", f"{file.name}.before-repair-2", f"{file.name}.before-repair-3"]
    assert numbers(file) == list(range(COUNT))


def test_what_a_crash_left_unwritten_is_booked_as_lost(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "ds", IDENTITY, QUICK)
    writer.config = QUICK.replace(accounts_s=0.1)
    writer._counted_s -= 1.0
    writer.receive("/cloud", 5)  # in a queue when the process dies
    writer.append(record(0))
    writer._file.abandon()
    writer._release.close()
    (report,) = verify_dataset(tmp_path / "ds")
    assert report.fault_lines() == [f"{writer.file}: byte {report.size}: not finished: no index; repair creates one"]
    repair_dataset(tmp_path / "ds")
    (report,) = verify_dataset(tmp_path / "ds")
    assert report.clean
    assert report.counts is not None
    assert report.counts.topics["/cloud"].dropped == {"lost before repair": 5}


def test_no_changed_byte_hides_or_changes_a_sample_in_silence(file: Path, rng: np.random.Generator) -> None:
    original, before = file.read_bytes(), numbers(file)
    for at in rng.choice(len(original), 250, replace=False):
        changed = bytearray(original)
        changed[at] ^= 1 << int(rng.integers(0, 8))
        file.write_bytes(changed)
        try:
            assert numbers(file) == before
            with RecordedDataset(file) as dataset:
                assert not dataset.unfinished or len(original) - at <= 8  # the final magic alone
        except FileError:
            continue


def test_a_renamed_schema_does_not_empty_a_recording(file: Path) -> None:
    content = file.read_bytes()
    name = b"foretouch_msgs/msg/GraspSample"
    at = content.index(name)
    file.write_bytes(content[:at] + b"x" + content[at + 1 :])
    with pytest.raises(FileError, match=rf"samples: damaged: holds 0 samples, its index declares {COUNT}"):
        RecordedDataset(file)
