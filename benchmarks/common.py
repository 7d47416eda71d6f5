# SPDX-License-Identifier: Apache-2.0
"""What all benchmarks share: one command line, cells that become rows, tables as CSV, Markdown and text. Run them from the root.

A benchmark is a function that yields rows, plain dicts with the same keys, from the options of its command line. `command` runs it,
prints each table and writes it as CSV. Those with a table in their README replace what stands between its marks.
"""

import csv
import os
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.models.timing import MachineLoad
from foretouch_lab.simulation.scene import SceneConfig, load_scene

ROOT: Final = Path(__file__).parents[1]
BEGIN: Final = "<!-- written by the benchmark -->\n"
END: Final = "<!-- end of what is written -->\n"

Rows = Iterable[Mapping[str, Any]]


def command(
    doc: str | None,
    tables: Callable[[Namespace], Mapping[Path, Rows]],
    options: Mapping[str, Mapping[str, Any]] | None = None,
    *,
    data: bool = False,
) -> Namespace:
    """The whole of a benchmark: read the command line, measure, print and write the tables; returns the options.

    Args:
        doc: Docstring of the benchmark.
        tables: From the options to rows by the CSV that holds them; a table is measured once the one before it is written.
        options: Arguments of `add_argument` by flag.
        data: Whether it reads recordings of others, which `--data` names.
    """
    parser = ArgumentParser(description=doc)
    if data:
        add_data(parser)
    for flag, given in (options or {}).items():
        parser.add_argument(flag, **given)
    parser.add_argument("-o", "--out", type=Path, help="folder of the tables, instead of the committed ones")
    arguments = parser.parse_args()
    for path, rows in tables(arguments).items():
        found = list(rows)
        write_csv(arguments.out / path.name if arguments.out else path, found)
        print_rows(found)
    return arguments


def read_csv(path: Path) -> list[dict[str, str]]:
    """Rows of a table; none if it does not exist."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_csv(path: Path, rows: Rows) -> None:
    """Write a table whose rows have the columns of the first one."""
    rows = list(rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def markdown(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(str(cell) for cell in line)} |\n" for line in lines)


def replace_marked(path: Path, text: str) -> None:
    """Replace what stands between the marks of a README."""
    head, rest = path.read_text(encoding="utf-8").split(BEGIN)
    path.write_text(f"{head}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}", encoding="utf-8")


def print_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows of the same columns below each other, right-aligned but for the first column."""
    if not rows:
        return
    lines = [list(rows[0]), *([_text(value) for value in row.values()] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for first, *others in lines:
        cells = (cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))
        print("  ".join([first.ljust(widths[0]), *cells]), flush=True)


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)


def cpu_ms(job: Callable[[], object], repeats: int, least: bool = False) -> float:
    """CPU time of a call, all threads of this process, after one call to warm up: the median, or the least [ms]."""
    times = []
    for _ in range(repeats + 1):
        used = time.process_time()
        job()
        times.append(time.process_time() - used)
    return 1e3 * float(min(times[1:]) if least else np.median(times[1:]))


class OthersLoad:
    """Cores that other processes use from now on, without the children that this one has ended meanwhile."""

    def __init__(self) -> None:
        self._machine, self._children, self._began = MachineLoad(), _ended_children_s(), time.monotonic()

    def cores(self) -> float:
        """Mean number so far."""
        own = (_ended_children_s() - self._children) / (time.monotonic() - self._began)
        return round(max(0.0, float(self._machine.row()["other_cores"]) - own), 3)


def _ended_children_s() -> float:
    times = os.times()
    return times.children_user + times.children_system


def scene(name: str, **changes: Any) -> SceneConfig:
    """A scene of the repository, with changes by dotted keys given as `a__b=value`."""
    loaded = load_scene(ROOT / "config" / "scenes" / f"{name}.yaml")
    return loaded.updated({key.replace("__", "."): value for key, value in changes.items()}) if changes else loaded


def add_data(parser: ArgumentParser) -> None:
    """The option `--data`: the folder of recordings of others."""
    parser.add_argument(
        "--data", type=Path, default=os.environ.get("FORETOUCH_DATA"), help="folder of recordings (or FORETOUCH_DATA)"
    )
