# SPDX-License-Identifier: Apache-2.0
"""Import, build and export of recorded datasets preserve every number."""

import shutil
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from counted_work import calls_at_most
from every_case import every_case
from recording_builders import IDENTITY, QUICK, assert_same_sample, read_folder, record, write_dataset

from foretouch.dataset.formats import export_samples, exported_formats, open_samples
from foretouch.dataset.importing import import_samples
from foretouch.dataset.recordings.sample_codec import encode_sample
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.samples import describe
from foretouch.dataset.source import open_source
from foretouch.dataset.store import Store, content_sha256
from foretouch.errors import DatasetError, FileError
from foretouch.types import DISCARDED, Sample
from foretouch_lab.dataset.store_writer import StoreWriter, build_store

NS = 1_000_000_000


def records(path: Path) -> list[Sample]:
    return list(open_samples(path).with_discarded())


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Three labelled samples of a ball, one unlabelled of a sponge."""
    write_dataset(tmp_path / "ds", 3)
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.append(record(3, "sponge", labelled=False))
    return tmp_path / "ds"


def test_a_store_holds_what_was_recorded(dataset: Path, tmp_path: Path) -> None:
    result = build_store([dataset], tmp_path / "store", attach=lambda samples: {"note.txt": f"{len(samples)}\n"})
    store = Store(tmp_path / "store")
    assert content_sha256(store) == store.sha256
    assert store.sha256 == result.sha256
    for stored, made in zip(store, records(dataset), strict=True):
        assert stored.id == made.id
        assert_same_sample(stored, made)
    assert [(f.id, f.object, f.labelled) for f in result.samples][-1] == ("sponge/000004", "sponge", False)
    assert store.manifest["about"]["hand"] == IDENTITY.hand
    assert (tmp_path / "store" / "note.txt").read_text() == "4\n"
    assert build_store([dataset], tmp_path / "again").sha256 == result.sha256
    assert build_store([tmp_path / "store"], tmp_path / "of a store").sha256 == result.sha256
    for path in (dataset, tmp_path / "store"):
        assert (open_source(path).kind, len(list(open_source(path)))) == ("samples", 4)


def test_nothing_is_built_from_an_unfinished_or_damaged_recording(dataset: Path, tmp_path: Path) -> None:
    first, second = sorted(dataset.glob("*.mcap"))
    good = first.read_bytes()
    half = len(good) // 2
    first.write_bytes(good[:half] + bytes([good[half] ^ 1]) + good[half + 1 :])
    with pytest.raises(FileError, match=r"session-0001\.mcap: (sample at )?byte \d+"):
        build_store([dataset], tmp_path / "store")
    first.write_bytes(good)
    second.write_bytes(second.read_bytes()[:-100])
    assert describe(open_samples(dataset, unfinished=True))["unfinished"] == ["session-0002.mcap"]
    with pytest.raises(FileError, match=r"session-0002\.mcap: is not finished: run `foretouch dataset repair`"):
        build_store([dataset], tmp_path / "store")
    assert [p.name for p in tmp_path.iterdir()] == ["ds"]


def test_sessions_of_one_object_in_several_datasets_are_numbered_on(tmp_path: Path) -> None:
    for name, count, first in (("monday", 2, 0), ("tuesday", 3, 2), ("friday", 1, 5)):
        write_dataset(tmp_path / name, count, first=first)
    days = [tmp_path / name for name in ("monday", "tuesday", "friday")]
    result = build_store(days, tmp_path / "store")
    store = Store(tmp_path / "store")
    assert [sample.id for sample in store] == [f"ball/{number:06d}" for number in range(1, 7)]
    for stored, made in zip(store, [one for day in days for one in records(day)], strict=True):
        assert_same_sample(stored, replace(made, id=stored.id))
    assert result.renumbered == 4
    assert [source.get("renumbered") for source in store.manifest["about"]["sources"]] == [
        None,
        {"ball/000001": "ball/000003", "ball/000002": "ball/000004", "ball/000003": "ball/000005"},
        {"ball/000001": "ball/000006"},
    ]
    again = build_store([tmp_path / "monday", tmp_path / "friday"], tmp_path / "other")
    assert [facts.id for facts in again.samples] == [f"ball/{number:06d}" for number in (1, 2, 3)]


def test_a_sample_that_two_sources_hold_is_refused(dataset: Path, tmp_path: Path) -> None:
    write_dataset(tmp_path / "later", 2, first=7)
    build_store([tmp_path / "later", dataset], tmp_path / "both")
    for sources, id_in_last, holder in (
        ([dataset, dataset], "ball/000001", dataset),
        ([dataset, tmp_path / "later", tmp_path / "both"], "ball/000001", tmp_path / "later"),
    ):
        with pytest.raises(DatasetError) as refusal:
            build_store(sources, tmp_path / "store")
        assert str(refusal.value) == f"{sources[-1]}: {id_in_last}: is in {holder} too; build from one of both"
    assert not (tmp_path / "store").exists()


def test_info_counts_and_discarded_samples_are_left_out(dataset: Path, tmp_path: Path) -> None:
    with RecordingWriter(dataset, IDENTITY, QUICK) as writer:
        writer.append(replace(record(1), flags=(DISCARDED,)))
    info = describe(open_samples(dataset, unfinished=True))
    assert (info["kind"], info["samples"], info["labelled"], info["tared"], info["discarded"]) == (
        "recording",
        5,
        4,
        4,
        1,
    )
    assert info["objects"] == {"ball": 4, "sponge": 1}
    assert info["outcomes"] == {"success": 4, "unknown": 1}
    assert info["flags"] == {"arrival_stamped": 3, DISCARDED: 1}
    assert info["pairing_ms"] == [4, 0, 0, 0, 0, 0]
    assert info["points"] == (30, 30, 30)
    vectors = [r.touch.values for r in records(dataset) if r.touch is not None]
    assert info["ranges"]["E_MF"] == (min(v[26:].min() for v in vectors), max(v[26:].max() for v in vectors))
    assert (info["first_ns"], info["last_ns"]) == (1_700_000_001 * NS, 1_700_000_022 * NS)
    result = build_store([dataset], tmp_path / "store")
    assert [f.id for f in result.samples] == ["ball/000001", "ball/000002", "ball/000003", "sponge/000004"]
    assert result.left_out == {DISCARDED: 1}


def test_every_export_imported_again_is_equal(dataset: Path, tmp_path: Path) -> None:
    """All of every record, or of folders of vision2tactile what these can hold."""

    def check(kind: str) -> None:
        export_samples(dataset, tmp_path / kind, kind)
        import_samples(tmp_path / kind, tmp_path / f"{kind} again")
        again = records(tmp_path / f"{kind} again")
        if kind != "vision2tactile":
            assert open_samples(tmp_path / f"{kind} again").identity == IDENTITY
            same = [encode_sample(one, IDENTITY) for one in records(dataset)]
            assert [encode_sample(one, IDENTITY) for one in again] == same
            return
        for made, back in zip(map(record, range(3)), again, strict=True):
            for part in ("cloud.xyz", "cloud.rgb", "grasp.g1", "grasp.g2"):
                np.testing.assert_array_equal(attrgetter(part)(back), attrgetter(part)(made))
            np.testing.assert_array_equal(back.touch.values, made.touch.values)
            assert back.extra["TDC_TH"] == 2100.5

    every_case(exported_formats(), check)


def test_archives_that_are_no_samples_are_refused_by_file_and_field(dataset: Path, tmp_path: Path) -> None:
    export_samples(dataset, tmp_path / "good", "npz")
    with np.load(tmp_path / "good/ball/000001.npz") as archive:
        good = dict(archive)

    def check(rule: str, changes: dict[str, Any]) -> None:
        folder = tmp_path / str(abs(hash(rule)))
        (folder / "ball").mkdir(parents=True)
        arrays = {name: value for name, value in (good | changes).items() if value is not None}
        np.savez(folder / "ball" / "000001.npz", **arrays)
        with pytest.raises(FileError, match=rule):
            open_samples(folder).read(0)

    assert len(open_samples(tmp_path / "good")) == 4
    every_case(
        [
            ("is not a dataset", {"g1": None}),
            (r"000001\.npz: rotation: is missing; there are: .*id, object", {"rotation": None}),
            ("id: 'cup/000001' is not 'ball', a slash and a name", {"id": "cup/000001"}),
            ("outcome: 'maybe' is not one of unknown, success, failure", {"outcome": "maybe"}),
            (r"touch: shape \(3,\) is not \(50,\)", {"touch": np.zeros(3)}),
            ("is not a sample: .*JSON|is not a sample: Expecting", {"hand": "{"}),
            ("is not a sample: zip", {"extra_names": np.array(["a"])}),
        ],
        check,
    )
    with np.load(tmp_path / "good/ball/000002.npz") as archive:
        np.savez(tmp_path / "good/ball/000002.npz", **{**archive, "hand": '{"name": "other"}'})
    with pytest.raises(FileError, match=r"000002\.npz: is of another hand, camera or sensor than .*000001\.npz"):
        import_samples(tmp_path / "good", tmp_path / "new")


def test_nothing_is_overwritten_and_names_that_lead_elsewhere_are_not_exported(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(FileError, match="exists already"):
        export_samples(dataset, tmp_path / "out", "npz")
    with pytest.raises(FileError, match="exists already"):
        build_store([dataset], tmp_path / "out")
    before = sorted(tmp_path.rglob("*"))
    for name, label in (("../x", ".."), ("ball/../../x", "ball"), ("/etc/x", "")):  # of a store of another program
        with StoreWriter(tmp_path / "store") as writer:
            writer.write(replace(record(0), id=name, object=label))
        for kind in ("npz", "vision2tactile"):
            with pytest.raises(DatasetError, match=r"^(id|object): .* is "):
                export_samples(tmp_path / "store", tmp_path / "out" / "here", kind)
        shutil.rmtree(tmp_path / "store")
    assert sorted(tmp_path.rglob("*")) == before


def test_an_import_of_another_hand_taken_ids_or_damaged_files_leaves_nothing(dataset: Path, tmp_path: Path) -> None:
    build_store([dataset], tmp_path / "store")
    other = replace(IDENTITY, hand={"name": "other"})
    with pytest.raises(FileError, match=r"hand\.name: shadow-rh there, other here"):
        import_samples(tmp_path / "store", dataset, identity=other)
    with pytest.raises(DatasetError, match="is taken"):
        import_samples(tmp_path / "store", dataset)
    export_samples(dataset, tmp_path / "folders", "vision2tactile")
    next((tmp_path / "folders").rglob("tactile.tac")).write_text("nonsense")
    with pytest.raises(FileError, match=r"tactile\.tac"):
        import_samples(tmp_path / "folders", tmp_path / "new")
    with pytest.raises(FileError, match="does not exist"):
        import_samples(tmp_path / "nothing", tmp_path / "new")
    assert not list(tmp_path.glob("*new*"))


@pytest.mark.real_data
def test_real_grasps_are_imported_with_little_work_and_exported_equal(real_data: Path, tmp_path: Path) -> None:
    source = real_data / "vision2tactile" / "rugby"
    with calls_at_most(1_500_000):
        result = import_samples(source, tmp_path / "ds")
    assert (result.samples, result.labelled) == (50, 50)
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "ds")] == [[]]
    exported_result = export_samples(tmp_path / "ds", tmp_path / "out", "vision2tactile")
    assert (exported_result.samples, sum(exported_result.lost.values())) == (50, 0)
    for back, made in zip(read_folder(tmp_path / "out"), read_folder(source), strict=True):
        assert back.id == made.id
        assert_same_sample(back, made)
