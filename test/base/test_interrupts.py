# SPDX-License-Identifier: Apache-2.0
"""Signals wait for the end of an import and of a clean-up; those sent to processes of a pool are in test_abuses.py."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_answer import run_python
from every_case import every_case

from foretouch.cli import main

ROOT = Path(__file__).parents[2]
CODE = """
import os, signal, sys, time
from foretouch.base.interrupts import raise_interrupts, uninterrupted, end_at_once, signal_number
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
SLOW_MODULE = """
import os, signal, time
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.1)
except BaseException as err:
    print('lost')
print('imported')
"""
BLOCK = "with uninterrupted():\n        with uninterrupted():\n            send({})\n        print('whole', flush=True)"
IGNORED = "signal.signal(signal.SIGHUP, signal.SIG_IGN); raise_interrupts(); send(1, signal.SIGHUP); send()"


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(folder)])}
    return run_python(code, env=environment)


def test_a_signal_is_an_exception_that_waits_for_imports_and_clean_ups(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW_MODULE)

    def check(body: str, out: str, status: int) -> None:
        done = run(CODE.format(body=body), tmp_path)
        assert (done.stdout, done.stderr, done.returncode) == (out, "", status)

    cases = {name: (f"send(1, signal.{name})", f"{name}\n", 0) for name in ("SIGINT", "SIGTERM", "SIGHUP")}
    cases |= {
        "import": ("import slow", "imported\nSIGINT\n", 0),
        "clean-up": (BLOCK.format(2), "whole\nSIGINT\n", 0),
        "the third does not wait": (BLOCK.format(3), "", -signal.SIGINT),
        "what the parent ignores stays ignored": (IGNORED, "SIGINT\n", 0),
    }
    every_case(cases, check)


def test_a_signal_at_the_very_end_of_a_command_gives_its_exit_status(monkeypatch: pytest.MonkeyPatch) -> None:
    def struck() -> None:
        raise KeyboardInterrupt(int(signal.SIGTERM))

    monkeypatch.setattr(main, "end_at_once", struck)
    assert main.main(["sensor", "list"]) == 128 + signal.SIGTERM


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


def test_ctrl_c_while_the_command_line_is_imported_ends_it_unless_it_is_ignored(tmp_path: Path) -> None:
    (module,) = re.findall(r'"foretouch = (\S+):main"', (ROOT / "setup.py").read_text(encoding="utf-8"))
    done = run(EARLY.format(before="", module=module), tmp_path)
    assert (done.stdout, done.stderr, done.returncode) == ("", "", -signal.SIGINT)
    done = run(EARLY.format(before="signal.signal(signal.SIGINT, signal.SIG_IGN)", module=module), tmp_path)
    assert (done.stderr, done.returncode) == ("", 0)
    assert done.stdout.startswith("foretouch ")
