# SPDX-License-Identifier: Apache-2.0
"""Files that are consistent and wrong: nothing is overwritten, nothing hangs, and each is refused by name."""

import fcntl
import os
import stat
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case, every_refusal
from recording_builders import write_dataset

from foretouch.cli.output import print_table, warn
from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.config import dump_yaml, load_yaml, parse_overrides
from foretouch.dataset.editing import drop
from foretouch.dataset.recording.repair import repair_dataset
from foretouch.errors import ConfigError, FileError, ForetouchError
from foretouch.files import FileBytes, read_bytes, replace_files, require_schema, require_writable
from foretouch.models.history_keeper import HistoryFile
from foretouch.report.panels import new_figure, save_small
from foretouch.report.rerun_view import write_view
from foretouch.ros.runtime.environment import stale_bytes
from foretouch.types import Cloud
from foretouch_lab.experiments.framework.manifest import open_folder, write_manifest


def test_nothing_is_written_through_links_and_second_names_of_other_files(tmp_path: Path) -> None:
    victim, dataset = tmp_path / "victim", tmp_path / "ds"
    victim.write_text("precious")
    write_dataset(dataset, 1)
    cases = {
        "dataset/.lock": (dataset / ".lock", lambda: repair_dataset(dataset)),
        "dataset/edits.jsonl": (dataset / "edits.jsonl", lambda: drop(dataset, ["ball/000001"])),
        "run/x.part": (tmp_path / "x.part", lambda: replace_files({tmp_path / "x": b"new"})),
        "history.lock": (tmp_path / "h.lock", lambda: HistoryFile(tmp_path / "h", "right")),
        "view.rrd.part": (tmp_path / "view.rrd.part", lambda: write_view(tmp_path / "view.rrd", [], "x")),
    }

    def check(path: Path, write: Callable[[], object]) -> None:
        for make in (lambda: path.symlink_to(victim), lambda: os.link(victim, path), lambda: os.mkfifo(path)):
            path.unlink(missing_ok=True)
            make()
            with suppress(ForetouchError) if path.suffix == ".part" else pytest.raises(FileError, match=path.name):
                write()  # temporary files have other names
            assert victim.read_text() == "precious"
        path.unlink(missing_ok=True)

    every_case(cases, check)


def test_figures_and_cells_are_not_written_through_links(tmp_path: Path) -> None:
    victim, folder = tmp_path / "victim.png", tmp_path / "outside"
    victim.write_text("precious")
    folder.mkdir()
    (tmp_path / "figure.png").symlink_to(victim)
    save_small(new_figure(1.0, 1.0), tmp_path / "figure.png")
    assert victim.read_text() == "precious"
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    sweep, fixed = tmp_path / "sweep", {"experiment": "x", "settings": {}, "data": {"sha256": "0"}}
    write_manifest(sweep, open_folder(sweep, fixed))
    (sweep / "cells").rmdir()
    (sweep / "cells").symlink_to(folder)
    with pytest.raises(FileError, match="cells: is a link"):
        open_folder(sweep, fixed)


def test_devices_and_fifos_are_not_replaced_by_what_is_saved(tmp_path: Path) -> None:
    cloud = Cloud(np.ones((4, 3), np.float32))
    writers = {
        ".npz": lambda path: write_cloud(path, cloud),
        ".ply": lambda path: write_cloud(path, cloud),
        ".json": lambda path: replace_files({path: b"new"}),
        ".png": lambda path: require_writable(path, ".png"),
        ".rrd": lambda path: write_view(path, [], "x"),
    }

    def check(suffix: str, write: Callable[[Path], object]) -> None:
        for name, make in (
            ("fifo", os.mkfifo),
            ("device", lambda path: os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 3))),
        ):
            path = tmp_path / f"{name}{suffix}"
            try:
                make(path)
            except PermissionError:  # only root makes devices
                continue
            before = path.lstat()
            with pytest.raises(
                FileError,
                match=f"{path.name}: cannot be written: is a {name.upper() if name == 'fifo' else name}, not a regular",
            ):
                write(path)
            assert path.lstat() == before

    every_case(list(writers.items()), check)


def test_numbers_of_yaml_are_decimal_and_a_key_that_occurs_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    found = parse_overrides(
        ["a=010", "b=1:30", "c=1_0", "d=1e3", "e=-7", "f=.5", "g=0x1f", "h=1.", "i=.inf", "j=-08.5"]
    )
    assert found == {"a": 10, "b": "1:30", "c": "1_0", "d": 1000.0, "e": -7, "f": 0.5, "g": "0x1f", "h": 1.0} | {
        "i": float("inf"), "j": -8.5,
    }  # fmt: skip
    for text in ("a: 1\na: 2\n", "x: {b: 1, b: 1}\n", "l: [{c: 1, c: 2}]\n", "{a: 1, 'a': 2}"):
        path.write_text(text)
        with pytest.raises(ConfigError, match=r"settings.yaml: not YAML: key [abc] occurs twice"):
            load_yaml(path)
    document = {"z": "1e3", "a": ["010", "1:30", "0x1f", "yes", "", "1_0"], "n": [1, 0.5, 1e-7, True, None]}
    path.write_text(dump_yaml(document))
    assert load_yaml(path) == document
    assert list(load_yaml(path)) == ["z", "a", "n"]


def test_files_with_other_types_are_refused_by_name_though_nothing_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    schema = {"a": int, "b?": [float], "c?": {"d": (str, type(None))}}
    good = {"a": 1, "b": [1, 2.5], "c": {"d": None}, "other": {}}
    assert require_schema(path, good, schema) == good
    cases = [
        ("file.json: .* is not a mapping", [good]),
        ("file.json: a: is missing", {}),
        ("file.json: a: True is not a whole number", {"a": True}),
        ("file.json: a: 1000.* is not a number that can be used", {"a": 10**400}),
        (r"file.json: b\[1\]: inf is not a number", {"a": 1, "b": [1, float("inf")]}),
        (r"file.json: b\[0\]: 'x' is not a number", {"a": 1, "b": ["x"]}),
        ("file.json: c.d: 3 is not a text or null", {"a": 1, "c": {"d": 3}}),
    ]
    every_refusal(FileError, cases, lambda value: require_schema(path, value, schema))


def test_a_file_of_the_kernel_that_waits_and_one_that_grows_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="bytes exceed 10"):
        read_bytes("/proc/self/status", 10)
    path = tmp_path / "file"
    path.write_bytes(bytes(100_000))
    data = FileBytes(path)
    assert data[10:20] == bytes(10)
    os.truncate(path, 50_000)
    with pytest.raises(FileError, match=r"file: byte 50000: was truncated while it was read"):
        data[20_000:90_000]


def test_a_text_takes_a_few_times_its_size_and_long_lines_are_refused(tmp_path: Path) -> None:
    path, points = tmp_path / "text.pcd", 100_000
    head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {points}\nHEIGHT 1\nDATA ascii\n".encode()
    path.write_bytes(head + b"1 2 3\n" * points)
    read_cloud(path)
    tracemalloc.start()
    cloud = read_cloud(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (cloud.xyz == [1, 2, 3]).all()
    assert peak < 12 * path.stat().st_size
    for body, rule in ((b"1 2 3\n" * (points + 1), "100001 lines"), (b"1 2 3 " * points, "a line of more than")):
        path.write_bytes(head + body)
        with pytest.raises(FileError, match=rule):
            read_cloud(path)


def test_names_with_control_characters_do_not_reach_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("a\x1b[2Jb", ["name"], [["x\x1b]0;title\x07y"], ["two\nlines"]])
    warn("name\x1b[31m\nsecond line")
    out, err = capsys.readouterr()
    assert "\x1b" not in out + err
    assert r"a\x1b[2Jb" in out
    assert err == "foretouch: name\\x1b[31m\\nsecond line\n"


def test_shared_memory_of_processes_that_ended_is_freed_and_that_of_others_kept(tmp_path: Path) -> None:
    for name in ("fastdds_dead", "fastrtps_dead", "fastdds_alive", "fastdds_port7412"):
        (tmp_path / name).write_bytes(bytes(1000))
        (tmp_path / f"{name}_el").touch()
    (tmp_path / "fastdds_link_el").symlink_to(tmp_path / "fastdds_dead")
    os.mkfifo(tmp_path / "fastdds_fifo_el")
    with (tmp_path / "fastdds_alive_el").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert stale_bytes(tmp_path) == 2000
        assert stale_bytes(tmp_path, free=True) == 2000
        assert stale_bytes(tmp_path) == 0
    left = sorted(path.name for path in tmp_path.iterdir() if not path.name.endswith("_el"))
    assert left == ["fastdds_alive", "fastdds_port7412"]
