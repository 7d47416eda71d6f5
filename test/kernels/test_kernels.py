# SPDX-License-Identifier: Apache-2.0
"""The library of compiled functions: loaded, refused, or missing."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_answer import run_python

from foretouch import kernels

COUNT = kernels.Kernel("count_range", np.float32, int, float, float, np.int64)


def test_an_array_that_would_be_misread_and_an_absent_or_foreign_library_are_refused(tmp_path: Path) -> None:
    for xyz in (np.zeros((4, 3)), np.zeros((4, 6), np.float32)[:, ::2]):
        with pytest.raises(TypeError, match=r"count_range: an array of .* is not a contiguous one of float32"):
            COUNT(xyz, 4, 0.1, 2.0, np.zeros(2, np.int64))
    with pytest.raises(AttributeError):
        kernels.Kernel("no_such_function", int)
    copy = tmp_path / "copied_kernels"
    shutil.copytree(Path(kernels.__file__).parent, copy)

    def last_line() -> str:
        return run_python("import copied_kernels", cwd=tmp_path).stderr.strip().rpartition("\n")[2]

    assert last_line() == ""
    with (copy / "crop.c").open("a") as file:
        file.write("/* changed */")
    fix = "install a C compiler (apt install gcc), then foretouch again (make setup, or pip install .)"
    assert last_line().endswith(f": compiled from other sources than those beside it: {fix}")
    for library in copy.glob("*.so"):
        library.write_bytes(b"not a library")
    assert "_kernels" in (line := last_line())
    assert line.endswith(fix)
    for library in copy.glob("*.so"):
        library.unlink()
    assert last_line().endswith(f"copied_kernels: the compiled kernels are absent: {fix}")
