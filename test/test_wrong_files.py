# SPDX-License-Identifier: Apache-2.0
"""Files that are consistent and wrong: nothing is overwritten, nothing hangs, and each is refused by name."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from every_case import every_case, every_refusal
from recording_builders import write_dataset

from foretouch.checked_files import replace_files
from foretouch.dataset.editing import drop
from foretouch.dataset.recording import repair_dataset
from foretouch.errors import ConfigError, FileError
from foretouch.learning.training.run_config import RunConfig
from foretouch.learning.training.run_folder import RunFolder
from foretouch.models.hand_history import HistoryFile


def test_nothing_is_written_through_links_and_second_names_of_other_files(tmp_path: Path) -> None:
    victim, dataset = tmp_path / "victim", tmp_path / "ds"
    victim.write_text("precious")
    write_dataset(dataset, 1)
    cases = {
        "dataset/.lock": (dataset / ".lock", lambda: repair_dataset(dataset)),
        "dataset/edits.jsonl": (dataset / "edits.jsonl", lambda: drop(dataset, ["ball/000001"])),
        "run/log.jsonl": (tmp_path / "log.jsonl", lambda: RunFolder(tmp_path).log({})),
        "run/x.part": (tmp_path / "x.part", lambda: replace_files({tmp_path / "x": b"new"})),
        "history.lock": (tmp_path / "h.lock", lambda: HistoryFile(tmp_path / "h", "right")),
    }

    def check(path: Path, write: Callable[[], object]) -> None:
        for make in (lambda: path.symlink_to(victim), lambda: os.link(victim, path), lambda: os.mkfifo(path)):
            path.unlink(missing_ok=True)
            make()
            with suppress(FileError) if path.name == "x.part" else pytest.raises(FileError, match=path.name):
                write()  # a temporary file that is a second name is removed
            assert victim.read_text() == "precious"
        path.unlink(missing_ok=True)

    every_case(cases, check)


def test_names_of_models_are_names_of_files() -> None:
    names = ("../x", "a/b", ".x", "..", "a\nb", "a\x1b[2J", "a b", "x" * 101, "é")
    cases = [("name: .* is not 1 to 100 letters", {"name": name}) for name in names]
    every_refusal(ConfigError, cases, RunConfig.from_mapping)
    assert RunConfig(name="grasp-v2.1_b").name == "grasp-v2.1_b"
