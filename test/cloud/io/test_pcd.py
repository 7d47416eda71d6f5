# SPDX-License-Identifier: Apache-2.0
"""PCD files that claim more than a camera can see; all else of the format is tested in `test_files.py`."""

from pathlib import Path

import pytest

from foretouch.cloud.io.pcd import read_pcd
from foretouch.errors import FileError


def test_a_sparse_file_that_claims_a_huge_image_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "sparse.pcd"
    side = 12_000
    header = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {side}\nHEIGHT {side}\nDATA binary\n".encode()
    with path.open("wb") as file:
        file.write(header)
        file.truncate(len(header) + 12 * side * side)
    with pytest.raises(FileError, match="WIDTH: WIDTH 12000 x HEIGHT 12000 exceeds 20000000 points"):
        read_pcd(path)
