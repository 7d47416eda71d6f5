# SPDX-License-Identifier: Apache-2.0
"""Tensor files: exact round trip, and replaced or damaged files are detected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from foretouch.checked_files import file_sha256
from foretouch.errors import ModelError
from foretouch.models.files import packed, read_tensors

TENSORS = {
    "matrix": np.arange(12.0).reshape(3, 4).T,  # not contiguous
    "scalar": np.array(2.5),
    "half": np.linspace(-1, 1, 5).astype(np.float16),
    "places": np.array([-1, 7], np.int32),
    "none": np.empty((0, 3), np.float32),
}


def write(path: Path) -> str:
    content, sha256 = packed(TENSORS)
    path.write_bytes(content)
    return sha256


def test_arrays_come_back_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    sha256 = write(path)
    found = read_tensors(path, sha256, "a.json")
    assert sha256 == file_sha256(path)
    assert set(found) == set(TENSORS)
    for name, array in TENSORS.items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        assert_array_equal(found[name], array)


def test_the_same_arrays_make_the_same_bytes() -> None:
    assert packed(TENSORS) == packed(dict(reversed(TENSORS.items())))


def test_an_absent_file_is_named_with_the_card(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gone.safetensors: no such weights; a.json names them"):
        read_tensors(tmp_path / "gone.safetensors", "0" * 64, "a.json")


def test_another_file_is_detected_by_its_hash(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    sha256 = write(path)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(ModelError, match=rf"a.safetensors: sha256: .* is not {sha256} of a.json; damaged or replaced"):
        read_tensors(path, sha256, "a.json")


@pytest.mark.parametrize("content", [b"", b"\x80\x04K\x01.", b"\xff" * 100, b"\x02\x00\x00\x00\x00\x00\x00\x00{}junk"])
def test_a_file_of_another_kind_is_damaged_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.safetensors"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=r"a.safetensors: damaged: ") as caught:
        read_tensors(path, file_sha256(path), "a.json")
    assert "\n" not in str(caught.value)
