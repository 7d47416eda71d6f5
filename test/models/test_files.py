# SPDX-License-Identifier: Apache-2.0
"""Files of models: exact round trip, replaced or damaged files are detected, and files are replaced all or none."""

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from foretouch.base.files import file_sha256, replace_files
from foretouch.errors import FileError, ModelError
from foretouch.models.files import packed, read_tensors

TENSORS = {
    "matrix": np.arange(12.0).reshape(3, 4).T,  # not contiguous
    "scalar": np.array(2.5),
    "half": np.linspace(-1, 1, 5).astype(np.float16),
    "places": np.array([-1, 7], np.int32),
    "none": np.empty((0, 3), np.float32),
}


def test_arrays_come_back_to_the_bit_and_make_the_same_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    content, sha256 = packed(TENSORS)
    path.write_bytes(content)
    _, found = read_tensors(tmp_path / "a.json", {"weights": path.name, "sha256": sha256})
    assert sha256 == file_sha256(path)
    assert set(found) == set(TENSORS)
    for name, array in TENSORS.items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        assert_array_equal(found[name], array)
    assert packed(TENSORS) == packed(dict(reversed(TENSORS.items())))


def test_a_file_of_another_kind_is_damaged_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    for content in (b"", b"\x80\x04K\x01.", b"\xff" * 100, b"\x02\x00\x00\x00\x00\x00\x00\x00{}junk"):
        path.write_bytes(content)
        with pytest.raises(ModelError, match=r"a.safetensors: damaged: ") as caught:
            read_tensors(tmp_path / "a.json", {"weights": path.name, "sha256": file_sha256(path)})
        assert "\n" not in str(caught.value)


def test_files_are_replaced_all_or_none_in_folders_that_are_made_as_the_umask_lets(tmp_path: Path, full_disk) -> None:
    folder, before = tmp_path / "new" / "er", os.umask(0o027)
    try:
        replace_files({folder / "one": b"old", folder / "two": b"old"})
    finally:
        os.umask(before)
    assert (folder / "one").stat().st_mode & 0o777 == 0o640
    with full_disk("two"), pytest.raises(FileError, match=r"two: cannot .* kept: No space left"):
        replace_files({folder / "one": b"new", folder / "two": b"new"})
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {"one": b"old", "two": b"old"}
    with pytest.raises(FileError, match=r"one/a: cannot be written.*Not a directory|File exists"):
        replace_files({folder / "one" / "a": b"1"})
