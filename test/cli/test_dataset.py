# SPDX-License-Identifier: Apache-2.0
"""`foretouch dataset`: JSON output, exit status and one-line errors."""

from pathlib import Path

import pytest
from every_case import every_case
from recording_builders import IDENTITY, MESSAGE, QUICK, TACTILE, TACTILE_TYPE, record, write_dataset

from foretouch.cli.dataset import print_result
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch_lab.learning.data.splits import read_splits


@pytest.fixture
def dataset(tmp_path) -> Path:
    write_dataset(tmp_path / "ds", 8, points=60)
    write_dataset(tmp_path / "ds", 8, points=60, name="sponge", first=8)
    return tmp_path / "ds"


def test_info_tells_counts_and_ranges_and_show_draws_the_samples_that_are_asked_for(call, dataset, tmp_path) -> None:
    answer = call("dataset", "info", dataset, "--json")
    (record,) = answer.records
    assert answer.status == 0
    assert (record["samples"], record["labelled"]) == (16, 16)
    assert record["objects"] == {"ball": 8, "sponge": 8}
    assert record["pairing_ms"] == [16, 0, 0, 0, 0, 0]
    assert set(record["ranges"]) == {"PDC_TH", "PDC_MF", "E_TH", "E_MF"}
    assert "ball 8, sponge 8" in call("dataset", "info", dataset).out
    answer = call("dataset", "show", dataset, "-o", tmp_path / "a.png", "-n", 2, "--json")
    assert answer.records[0]["samples"] == ["ball/000001", "sponge/000009"]
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    call("dataset", "edit", dataset, "--drop", "--id", "sponge/000009")
    answer = call("dataset", "show", dataset, "-o", tmp_path / "a.png", "-n", 2, "--json")
    call("dataset", "edit", dataset, "--undo")
    assert answer.records[0]["dropped"] == ["sponge/000009"]


def test_verify_repair_and_verify_again(call, dataset) -> None:
    assert call("dataset", "verify", dataset).status == 0
    file = dataset / "session-0002.mcap"
    file.write_bytes(file.read_bytes()[:-3000])
    answer = call("dataset", "verify", dataset, "--json")
    assert answer.status == 1
    assert [record["status"] for record in answer.records] == ["ok", "unfinished"]
    assert answer.err.startswith(f"foretouch: {file}: byte ")
    (first, second) = call("dataset", "repair", dataset, "--json").records
    assert (first["changed"], second["changed"]) == (False, True)
    assert Path(second["original"]).exists()
    verified, repaired = call("dataset", "verify", dataset), call("dataset", "repair", dataset)
    assert (verified.status, repaired.out.splitlines()[0]) == (0, "nothing repaired")
    assert not any(record["changed"] for record in call("dataset", "repair", dataset, "--json").records)
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 4
    file.write_bytes(data)
    flipped = call("dataset", "verify", dataset)
    assert flipped.status == 1
    assert all(line.startswith(f"foretouch: {file}: byte ") for line in flipped.err.splitlines())


def test_build_puts_splits_into_a_store_that_can_be_verified(call, dataset, tmp_path) -> None:
    (record,) = call("dataset", "build", dataset, "-o", tmp_path / "store", "--seed", 4, "--json").records
    one, other = (call("predict", path, "--json").records for path in (dataset, tmp_path / "store"))
    assert len(one) == len(other) == 16
    for key in ("sample", "predictions"):  # the same from either
        assert [found[key] for found in one] == [found[key] for found in other]
    assert (record["samples"], record["renumbered"]) == (16, 0)
    assert list(record["splits"]) == ["random", "object", "time", "labels"]
    book, _ = read_splits(tmp_path / "store")
    assert {i for part in book["random"] for i in part["test"]} == {
        f"{name}/{k:06d}" for name, start in (("ball", 1), ("sponge", 9)) for k in range(start, start + 8)
    }
    assert call("dataset", "verify", tmp_path / "store").status == 0
    shard = tmp_path / "store" / "shard-00000.arrow"
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    assert call("dataset", "verify", tmp_path / "store").status == 1
    refused = call("dataset", "repair", tmp_path / "store")
    assert (refused.status, "`foretouch dataset build` writes it anew" in refused.err) == (1, True)
    assert call("dataset", "build", dataset, "-o", tmp_path / "store").status == 1


def test_mistakes_are_one_line(call, dataset, tmp_path) -> None:
    none, edit = tmp_path / "nothing", ("edit", dataset)

    def check(words: tuple[object, ...], line: str) -> None:
        answer = call("dataset", *words)
        answer.check_refused(f"foretouch: {line}\n")
        assert not answer.out

    cases = [
        *(((action, none), f"{none}: does not exist") for action in ("info", "verify", "repair")),
        ((*edit, "--drop"), "--relabel and --drop need --id"),
        ((*edit, "--id", "x"), "--id needs --relabel or --drop"),
    ]
    every_case(cases, check)


def test_a_result_has_no_row_for_what_is_empty(capsys) -> None:
    print_result("imported", {"samples": 0, "notes": (), "left_out": {}, "names": ("a", "b")}, as_json=False)
    words = capsys.readouterr().out
    assert all(text in words for text in ("samples", " 0 ", "a, b"))
    assert not any(text in words for text in ("notes", "left out", "()"))


def test_edits_are_listed_and_undone(call, dataset) -> None:
    (first,) = call("dataset", "edit", dataset, "--relabel", "cup", "--id", "ball/000001", "--json").records
    assert first == {"edit": 1, "edits": ["1: relabel cup (1 samples)"]}
    assert call("dataset", "edit", dataset, "--drop", "--id", "cup/000001").status == 0
    assert call("dataset", "edit", dataset, "--merge", "sponge", "cup").status == 0
    (record,) = call("dataset", "info", dataset, "--json").records
    assert (record["objects"], record["discarded"], len(record["edits"])) == ({"cup": 9, "ball": 7}, 1, 3)
    assert call("dataset", "edit", dataset, "--undo", "--json").records[0]["undone"] == 3
    assert "relabel cup (8 samples) (undone)" in call("dataset", "edit", dataset).out
    assert call("dataset", "verify", dataset).status == 0


def test_info_and_verify_tell_what_was_received_written_dropped_and_lost(call, tmp_path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        writer.receive(TACTILE, 4)
        writer.write(TACTILE, MESSAGE, 0)
        writer.drop(TACTILE, "queue full", 3)
        writer.lose(TACTILE, 2)
        writer.append(record())
    write_dataset(tmp_path / "ds", 1)
    (info,) = call("dataset", "info", tmp_path / "ds", "--json").records
    assert info["accounts"][TACTILE] == {"received": 6, "written": 3, "dropped": {"queue full": 3}, "lost": 2}
    verified = call("dataset", "verify", tmp_path / "ds", "--json").records
    assert [one["lost"] for one in verified] == [{TACTILE: 2}, {}]
    assert [one["dropped"] for one in verified] == [{TACTILE: {"queue full": 3}}, {}]
    assert "received 6; written 3; dropped queue full 3; lost 2" in call("dataset", "info", tmp_path / "ds").out
