# SPDX-License-Identifier: Apache-2.0
"""Edits change the samples that are read but never the recordings, and can be undone."""

import resource
from collections.abc import Callable
from pathlib import Path

import pytest
from every_case import every_case
from recording_builders import IDENTITY, QUICK, ids, write_dataset

from foretouch.dataset.formats import open_samples
from foretouch.dataset.importing import import_samples
from foretouch.dataset.recordings.editing import drop, merge, relabel, undo
from foretouch.dataset.recordings.edits import Edit, append_edit, read_edits
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.repair import repair_dataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.samples import describe
from foretouch.errors import DatasetError, FileError
from foretouch_lab.dataset.store_writer import build_store


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    write_dataset(tmp_path / "ds", 3)
    write_dataset(tmp_path / "ds", 2, name="cans", first=3)
    return tmp_path / "ds"


def test_edits_are_seen_by_whoever_reads_and_the_recordings_stay_as_they_are(dataset: Path, tmp_path: Path) -> None:
    before = {file: file.read_bytes() for file in dataset.glob("session-*.mcap")}
    assert relabel(dataset, ["ball/000001"], "cup") == 1
    assert drop(dataset, ["cup/000001", "ball/000003"]) == 2  # by the ids that they have now
    assert merge(dataset, "cans", "cup") == 3
    assert ids(dataset) == ["cup/000001", "ball/000002", "ball/000003", "cup/000004", "cup/000005"]
    info = describe(open_samples(dataset, unfinished=True))
    assert (info["objects"], info["discarded"]) == ({"cup": 3, "ball": 2}, 2)
    assert info["edits"] == ["1: relabel cup (1 samples)", "2: drop (2 samples)", "3: relabel cup (2 samples)"]
    result = build_store([dataset], tmp_path / "store")
    assert [sample.id for sample in result.samples] == ["ball/000002", "cup/000004", "cup/000005"]
    assert import_samples(dataset, tmp_path / "copy").samples == 5
    assert ids(tmp_path / "copy") == ids(dataset)
    assert {file: file.read_bytes() for file in before} == before
    assert all(report.clean for report in verify_dataset(dataset))


def test_undo_takes_back_one_edit_after_the_other(dataset: Path) -> None:
    recorded = ids(dataset)
    relabel(dataset, recorded[:2], "cup")
    edited = ids(dataset)
    drop(dataset, ["cup/000001"])
    assert undo(dataset) == 2
    assert (ids(dataset), describe(open_samples(dataset, unfinished=True))["discarded"]) == (edited, 0)
    assert undo(dataset) == 1
    assert ids(dataset) == recorded
    with pytest.raises(DatasetError, match="holds no edit to undo"):
        undo(dataset)
    assert describe(open_samples(dataset, unfinished=True))["edits"][0] == "1: relabel cup (2 samples) (undone)"


def test_names_that_leave_a_folder_are_absent_taken_or_being_written_are_refused(dataset: Path, tmp_path: Path) -> None:
    def check(message: str, action: Callable[..., object], *arguments: object) -> None:
        with pytest.raises((DatasetError, FileError), match=message):
            action(dataset, *arguments)

    for label in ("..", "a/b", "", "x\n"):
        check("is not a plain name", relabel, ["ball/000001"], label)
        check("is not a plain name", merge, "ball", label)
    check("there is no sample ball/9, cup/1", drop, ["ball/9", "ball/000001", "cup/1"])
    check("holds no sample of 'cup'", merge, "cup", "ball")
    assert not (dataset / "edits.jsonl").exists()
    write_dataset(tmp_path / "other", 1, name="cup")
    import_samples(tmp_path / "other", dataset)
    assert ids(dataset)[-1] == "cup/000001"
    check("id ball/000001 is taken", relabel, ["cup/000001"], "ball")
    check("id ball/000001 is taken", merge, "cup", "ball")
    with RecordingWriter(dataset, IDENTITY, QUICK):
        check("is writing this dataset", undo)
    with pytest.raises(FileError, match="does not exist"):
        undo(dataset / "nothing")


def test_flipped_bits_of_the_log_are_found_and_an_edit_that_was_cut_off_does_not_count(dataset: Path, rng) -> None:
    relabel(dataset, ["ball/000001"], "cup")
    edited, log, manifest = ids(dataset), dataset / "edits.jsonl", dataset / "manifest.json"
    stated = manifest.read_bytes()  # by a crash in the second edit
    drop(dataset, ["cup/000001"])
    good = log.read_bytes()
    for place in {*range(0, len(good), 3), good.index(b"\n"), len(good) - 1}:
        damaged = bytearray(good)
        damaged[place] ^= 1 << int(rng.integers(7))
        log.write_bytes(damaged)
        with pytest.raises(FileError, match=r"edits\.jsonl: (line [12]|byte \d+): "):
            verify_dataset(dataset)
    manifest.write_bytes(stated)
    for cut in range(good.index(b"\n") + 1, len(good)):
        log.write_bytes(good[:cut])
        assert (ids(dataset), describe(open_samples(dataset, unfinished=True))["discarded"]) == (edited, 0)
    assert drop(dataset, ["cup/000001"]) == 2
    assert log.read_bytes() == good


def test_edits_of_a_session_set_outcomes_and_notes_and_an_object_that_is_undone_renames_the_grasps_since(
    dataset: Path,
) -> None:
    first, second = ids(dataset)[:2]
    with RecordingWriter(dataset, IDENTITY, QUICK) as writer:
        for edit in (
            Edit(action="outcome", ids=(first,), text="failure"),
            Edit(action="note", ids=(first,), text="slipped", stamp_ns=7),
            Edit(action="note", text="the light was moved"),
            Edit(action="object", object="cup"),
            Edit(action="pause"),
            Edit(action="undo", edit=4, ids=(second,), object="bowl"),
            Edit(action="outcome", ids=(second,), text="success"),
        ):
            writer.edit(edit)
    one, two = (RecordedDataset(dataset)[k] for k in range(2))
    assert (one.outcome, one.note) == ("failure", "a note; slipped")
    assert (two.id, two.object, two.outcome) == ("bowl/000002", "bowl", "success")
    described = describe(open_samples(dataset, unfinished=True))
    assert described["outcomes"]["failure"] == 1
    assert described["edits"] == [
        "1: outcome failure (1 samples)",
        "2: note slipped (1 samples)",
        "3: note the light was moved",
        "4: object cup (undone)",
        "5: pause",
        "6: undo 4",
        "7: outcome success (1 samples)",
    ]
    assert undo(dataset) == 7
    assert undo(dataset) == 2  # what changes no sample is not an edit to undo later
    assert RecordedDataset(dataset)[0].note == "a note"
    append_edit(dataset, Edit(action="outcome", ids=(first,), text="perhaps"))
    with pytest.raises(FileError, match="text: 'perhaps' is not one of unknown, success, failure"):
        read_edits(dataset)


def test_an_edit_that_does_not_fit_on_the_disk_is_not_in_force_and_the_next_one_is(dataset: Path) -> None:
    drop(dataset, ["ball/000001"])
    before, log = ids(dataset), dataset / "edits.jsonl"
    good, limits = log.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    for cut in (1, 2500, 5000):
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(good) + cut, limits[1]))
        try:
            with pytest.raises(FileError, match=r"edits\.jsonl.*: (No space left|File too large)"):
                append_edit(dataset, Edit(action="note", ids=("ball/000002",), text="x" * 5000))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert (log.read_bytes(), ids(dataset)) == (good, before)
    assert relabel(dataset, ["ball/000002"], "cup") == 2
    assert "cup/000002" in ids(dataset)


def test_a_log_that_was_emptied_cut_replaced_or_removed_is_refused_and_given_up_by_a_repair(
    dataset: Path, tmp_path: Path
) -> None:
    relabel(dataset, ["ball/000001"], "cup")
    drop(dataset, ["cup/000001"])
    log, manifest = dataset / "edits.jsonl", dataset / "manifest.json"
    good, stated = log.read_bytes(), manifest.read_bytes()
    write_dataset(tmp_path / "other", 2)
    drop(tmp_path / "other", ["ball/000002"])
    drop(tmp_path / "other", ["ball/000001"])
    contents = {
        "emptied": b"", "of zeros": bytes(len(good)), "cut": good[: good.index(b"\n") + 1],
        "of another dataset": (tmp_path / "other" / "edits.jsonl").read_bytes(), "removed": None,
    }  # fmt: skip

    def check(content: bytes | None) -> None:
        manifest.write_bytes(stated)
        log.unlink(missing_ok=True)
        if content is not None:
            log.write_bytes(content)
        for read in (verify_dataset, RecordedDataset, undo):
            with pytest.raises(
                FileError, match=r"edits\.jsonl: holds \d edits, not the 2 that the manifest states: restore it, or "
            ):
                read(dataset)
        report = repair_dataset(dataset)[-1]
        assert (report.path, report.changed, report.original is None) == (log, True, content is None)
        assert [one.clean for one in verify_dataset(dataset)] == [True, True]
        assert "ball/000001" in ids(dataset)

    every_case({name: (content,) for name, content in contents.items()}, check)
    manifest.write_bytes(stated)
    log.write_bytes(good + b'{"action": "und')  # a crash in the third
    assert [edit.action for edit in read_edits(dataset).edits] == ["relabel", "drop"]


def test_a_session_that_is_gone_or_of_another_dataset_is_found_and_no_longer_listed_after_a_repair(
    tmp_path: Path,
) -> None:
    path = tmp_path / "ds"
    files = [write_dataset(path, 2, first=k) for k in (0, 2, 4)]
    other = write_dataset(tmp_path / "other", 2, first=2).read_bytes()
    good = files[1].read_bytes()
    files[1].write_bytes(other)
    fault = f"{files[1]}: byte 0: is another recording than the manifest lists under this name"
    assert fault in verify_dataset(path)[1].fault_lines()
    files[1].unlink()
    assert verify_dataset(path)[-1].fault_lines() == [f"{files[1]}: byte 0: is absent, though the manifest lists it"]
    with pytest.raises(
        FileError, match=r"manifest\.json: sessions: session-0002\.mcap is absent: restore it, or take it off"
    ):
        RecordedDataset(path)
    files[1].write_bytes(good)
    assert all(report.clean for report in verify_dataset(path))
    assert len(RecordedDataset(path)) == 6
    files[1].unlink()
    assert [report.path for report in repair_dataset(path) if report.changed] == [files[1]]
    assert [report.path for report in verify_dataset(path) if report.clean] == [files[0], files[2]]
    assert len(RecordedDataset(path)) == 4
