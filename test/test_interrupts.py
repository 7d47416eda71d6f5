# SPDX-License-Identifier: Apache-2.0
"""Signals wait for the end of an import and of a clean-up, and processes of a pool never see them."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CODE = """
import os, signal, sys, time
from foretouch.interrupts import raise_interrupts, uninterrupted, end_at_once, signal_number
raise_interrupts()
def send(count=1, number=signal.SIGINT):
    for _ in range(count):
        os.kill(os.getpid(), number)
        time.sleep(0.01)
try:
    {body}
    time.sleep(5.0)
    print("nothing came")
except KeyboardInterrupt as err:
    print(signal.Signals(signal_number(err)).name)
end_at_once()
"""


def run(body: str, folder: Path, **options: str) -> subprocess.CompletedProcess[str]:
    code = CODE.format(body=body.strip().replace("\n", "\n    "))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(folder)])}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False, env=environment
    )


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_is_an_exception_that_tells_its_number(name: str, tmp_path: Path) -> None:
    done = run(f"send(1, signal.{name})", tmp_path)
    assert (done.stdout, done.stderr, done.returncode) == (f"{name}\n", "", 0)


def test_it_waits_for_the_end_of_an_import(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(
        "import os, signal, time\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(0.1)\n"
        "except BaseException as err:\n    print('lost')\nprint('imported')\n"
    )
    done = run("import slow", tmp_path)
    assert (done.stdout, done.stderr) == ("imported\nSIGINT\n", "")


def test_it_waits_for_the_end_of_a_block_and_the_third_one_does_not(tmp_path: Path) -> None:
    body = "with uninterrupted():\n    with uninterrupted():\n        send({})\n    print('whole', flush=True)"
    done = run(body.format(2), tmp_path)
    assert (done.stdout, done.returncode) == ("whole\nSIGINT\n", 0)
    done = run(body.format(3), tmp_path)
    assert (done.stdout, done.stderr, done.returncode) == ("", "", -signal.SIGINT)


def test_what_the_parent_ignores_stays_ignored(tmp_path: Path) -> None:
    body = "signal.signal(signal.SIGHUP, signal.SIG_IGN); raise_interrupts(); send(1, signal.SIGHUP); send()"
    assert run(body, tmp_path).stdout == "SIGINT\n"


POOL = """
import sys, time
from foretouch.interrupts import raise_interrupts, signal_number
from foretouch.processes import process_pool
def main():
    raise_interrupts()
    try:
        with process_pool(2) as pool:
            for _ in range(4):
                pool.submit(time.sleep, 100.0)
            print("started", flush=True)
            while True:  # a signal just before a sleep takes effect after it
                time.sleep(0.1)
    except KeyboardInterrupt as err:
        print(signal_number(err))
if __name__ == "__main__":
    main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_processes_of_a_pool_end_silently_with_it(number: int, tmp_path: Path) -> None:
    (tmp_path / "pool.py").write_text(POOL)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "pool.py")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    began = time.monotonic()
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert (out, err) == (f"{number}\n", "")
    assert time.monotonic() - began < 30.0


EARLY = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "foretouch.cli.main":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
{before}
from {module} import main
sys.argv = ["foretouch", "--version"]
sys.exit(main())
"""


def _entry_point() -> str:
    (line,) = re.findall(r'"foretouch = (\S+):main"', (ROOT / "setup.py").read_text(encoding="utf-8"))
    return line


def _interrupted_early(before: str = "") -> subprocess.CompletedProcess[str]:
    code = EARLY.format(before=before, module=_entry_point())
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)


def test_ctrl_c_while_the_command_line_is_imported_ends_it_without_a_traceback() -> None:
    done = _interrupted_early()
    assert (done.stdout, done.stderr, done.returncode) == ("", "", -signal.SIGINT)


def test_a_ctrl_c_that_the_parent_ignores_stays_ignored() -> None:
    done = _interrupted_early("signal.signal(signal.SIGINT, signal.SIG_IGN)")
    assert (done.stderr, done.returncode) == ("", 0)
    assert done.stdout.startswith("foretouch ")
