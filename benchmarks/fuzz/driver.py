# SPDX-License-Identifier: Apache-2.0
"""Run the cases of a fuzzer in child processes, judge them, and print a table of the outcomes.

A child reads many cases one after the other and says by a shared number which one it is at, so that a crash by a signal or
a hang is told from the others, named by its kind, seed and number, and followed by the next child.
"""

import argparse
import gc
import importlib
import json
import math
import mmap
import os
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import ROOT, read_csv, write_csv
from foretouch.errors import ForetouchError

OUTCOMES = ("refused", "read", "changed in silence", "uncaught", "signal", "slow", "memory")
COLUMNS = ("kind", "cases", *OUTCOMES, "slowest_ms", "peak_mb")
SECONDS = 1.0  # of CPU time that a case may take
PATIENCE_S = 15.0  # of CPU time for one case, until the child is killed; the first one includes the imports
STILL_S = 600.0  # of wall time, for a case that waits for something
MEMORY = 2_000_000_000  # bytes that the child may map beyond what its imports take
RESIDENT = 1_000_000_000  # bytes that are in memory at most, with the imports
LINE = 3000  # characters of the longest refusal
_PROGRESS = struct.Struct("<q")

Case = Callable[[np.random.Generator], str]
"""Makes a case and reads it: `read` or `changed in silence`, or a `ForetouchError` for a refusal."""


@dataclass(frozen=True)
class Kind:
    """One kind of input."""

    prepare: Callable[[Path], Case]  # from an empty folder
    weight: float = 1.0  # part of the cases, relative to other kinds: few where a case takes long


def _crash(folder: Path) -> Case:
    """Ends its process in every fourth case."""
    del folder
    calls = iter(range(10**9))

    def case(rng: np.random.Generator) -> str:
        del rng
        if next(calls) % 4 == 3:
            os.kill(os.getpid(), signal.SIGSEGV)
        return "read"

    return case


KINDS = {"crash": Kind(_crash)}
"""For the test of this module."""


def read_case(case: Case, rng: np.random.Generator) -> tuple[str, str, float]:
    """Outcome of a case, detail of a fault, and CPU time [s]."""
    began = time.process_time()
    detail = ""
    try:
        outcome = case(rng)
        detail = "" if outcome == "read" else outcome
    except ForetouchError as err:
        text = str(err)
        clear = text and "\n" not in text and len(text) < LINE
        outcome, detail = ("refused", "") if clear else ("uncaught", f"unclear: {text[:200]!r}")
    except BaseException as err:  # noqa: BLE001  whatever is not ForetouchError is what is searched for
        outcome, detail = "uncaught", f"{type(err).__name__}: {str(err)[:200]} at {_place(err)}"
    return outcome, detail, time.process_time() - began


def generator(kinds: Mapping[str, Kind], name: str, seed: int, number: int) -> np.random.Generator:
    """The random numbers of a case."""
    return np.random.default_rng([seed, list(kinds).index(name), number])


def _place(err: BaseException) -> str:
    trace = err.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "?" if trace is None else f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"


def _serve(module: str, name: str, cases: int, seed: int, first: int, folder: Path) -> None:
    """Read cases in this process; prints a line of JSON for each fault, and the counts at the end."""
    warnings.simplefilter("ignore")
    answers, sys.stdout = sys.stdout, sys.stderr
    kinds: Mapping[str, Kind] = importlib.import_module(module).KINDS
    (folder / "case").mkdir()
    case = kinds[name].prepare(folder / "case")
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + MEMORY, mapped + MEMORY))
    counts: Counter[str] = Counter()
    slowest = peak = 0.0
    with (folder / "progress").open("r+b") as file:
        shared = mmap.mmap(file.fileno(), _PROGRESS.size)
        for number in range(first, cases):
            shared[:] = _PROGRESS.pack(number)
            outcome, detail, seconds = read_case(case, generator(kinds, name, seed, number))
            resident = _peak_bytes()
            slowest, peak = max(slowest, seconds), max(peak, resident)
            if outcome in ("read", "refused") and seconds > SECONDS and number > first:
                outcome, detail = "slow", f"{seconds:.2f} s"
            if outcome in ("read", "refused") and resident > RESIDENT:
                outcome, detail = "memory", f"{resident / 1e6:.0f} MB"
            counts[outcome] += 1
            if detail:
                _keep(folder / "case", folder / f"kept-{number}")
                print(json.dumps({"number": number, "outcome": outcome, "detail": detail}), file=answers, flush=True)
            if number % 1000 == 999:
                gc.collect()
    print(json.dumps({"counts": counts, "slowest": slowest, "peak": peak}), file=answers, flush=True)


def _peak_bytes() -> int:
    """The most memory that this process had at once since the last call."""
    text = Path("/proc/self/status").read_text()
    Path("/proc/self/clear_refs").write_text("5")
    return int(text.split("VmHWM:")[1].split()[0]) * 1024


def run(module: str, name: str, cases: int, seed: int, keep: Path | None = None) -> tuple[dict[str, Any], list[str]]:
    """Read cases of one kind of a module in child processes; a row of the table, and a line for each fault."""
    counts: Counter[str] = Counter()
    faults: list[str] = []
    slowest, peak, first = 0.0, 0.0, 0
    while first < cases:
        with tempfile.TemporaryDirectory(prefix="foretouch-fuzz-") as path:
            folder = Path(path)
            (folder / "progress").write_bytes(_PROGRESS.pack(-1))
            ended = _child([module, name, str(cases), str(seed), str(first), str(folder)], folder)
            for line in (folder / "answers").read_text().splitlines():
                answer = json.loads(line)
                if "counts" in answer:
                    counts.update(answer["counts"])
                    slowest, peak = max(slowest, answer["slowest"]), max(peak, answer["peak"])
                else:
                    faults.append(f"{name} {seed} {answer['number']}: {answer['outcome']}: {answer['detail']}")
            (number,) = _PROGRESS.unpack((folder / "progress").read_bytes())
            if number < first:
                raise SystemExit(f"{name}: cannot be prepared: {(folder / 'log').read_text()[-500:]}")
            if ended:
                (folder / "case").rename(folder / f"kept-{number}")
                outcome = "slow" if ended == "hang" else "signal"
                counts += Counter({outcome: 1, "read": number - first})  # those before it, without their outcomes
                faults.append(f"{name} {seed} {number}: {outcome}: {ended}")
            for kept in folder.glob("kept-*") if keep else ():
                _keep(kept, keep / f"{name.replace(' ', '-')}-{seed}-{kept.name[5:]}")
        first = number + 1
    row = {"kind": name, "cases": cases, **{outcome: counts[outcome] for outcome in OUTCOMES}}
    return {**row, "slowest_ms": round(slowest * 1e3, 1), "peak_mb": round(peak / 1e6)}, faults


def _keep(case: Path, kept: Path) -> None:
    """Copy the files of a case; links stay links, and a FIFO is left out."""
    with suppress(shutil.Error):
        shutil.copytree(case, kept, symlinks=True, ignore_dangling_symlinks=True)


def _child(words: Sequence[str], folder: Path) -> str:
    """Run a child to its end; "" if it has read all cases, `hang`, or its exit status."""
    command = [sys.executable, "-m", "benchmarks.fuzz.driver", *words]
    with (folder / "answers").open("w") as answers, (folder / "log").open("w") as log:
        process = subprocess.Popen(command, stdout=answers, stderr=log, cwd=ROOT)
    at, since, used = -1, time.monotonic(), 0.0
    while process.poll() is None:
        time.sleep(0.05)
        (number,) = _PROGRESS.unpack((folder / "progress").read_bytes())
        if number != at:
            at, since, used = number, time.monotonic(), _cpu_s(process.pid)
        elif _cpu_s(process.pid) - used > PATIENCE_S or time.monotonic() - since > STILL_S:
            process.kill()
            process.wait()
            return "hang"
    return "" if process.returncode == 0 else f"exit status {process.returncode}"


def _cpu_s(pid: int) -> float:
    """CPU time that a process has used [s]."""
    try:
        times = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(times[11]) + int(times[12])) / os.sysconf("SC_CLK_TCK")


def parser(description: str, kinds: Sequence[str], cases: int) -> argparse.ArgumentParser:
    """The options of a fuzzer."""
    made = argparse.ArgumentParser(description=description)
    made.add_argument("--cases", type=int, default=cases, help=f"in all (default {cases})")
    made.add_argument("--seed", type=int, default=0)
    made.add_argument("--kind", choices=kinds, action="append", help="only this kind; may be repeated")
    made.add_argument("--out", type=Path, help="write the table as CSV")
    return made


def main(module: str, description: str, kinds: Mapping[str, Kind], cases: int) -> int:
    """Run all kinds of a module; the exit status is 1 if a case broke a rule."""
    options = parser(description, list(kinds), cases)
    options.add_argument("--keep", type=Path, help="folder for the files of the cases that break a rule")
    options.add_argument("--resume", action="store_true", help="skip kinds whose rows --out holds with as many cases")
    arguments = options.parse_args()
    names = arguments.kind or list(kinds)
    total = sum(kinds[name].weight for name in names)
    counts = {name: max(1, math.ceil(arguments.cases * kinds[name].weight / total)) for name in names}
    known = read_csv(arguments.out) if arguments.resume else []
    rows: list[Mapping[str, Any]] = [row for row in known if row["cases"] == str(counts.get(row["kind"]))]
    failed = any(int(row[outcome]) for row in rows for outcome in OUTCOMES[2:])
    print("  ".join(COLUMNS))
    for name, count in counts.items():
        if any(row["kind"] == name for row in rows):
            continue
        row, faults = run(module, name, count, arguments.seed, arguments.keep)
        rows.append(row)
        print("  ".join(str(value) for value in row.values()), flush=True)
        for fault in faults[:5]:
            print(f"  {fault}", flush=True)
        places = Counter(re.sub(r"^.*? \d+ \d+: ", "", fault) for fault in faults)
        for text, number in places.most_common(8) if len(faults) > 5 else ():
            print(f"  {number} x {text}", flush=True)
        failed |= bool(faults)
        if arguments.out:
            write_csv(arguments.out, rows)
    return int(failed)


if __name__ == "__main__":
    _serve(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:6]), Path(sys.argv[6]))
