# SPDX-License-Identifier: Apache-2.0
"""Files that belong together are replaced all or none, and a fault names the file."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from foretouch.errors import FileError
from foretouch.models.files import replace_files


def test_only_the_files_are_left_in_folders_that_are_made(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "er"
    replace_files({folder / "a": b"1", folder / "b": b"2"})
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {"a": b"1", "b": b"2"}


def test_others_may_read_what_the_umask_lets_them(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        replace_files({tmp_path / "a": b"1"})
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640


def test_a_full_disk_at_the_last_file_leaves_all_of_them(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    replace_files({one: b"old", two: b"old"})
    (tmp_path / "two.part").symlink_to("/dev/full")
    with pytest.raises(FileError, match=r"two: cannot be written, the one before is kept: No space left"):
        replace_files({one: b"new", two: b"new"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"one": b"old", "two": b"old"}


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(FileError, match=r"file/a: cannot be written.*Not a directory|File exists"):
        replace_files({tmp_path / "file" / "a": b"1"})
