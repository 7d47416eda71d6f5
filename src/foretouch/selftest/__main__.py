# SPDX-License-Identifier: Apache-2.0
"""`python -m foretouch.selftest [ROW]...`: run rows of the self-test and print one line of JSON for each.

A line `{"row": ..., "state": "running"}` comes before a row, so that the caller can name the row in which this process
dies. `--all` runs every hard case of every format and effect instead, and prints those that are not as expected.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from itertools import chain

from foretouch.selftest.case import HardCase, fault
from foretouch.selftest.rows import ROWS, run_row, timings


def main(names: Sequence[str]) -> int:
    """Run rows by name; returns 1 if a row fails."""
    if list(names) == ["--all"]:
        return _run_all()
    failed = False
    for name in names or (*ROWS, "timings"):
        _print({"row": name, "state": "running"})
        result = timings() if name == "timings" else run_row(ROWS[name])
        _print(result.to_mapping())
        failed |= result.state == "failed"
    return int(failed)


def _run_all() -> int:
    count = faults = 0
    for case in _all_cases():
        count += 1
        found = fault(case)
        if found:
            faults += 1
            sys.stdout.write(f"{case.name}: {found}\n")
    sys.stdout.write(f"{count - faults} of {count} as expected\n")
    return int(faults > 0)


def _all_cases() -> Iterator[HardCase]:
    from foretouch.selftest.files import file_cases
    from foretouch.selftest.numbers import number_cases
    from foretouch.selftest.pipeline import pipeline_cases
    from foretouch.selftest.simulator import simulator_cases
    from foretouch.selftest.training import training_cases

    return chain(pipeline_cases(), number_cases(), training_cases(), simulator_cases(), file_cases(every=True))


def _print(record: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(record) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
