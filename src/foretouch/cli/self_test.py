# SPDX-License-Identifier: Apache-2.0
"""`foretouch doctor --self-test`: rows of the self-test in child processes, so that a crash is one failed row."""

import json
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from typing import IO, Any

from foretouch.cli.output import print_json, print_table, print_text, progress_bar
from foretouch.errors import ConfigError
from foretouch.processes import one_thread_each
from foretouch.selftest.rows import ROWS, RowResult

ROS, TIMINGS = "ROS", "timings"
NAMES = (*ROWS, ROS, TIMINGS)
_PATIENCE_S = 120.0  # of one row; the longest takes 6 s on an idle machine
_CRASHED = "foretouch doctor: a library that crashes is named there"


def run_self_test(names: Sequence[str], *, as_json: bool) -> int:
    """Run rows by name, all without one, and print them; returns exit status 1 if one fails.

    Raises:
        ConfigError: If there is no such row.
    """
    unknown = [name for name in names if name not in NAMES]
    if unknown:
        raise ConfigError(f"--self-test: {unknown[0]!r} is none of {', '.join(NAMES)}")
    began = time.monotonic()
    results = []
    with progress_bar("", total=len(names or NAMES), hidden=as_json, transient=True) as update:
        for result in run_rows(names or NAMES):
            results.append(result)
            update(description=result.row)
            if as_json:
                print_json(result.to_mapping())
    failed = [one for one in results if one.state == "failed"]
    if not as_json:
        _print_table(results, failed, time.monotonic() - began)
    return int(bool(failed))


def run_rows(names: Sequence[str]) -> Iterator[RowResult]:
    """Run rows by name, each group of them in one child process.

    A row in which it dies fails, the next ones still run.
    """
    waiting = [name for name in names if name != ROS]
    while waiting:
        for result in _child(["foretouch.selftest", *waiting]):
            waiting.remove(result.row)
            yield result
    if ROS in names:
        yield from _child(["foretouch.ros.self_test"])


def _child(words: Sequence[str]) -> Iterator[RowResult]:
    """The rows that a process completes, and the one in which it dies or hangs."""
    row = words[1] if len(words) > 1 else ROS
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        with one_thread_each():
            process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                [sys.executable, "-m", *words], stdout=subprocess.PIPE, stderr=errors, text=True
            )
        try:
            for line in _lines(process):
                record = _record(line)
                if record.get("state") == "running":
                    row = str(record["row"])
                elif record:
                    yield RowResult(**record)
                    row = ""
            cause = f"its process ended by {_ending(process.wait())}{_last_line(errors)}"
        except queue.Empty:
            cause = f"takes more than {_PATIENCE_S:g} s"
        finally:
            process.kill()
            process.wait()
    if row:
        yield RowResult(row, "failed", "stopped", cause, _CRASHED)


def _lines(process: subprocess.Popen[str]) -> Iterator[str]:
    """Lines of a process until it ends; `queue.Empty` if none comes for too long."""
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in process.stdout or ():
            lines.put(line)
        lines.put("")

    threading.Thread(target=read, daemon=True).start()
    while line := lines.get(timeout=_PATIENCE_S):
        yield line


def _last_line(errors: IO[str]) -> str:
    """The last line that a process wrote to standard error, to be appended to a message."""
    errors.seek(0)
    lines = errors.read().strip().splitlines()
    return f": {lines[-1][:300]}" if lines else ""


def _record(line: str) -> dict[str, Any]:
    """A line of JSON; other lines, which a library may print, are empty records."""
    try:
        record = json.loads(line)
    except ValueError:
        return {}
    return record if isinstance(record, dict) and "row" in record else {}


def _ending(status: int) -> str:
    return signal.Signals(-status).name if status < 0 else f"exit status {status}"


def _print_table(results: Sequence[RowResult], failed: Sequence[RowResult], seconds: float) -> None:
    rows = [[one.row, one.state, one.found, f"{one.seconds:.1f} s"] for one in results]
    print_table("foretouch doctor --self-test", ["row", "state", "found", "time"], rows)
    for one in failed:
        print_text(f"{one.row}: {one.cause}\n  fix: {one.fix}")
    print(f"{len(results)} rows, {len(failed)} failed, {seconds:.0f} s")
