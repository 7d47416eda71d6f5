# SPDX-License-Identifier: Apache-2.0
"""Damage of every kind: readers give the truth or one line, `verify` finds it, `repair` keeps all intact samples.

None of them needs more memory than the file.
"""

import hashlib
import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from recording_builders import IDENTITY, QUICK, TACTILE, assert_same_sample, record, write_dataset

from foretouch.dataset.formats import open_samples
from foretouch.dataset.recordings.editing import drop
from foretouch.dataset.recordings.mcap import _IN_DATA
from foretouch.dataset.recordings.reader import RecordedDataset, samples_in
from foretouch.dataset.recordings.records import RecordingFile
from foretouch.dataset.recordings.repair import RepairReport, repair_dataset
from foretouch.dataset.recordings.sample_codec import decode_sample, encode_sample
from foretouch.dataset.recordings.verify import FileReport, verify_dataset
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.samples import describe
from foretouch.errors import FileError, ForetouchError

COUNT = 4


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "ds", COUNT, points=10)


def spans(path: Path) -> list[tuple[int, int]]:
    """Start and end of each sample [bytes]."""
    return [(one.start, one.end) for one in samples_in(RecordingFile(path))]


def chunks(path: Path) -> list[tuple[int, int]]:
    """Start and end of the chunk of each sample [bytes]."""
    found = records(path)
    return [next((one.offset, one.end) for one in found if one.offset < start < one.end) for start, _ in spans(path)]


def records(path: Path) -> list[Any]:
    file = RecordingFile(path)
    return [one for one in file._records(file.data, 8, len(file.data), _IN_DATA) if hasattr(one, "opcode")]


def numbers(path: Path) -> list[int]:
    """The numbers of the samples in a file, each of which equals the recorded one."""
    found = []
    for sample in RecordedDataset(path):
        found.append(int(sample.grasp.id.removeprefix("grasp-")))
        points = sample.cloud.size
        assert_same_sample(sample, record(found[-1], points=points))
    return found


def refusal(action: Callable[[], object]) -> str:
    """The one-line error of an action; "" if it succeeds."""
    text = ""
    try:
        action()
    except ForetouchError as err:
        text = str(err)
    assert "\n" not in text
    return text


def verify(path: Path) -> FileReport:
    (report,) = verify_dataset(path)
    assert all(line.startswith(f"{path}: byte ") and "\n" not in line for line in report.fault_lines())
    return report


def repair(path: Path) -> RepairReport:
    (report,) = repair_dataset(path)
    return report


def _described(path: Path) -> object:
    return describe(open_samples(path, unfinished=True))


def check_repaired(path: Path, kept: Iterable[int]) -> None:
    original = path.read_bytes()
    report = repair(path)
    assert report.changed
    assert report.original.read_bytes() == original
    assert verify(path).clean
    assert set(numbers(path)) == set(kept)
    assert report.samples == len(set(kept))
    assert not repair(path).changed
    report.original.unlink()


def test_a_clean_file_and_a_sample_of_another_version_are_left_alone_and_originals_kept(file: Path) -> None:
    before = file.read_bytes(), file.stat().st_mtime_ns
    assert verify(file).clean
    assert not repair(file).changed
    assert (file.read_bytes(), file.stat().st_mtime_ns) == before
    assert [p.name for p in file.parent.glob("session*")] == [file.name]
    for _ in range(3):
        file.write_bytes(file.read_bytes()[:-30])
        assert repair(file).changed
    kept = sorted(p.name for p in file.parent.glob("*.before-repair*"))
    assert kept == [f"{file.name}.before-repair", f"{file.name}.before-repair-2", f"{file.name}.before-repair-3"]
    assert numbers(file) == list(range(COUNT))
    good, (start, end) = file.read_bytes(), spans(file)[-1]
    body = bytearray(good[start : end - 32])
    place = 4 + 12 + len("camera") + 1
    body[place + place % 2] = 9
    changed = bytearray(good[:start] + body + hashlib.sha256(body).digest() + good[end:])
    first, last = chunks(file)[-1]
    first += 49  # the head of the chunk, whose checksum is 16 bytes before its end
    changed[first - 16 : first - 12] = zlib.crc32(changed[first:last]).to_bytes(4, "little")
    file.write_bytes(changed)
    with pytest.raises(FileError, match=r"schema_version: 9 is not 3: it was written by a newer foretouch"):
        repair(file)
    assert file.read_bytes() == changed


@pytest.mark.slow
def test_every_flipped_bit_is_found_and_costs_at_most_the_sample_in_whose_chunk_it_is(
    file: Path, rng: np.random.Generator
) -> None:
    good, all_numbers = file.read_bytes(), list(range(COUNT))
    ends = chunks(file)
    near = {place + step for start, end in ends for place in (start, end) for step in range(-50, 20, 14)}
    edges = set(range(0, 60, 7)) | {len(good) - k for k in range(1, 60, 6)}
    places = [place for place in near | edges | set(map(int, rng.integers(0, len(good), 30))) if place < len(good)]
    cases = [(place, 1 << int(rng.integers(8))) for place in sorted(places)]
    # Another kind of record, and lengths that reach into records behind.
    cases += [(one.offset + k, bit) for one in records(file) for k, bit in ((0, 8), (2, 32), (3, 1)) if one.offset > 8]

    def check(place: int, bit: int) -> None:
        damaged = bytearray(good)
        damaged[place] ^= bit
        file.write_bytes(damaged)
        found: list[int] = []
        told = refusal(lambda: found.extend(numbers(file)))
        assert told.startswith(str(file)) or (not told and found == all_numbers)
        assert not verify(file).clean
        times = range(9, 25)  # of the head of a chunk: no sample depends on them
        hit = {n for n, (start, end) in enumerate(ends) if start <= place < end and place - start not in times}
        check_repaired(file, set(all_numbers) - hit)

    every_case(cases, check)


def test_a_cut_anywhere_keeps_all_samples_before_it(file: Path, rng: np.random.Generator) -> None:
    good, ends = file.read_bytes(), spans(file)
    magic = len(good) - 8  # the last bytes only show that the file ends

    def check(cut: int) -> None:
        file.write_bytes(good[:cut])
        assert refusal(lambda: numbers(file)) == "" or cut < 9
        assert not verify(file).finished
        check_repaired(file, {n for n, (_, end) in enumerate(ends) if end <= cut})

    head = chunks(file)[2][0]  # of a chunk
    cuts = {0, 3, 8, 9, 20, 40, len(good) - 1, magic, *range(head, head + 60, 3), *map(int, rng.integers(0, magic, 30))}
    every_case(sorted(cuts), check)


def test_holes_and_pieces_taken_out_cost_the_samples_in_them(file: Path) -> None:
    good, ends = file.read_bytes(), spans(file)
    start, end = ends[1][0] - 200, ends[2][0] + 20
    file.write_bytes(good[:start] + b"\xff" * (end - start) + good[end:])
    check_repaired(file, {0, 3})
    file.write_bytes(good[: ends[1][0] + 7] + good[ends[1][0] + 100 :])
    check_repaired(file, {0, 2, 3})
    name = b"foretouch_msgs/msg/GraspSample"
    file.write_bytes(good.replace(name, b"x" + name[1:], 1))
    with pytest.raises(FileError, match=r"byte \d+: damaged: a chunk that does not match its checksum"):
        RecordedDataset(file)
    check_repaired(file, range(COUNT))
    changed = bytearray(good)  # in the declaring chunk; a finished file repeats its topics in the summary
    changed[good.index(b"foretouch_msgs/msg/BiotacAll")] ^= 1
    file.write_bytes(changed)
    assert repair(file).changed
    assert verify(file).messages == {"/foretouch/samples": COUNT, TACTILE: 2 * (COUNT - 1)}


def test_no_length_of_a_record_takes_memory(tmp_path: Path) -> None:
    file = write_dataset(tmp_path / "ds", 2, points=5_000)
    good = file.read_bytes()
    places = [one.offset for one in records(file)]
    places.append(spans(file)[0][0] - 31)  # the message of the first sample
    assert good[places[-1]] == 5

    def check(length: int, place: int) -> None:
        damaged = bytearray(good)
        damaged[place + 1 : place + 9] = struct.pack("<Q", length)
        file.write_bytes(damaged)
        tracemalloc.start()
        for reader in (RecordedDataset, _described, verify):
            refusal(lambda reader=reader: reader(file))  # type: ignore[misc]
        assert place != places[-1] or (repair(file).changed and numbers(file) == [0, 1])
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < len(good) + 4_000_000  # definitions of messages, and copies of a sample or two

    every_case([(length, place) for length in (0, 1, 2**31, 2**63 - 1, 2**64 - 1) for place in places[::3]], check)


def test_no_length_in_a_sample_takes_memory_though_its_digest_is_right() -> None:
    made = record(0, points=5)
    good = encode_sample(replace(made, id="ball/1"), IDENTITY)[:-32]
    decode_sample(good + hashlib.sha256(good).digest())  # load everything that is cached before memory is measured
    tracemalloc.start()
    refused = []
    for place in range(4, len(good) - 3, 12):
        body = bytearray(good)
        body[place : place + 4] = b"\xff\xff\xff\x7f"
        refused.append(refusal(lambda body=body: decode_sample(bytes(body) + hashlib.sha256(body).digest())))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert sum(text != "" for text in refused) > 10
    assert peak < 2_000_000


def test_continuing_after_damage_overwrites_nothing_and_gives_no_id_twice(file: Path, rng: np.random.Generator) -> None:
    """`repair` saves the samples after damage, so their ids are taken."""
    good, ends = file.read_bytes(), [end for _, end in spans(file)]

    def check(_: str, damaged: bytes, must_continue: bool) -> None:
        file.write_bytes(damaged)

        def resume() -> None:
            with RecordingWriter(file.parent, IDENTITY, QUICK) as writer:
                writer.append(record(COUNT))

        assert not (refusal(resume) and must_continue)
        assert file.read_bytes() == damaged
        repair_dataset(file.parent)
        assert [report.fault_lines() for report in verify_dataset(file.parent) if not report.clean] == []
        for other in set(file.parent.glob("session-*")) - {file}:
            other.unlink()

    cases = [(f"cut {cut}", good[:cut], True) for cut in (ends[-1], ends[-1] + 5, ends[-2], len(good) - 40)]
    for place in map(int, rng.integers(0, len(good), 25)):
        damaged = bytearray(good)
        damaged[place] ^= 1 << int(rng.integers(8))
        cases.append((f"flip {place}", bytes(damaged), False))
    every_case(cases, check)


def test_other_files_are_no_recordings(tmp_path: Path) -> None:
    other = tmp_path / "photo.mcap"
    other.write_bytes(bytes(range(256)) * 40)
    assert verify(other).fault_lines()[0] == f"{other}: byte 0: is not an MCAP file: it does not begin as one"
    with pytest.raises(FileError, match="is not an MCAP file, and holds no part of one"):
        repair_dataset(other)
    assert other.read_bytes() == bytes(range(256)) * 40
    with pytest.raises(FileError, match="does not exist"):
        verify_dataset(tmp_path / "nothing")


def test_an_id_in_two_sessions_and_any_changed_byte_of_the_manifest_are_found(file: Path) -> None:
    second = file.with_name("session-0002.mcap")
    second.write_bytes(file.read_bytes())
    reports = verify_dataset(file.parent)
    assert reports[0].clean
    assert any("id ball/000001 is in session-0001.mcap too" in line for line in reports[1].fault_lines())
    manifest = file.parent / "manifest.json"
    good = manifest.read_bytes()
    for place in range(len(good)):
        manifest.write_bytes(good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :])
        with pytest.raises(FileError):
            verify_dataset(file.parent)


def test_what_a_crash_left_unwritten_is_counted_as_lost(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "ds", IDENTITY, QUICK)
    writer._counted_s -= 10.0
    writer.receive("/cloud", 5)  # in a queue when the process is killed
    writer.append(record(0))
    writer.output.abandon()
    writer._release.close()
    report = verify(writer.file)
    assert report.fault_lines() == [f"{writer.file}: byte {report.size}: not finished: no index; repair creates one"]
    assert repair(writer.file).changed
    report = verify(writer.file)
    assert report.clean
    assert report.counts.topics["/cloud"].dropped == {"lost before repair": 5}


def test_a_damaged_log_of_edits_is_named_and_renamed_by_a_repair(file: Path) -> None:
    drop(file.parent, ["ball/000001"])
    log = file.parent / "edits.jsonl"
    log.write_bytes(bytes([log.read_bytes()[0] ^ 1]) + log.read_bytes()[1:])
    for read in (verify_dataset, RecordedDataset):
        assert refusal(lambda read=read: read(file.parent)).startswith(f"{log}: line 1: ")  # type: ignore[misc]
    reports = repair_dataset(file.parent)
    assert [report.changed for report in reports] == [False, True]
    assert reports[1].original == log.with_name("edits.jsonl.before-repair")
    assert len(RecordedDataset(file.parent)) == COUNT
