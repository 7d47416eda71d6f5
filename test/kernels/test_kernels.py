# SPDX-License-Identifier: Apache-2.0
"""The library of compiled functions: loaded, refused, or missing."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_answer import run_python

from foretouch import kernels

COUNT = kernels.Kernel("count_range")


def test_an_array_that_would_be_misread_and_an_absent_or_foreign_library_are_refused(tmp_path: Path) -> None:
    xyz, counts = np.zeros((4, 3), np.float32), np.zeros(2, np.int64)
    for arguments, fault in (
        ((xyz.astype(np.float64), 4, 0.1, 2.0, counts), r"argument 0 is .*'float64'\), not of dtype\('float32'"),
        ((xyz.astype(">f4"), 4, 0.1, 2.0, counts), r"argument 0 is an array of dtype\('>f4'\)"),
        ((np.zeros((4, 6), np.float32)[:, ::2], 4, 0.1, 2.0, counts), "not C-contiguous"),
        ((xyz, 4.5, 0.1, 2.0, counts), "'float' object cannot be interpreted as an integer|integer"),
        ((xyz, 4, 0.1, 2.0, [0, 0]), "no attribute 'dtype'"),
        ((xyz, 4, 0.1, 2.0), "4 arguments, not 5"),
    ):
        with pytest.raises(TypeError, match=f"^count_range: .*(?:{fault})"):
            COUNT(*arguments)
    for fields, fault in ((("nodes", xyz), "int32_t"), (("count", 1.5), "integer"), (("none", 1), "none")):
        with pytest.raises((TypeError, KeyError), match=fault):
            kernels.struct("Forests", **dict([fields]))
    with pytest.raises(AttributeError):
        kernels.Kernel("no_such_function")
    copy = tmp_path / "copied_kernels"
    shutil.copytree(Path(kernels.__file__).parent, copy)

    def last_line() -> str:
        return run_python("import copied_kernels", cwd=tmp_path).stderr.strip().rpartition("\n")[2]

    assert last_line() == ""
    with (copy / "crop.c").open("a") as file:
        file.write("/* changed */")
    fix = "install a C compiler (apt install gcc), then foretouch again (make setup, or pip install .)"
    again = "after an update of the sources install foretouch again (make setup, or pip install .)"
    assert last_line().endswith(f": the kernels were compiled from other sources: {again}")
    for library in copy.glob("*.so"):
        library.write_bytes(b"not a library")
    assert "_kernels" in (line := last_line())
    assert line.endswith(fix)
    for library in copy.glob("*.so"):
        library.unlink()
    assert last_line().endswith(
        f"the compiled kernels cannot be loaded: No module named 'copied_kernels._kernels': {fix}"
    )
