# SPDX-License-Identifier: Apache-2.0
"""The environment of single-threaded processes, and pools that end."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_answer import run_python

from foretouch.base.processes import ONE_THREAD, process_pool

STOPPED_WHILE_SENDING = """
import threading, time
from foretouch.base.processes import process_pool

reading, read = threading.Event(), threading.Event()

def wait():
    reading.set()
    return read.wait(20.0)

class SlowToRead:  # the thread of the pool takes it in when it may
    def __reduce__(self):
        return wait, ()

def slow_to_read():
    return SlowToRead()

def large():
    time.sleep(0.5)  # the second result
    return bytes(1_000_000)

if __name__ == "__main__":
    with process_pool(2) as pool:
        pool.submit(large)
        pool.submit(slow_to_read)
        assert reading.wait(20.0)
        time.sleep(1.5)  # the pipe is full by now: it holds much less
        threading.Timer(0.5, read.set).start()
        raise OSError("disk full")
"""


def test_children_have_one_thread_and_the_variables_are_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    code = f"import os; print([os.environ.get(name) for name in {list(ONE_THREAD)}])"
    with process_pool(1):
        found = run_python(code)
    assert found.stdout.strip() == "['1', '1', '1']"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_a_pool_ends_though_a_process_was_stopped_while_it_sent_a_result(tmp_path: Path) -> None:
    script = tmp_path / "sending.py"
    script.write_text(STOPPED_WHILE_SENDING)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=40.0, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "OSError: disk full"
