# SPDX-License-Identifier: Apache-2.0
"""Run the cases of a fuzzer in child processes, judge them, and print a table of the outcomes.

A child reads many cases one after the other and writes down which one it is at, so that a crash by a signal or a hang is
told from the others, named by its kind, seed and number, and followed by the next child.
"""

import argparse
import importlib
import json
import math
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import ROOT, write_csv
from foretouch.errors import ForetouchError

OUTCOMES = ("refused", "read", "changed in silence", "uncaught", "signal", "slow")
SECONDS = 1.0  # of CPU time that a case may take
PATIENCE_S = 15.0  # of CPU time for one case, until the child is ended
STILL_S = 600.0  # of wall time, for a case that waits for something
MEMORY = 2_000_000_000  # bytes that the child may map beyond what its imports take: more is a `MemoryError`
LINE = 3000  # characters of the longest refusal
_HANGS = {-signal.SIGPROF, -signal.SIGALRM}  # the timers of a case

Case = Callable[[np.random.Generator], str]
"""Makes a case and reads it: `read` or `changed in silence`, or a `ForetouchError` for a refusal."""


@dataclass(frozen=True)
class Kind:
    """One kind of input."""

    prepare: Callable[[Path], Case]  # from an empty folder
    weight: float = 1.0  # part of the cases, relative to other kinds: few where a case takes long


def _crash(_: Path) -> Case:
    """Ends its process in every fourth case."""
    calls = iter(range(10**9))

    def case(_: np.random.Generator) -> str:
        if next(calls) % 4 == 3:
            os.kill(os.getpid(), signal.SIGSEGV)
        return "read"

    return case


KINDS = {"crash": Kind(_crash)}
"""For the test of this module."""


def generator(name: str, seed: int, number: int) -> np.random.Generator:
    """The random numbers of a case."""
    return np.random.default_rng([seed, zlib.crc32(name.encode()), number])


def read_case(case: Case, rng: np.random.Generator) -> tuple[str, str, float]:
    """Outcome of a case, detail of a fault, and CPU time [s]."""
    began, detail = time.process_time(), ""
    try:
        outcome = case(rng)
        detail = "" if outcome == "read" else outcome
    except ForetouchError as err:
        text = str(err)
        clear = text and "\n" not in text and len(text) < LINE
        outcome, detail = ("refused", "") if clear else ("uncaught", f"unclear: {text[:200]!r}")
    except BaseException as err:  # noqa: BLE001  whatever is not ForetouchError is what is searched for
        trace = err.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        place = "?" if trace is None else f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
        outcome, detail = "uncaught", f"{type(err).__name__}: {str(err)[:200]} at {place}"
    return outcome, detail, time.process_time() - began


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
    slowest = 0.0
    for number in range(first, cases):
        (folder / "progress").write_text(str(number))
        signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)
        signal.setitimer(signal.ITIMER_REAL, STILL_S)
        outcome, detail, seconds = read_case(case, generator(name, seed, number))
        slowest = max(slowest, seconds)
        if outcome in ("read", "refused") and seconds > SECONDS and number > first:  # the first one includes imports
            outcome, detail = "slow", f"{seconds:.2f} s"
        counts[outcome] += 1
        if detail:
            print(json.dumps({"number": number, "outcome": outcome, "detail": detail}), file=answers, flush=True)
    print(json.dumps({"counts": counts, "slowest": slowest}), file=answers, flush=True)


def run(module: str, name: str, cases: int, seed: int) -> tuple[dict[str, Any], list[str]]:
    """Read cases of one kind of a module in child processes; a row of the table, and a line for each fault."""
    counts: Counter[str] = Counter()
    faults: list[str] = []
    slowest, first = 0.0, 0
    while first < cases:
        with tempfile.TemporaryDirectory(prefix="foretouch-fuzz-") as path:
            folder = Path(path)
            words = [module, name, str(cases), str(seed), str(first), path]
            with (folder / "answers").open("w") as answers, (folder / "log").open("w") as log:
                command = [sys.executable, "-m", "benchmarks.fuzz.driver", *words]
                ended = subprocess.run(command, stdout=answers, stderr=log, cwd=ROOT, check=False).returncode
            if not (folder / "progress").exists():
                raise SystemExit(f"{name}: cannot be prepared: {(folder / 'log').read_text()[-500:]}")
            number = int((folder / "progress").read_text())
            for line in (folder / "answers").read_text().splitlines():
                answer = json.loads(line)
                if "counts" in answer:
                    counts.update(answer["counts"])
                    slowest = max(slowest, answer["slowest"])
                else:
                    faults.append(f"{name} {seed} {answer['number']}: {answer['outcome']}: {answer['detail']}")
            if ended:
                outcome = "slow" if ended in _HANGS else "signal"
                counts += Counter({outcome: 1, "read": number - first})  # those before it, without their outcomes
                faults.append(f"{name} {seed} {number}: {outcome}: exit status {ended}")
        first = number + 1
    row = {"kind": name, "cases": cases, **{outcome: counts[outcome] for outcome in OUTCOMES}}
    return {**row, "slowest_ms": round(slowest * 1e3, 1)}, faults


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
    arguments = parser(description, list(kinds), cases).parse_args()
    names = arguments.kind or list(kinds)
    total = sum(kinds[name].weight for name in names)
    rows, failed = [], False
    for name in names:
        cases = max(1, math.ceil(arguments.cases * kinds[name].weight / total))
        row, faults = run(module, name, cases, arguments.seed)
        rows.append(row)
        print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)
        places = Counter(re.sub(r"^.*? \d+ \d+: ", "", fault) for fault in faults)
        shown = [*faults[:5], *(f"{number} x {text}" for text, number in places.most_common(8) if len(faults) > 5)]
        print("".join(f"  {line}\n" for line in shown), end="", flush=True)
        failed |= bool(faults)
        if arguments.out:
            write_csv(arguments.out, rows)
    return int(failed)


if __name__ == "__main__":
    _serve(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:6]), Path(sys.argv[6]))
