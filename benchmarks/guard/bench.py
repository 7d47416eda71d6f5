# SPDX-License-Identifier: Apache-2.0
"""Has anything become slower? Ratios of CPU time to peers of the same run, against the committed ones. See README.md."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import print_rows, read_csv, write_csv
from benchmarks.guard.cases import Case, all_cases

RATIOS = Path(__file__).parent / "ratios.csv"
ALLOWED = 0.8  # of the committed ratio: a loss of 20 %
AGAIN = 2  # times that a ratio which is too low is measured again, after all others
RENEWED = 3  # measurements of which the median is committed
_TURNS = 15
_FEWEST_TURNS = 3
_TURN_S = 0.03  # CPU time of a turn, at least: beside it the clock costs nothing
_CASE_S = 6.0  # CPU time after which a case ends


class Measured(NamedTuple):
    """How many times as fast as the peer; by the least CPU time of all turns, which other load can only increase."""

    ratio: float
    ours_s: float  # of one call


class Runner:
    """A case that is set up once."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self._jobs = case.make()
        self._calls = [1, 1]
        if not case.own_clock:
            for job in self._jobs:
                job()
            self._calls = [max(1, math.ceil(_TURN_S / max(self._turn(job, 1), 1e-6))) for job in self._jobs]

    def measure(self) -> Measured:
        """Time both ways turn by turn, so that what loads the machine meets both."""
        least, spent = [math.inf, math.inf], 0.0
        for number in range(1 if self.case.own_clock else _TURNS):
            if number >= _FEWEST_TURNS and spent > _CASE_S:
                break
            for k in (0, 1) if number % 2 else (1, 0):
                seconds = self._turn(self._jobs[k], self._calls[k])
                spent += seconds * self._calls[k]
                least[k] = min(least[k], seconds)
        return Measured(least[1] / least[0], least[0])

    def _turn(self, job: Callable[[], Any], calls: int) -> float:
        if self.case.own_clock:
            return float(job())
        began = time.process_time()
        for _ in range(calls):
            job()
        return (time.process_time() - began) / calls


def guard(runners: Sequence[Runner], committed: Mapping[str, float]) -> bool:
    """Measure all, those that lost 20 % again after all others, of which the best counts; print the table. Whether none is lost."""

    def lost(name: str) -> bool:
        return not best[name].ratio >= ALLOWED * committed.get(name, 0.0)

    best = {runner.case.name: runner.measure() for runner in runners}
    for again in AGAIN * list(runners):
        if lost(name := again.case.name):
            print(f"  {name}: {best[name].ratio:.3g} of {committed[name]:.3g}, measured again", flush=True)
            best[name] = max(best[name], again.measure())
    rows = []
    for runner in runners:
        (ratio, ours_s), known = best[runner.case.name], committed.get(runner.case.name)
        facts = {"CPU ms": 1e3 * ours_s, "ratio now": ratio, "committed": known, "peer": runner.case.peer}
        rows.append({"": runner.case.name, **facts, "is": "LOST" if lost(runner.case.name) else ""})
    print_rows(rows)
    return not any(row["is"] for row in rows)


def renew(runners: Sequence[Runner], path: Path) -> None:
    """Write the median of several measurements, each over all cases; rows of other cases stay."""
    every = np.array([[runner.measure() for runner in runners] for _ in range(RENEWED)])
    rows = {row["name"]: row for row in read_csv(path)}
    for runner, (ratio, ours_s) in zip(runners, np.median(every, axis=0), strict=True):
        facts = {
            "name": runner.case.name,
            "peer": runner.case.peer,
            "ratio": f"{ratio:.4g}",
            "cpu_ms": f"{1e3 * ours_s:.4g}",
        }
        rows[runner.case.name] = facts
    write_csv(path, [rows[case.name] for case in all_cases() if case.name in rows])


def main() -> int:
    """Exit status 1 if a ratio has lost more than 20 %."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", metavar="TEXT", help="cases whose name contains it; may be repeated")
    renewing = f"write the median of {RENEWED} measurements on this machine to ratios.csv, to commit"
    parser.add_argument("--renew", action="store_true", help=renewing)
    arguments = parser.parse_args()
    began, only = time.monotonic(), arguments.only or [""]
    runners = [Runner(case) for case in all_cases() if any(text in case.name for text in only)]
    if not runners:
        parser.error("--only: no case has such a name")
    if arguments.renew:
        renew(runners, RATIOS)
        return 0
    kept = guard(runners, {row["name"]: float(row["ratio"]) for row in read_csv(RATIOS)})
    load, what = os.getloadavg()[0], "nothing is" if kept else "something is"
    print(f"\n{time.monotonic() - began:.0f} s at a load of {load:.1f}: {what} lost")
    return int(not kept)


if __name__ == "__main__":
    sys.exit(main())
