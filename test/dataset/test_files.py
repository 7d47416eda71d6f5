# SPDX-License-Identifier: Apache-2.0
"""Several writers of one new folder, and of one file: the second is refused or the last one wins, and nobody's work is deleted."""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from every_case import every_case
from recording_builders import record, write_dataset

import foretouch as ft
from foretouch.base.files import replace_files
from foretouch.dataset.files import new_folder
from foretouch.dataset.formats import export_samples, open_samples
from foretouch.dataset.importing import import_samples
from foretouch.errors import FileError
from foretouch_lab.dataset.store_writer import StoreWriter, build_store


def write_slowly(path: Path, begun: Event, go: Event) -> int:
    """Write three samples of a generator, which waits after the first."""

    def records() -> Any:
        for number in range(3):
            yield record(number)
            begun.set()
            assert go.wait(60)

    return ft.write(path, records()).samples


@pytest.mark.filterwarnings("ignore:equal_stamps", "ignore:other_rate")
def test_a_second_writer_of_a_new_folder_is_refused_and_the_first_ends(tmp_path: Path) -> None:
    source, path = tmp_path / "source", tmp_path / "new"
    write_dataset(source, 2)
    others: dict[str, Callable[[], object]] = {
        "write": lambda: ft.write(path, [record(7)]),
        "export": lambda: export_samples(source, path, "npz"),
        "rosbag2": lambda: export_samples(source, path, "rosbag2"),
        "build": lambda: build_store([source], path),
        "import": lambda: import_samples(source, path),
    }
    begun, go = Event(), Event()
    with ThreadPoolExecutor(1) as threads:
        first = threads.submit(write_slowly, path, begun, go)
        assert begun.wait(60)

        def check(write: Callable[[], object]) -> None:
            with pytest.raises(
                FileError, match=f"new: process {os.getpid()} is writing this dataset: one writer at a time"
            ):
                write()

        every_case(others, check)
        go.set()
        assert first.result(60) == 3
    assert len(open_samples(path)) == 3
    assert [entry.name for entry in tmp_path.iterdir() if entry.name.endswith(".part")] == []
    with pytest.raises(FileError, match="exists already and is not overwritten"):
        export_samples(source, path, "npz")


def test_what_a_killed_process_left_is_removed_by_the_next_writer(tmp_path: Path) -> None:
    script = "import os, sys\nfrom pathlib import Path\nfrom foretouch.dataset.files import new_folder\n"
    script += "with new_folder(Path(sys.argv[1])) as folder:\n    folder.mkdir()\n    (folder / 'x').touch()\n    os._exit(9)\n"
    assert subprocess.run([sys.executable, "-c", script, tmp_path / "new"], check=False).returncode == 9
    assert (tmp_path / ".new.part" / "new" / "x").exists()
    with StoreWriter(tmp_path / "new") as writer:
        writer.write(record(0))
    assert len(open_samples(tmp_path / "new")) == 1
    assert not (tmp_path / ".new.part").exists()


def test_a_folder_that_another_program_makes_meanwhile_costs_nothing(tmp_path: Path) -> None:
    def write() -> None:
        with new_folder(tmp_path / "new") as folder:
            folder.mkdir()
            (folder / "mine").touch()
            (tmp_path / "new").mkdir()
            (tmp_path / "new" / "theirs").touch()

    with pytest.raises(FileError, match=r"new: was made by another program meanwhile; what was written is new\.new"):
        write()
    assert (tmp_path / "new" / "theirs").exists()
    assert (tmp_path / "new.new" / "mine").exists()


def test_nothing_is_removed_through_a_link_in_the_place_of_the_temporary_folder(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "file").touch()
    (tmp_path / ".new.part").symlink_to(precious)
    with pytest.raises(FileError, match=r"new: cannot be written, by way of \.new\.part: File exists"):
        ft.write(tmp_path / "new", [record(0)])
    assert [entry.name for entry in precious.iterdir()] == ["file"]


def test_files_that_belong_together_are_those_of_one_writer(tmp_path: Path) -> None:
    card, weights = tmp_path / "card", tmp_path / "weights"

    def write(number: int) -> None:
        for _ in range(20):
            replace_files({weights: bytes([number]) * 5000, card: bytes([number])})

    with ThreadPoolExecutor(4) as threads:
        assert [*threads.map(write, range(4))] == [None] * 4
    assert {*weights.read_bytes()} == {*card.read_bytes()}
    assert len([*tmp_path.iterdir()]) == 2
