# SPDX-License-Identifier: Apache-2.0
"""The environment of single-threaded processes."""

import os
import subprocess
import sys

import pytest

from foretouch.processes import ONE_THREAD, one_thread_each


def test_children_have_one_thread_and_the_variables_are_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    code = f"import os; print([os.environ.get(name) for name in {list(ONE_THREAD)}])"
    with one_thread_each():
        found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.strip() == "['1', '1', '1']"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
