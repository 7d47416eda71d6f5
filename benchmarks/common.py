# SPDX-License-Identifier: Apache-2.0
"""What benchmarks share: tables as CSV, Markdown and text, CPU times, scenes, and the option `--data`. Run them from the root."""

import csv
import os
import time
from argparse import ArgumentParser
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch_lab.simulation.scene import SceneConfig, load_scene

ROOT: Final = Path(__file__).parents[1]
BEGIN: Final = "<!-- written by the benchmark -->\n"
END: Final = "<!-- end of what is written -->\n"

Rows = Iterable[Mapping[str, Any]]


def read_csv(path: Path) -> list[dict[str, str]]:
    """Return rows of a table; none if it does not exist."""
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
    """Return a table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(str(cell) for cell in line)} |\n" for line in lines)


def replace_marked(path: Path, text: str, begin: str = BEGIN, end: str = END) -> None:
    """Replace what stands between two marks of a README."""
    head, rest = path.read_text(encoding="utf-8").split(begin)
    path.write_text(f"{head}{begin}\n{text}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def print_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows of the same columns below each other, right-aligned but for the first column."""
    if not rows:
        return
    lines = [list(rows[0]), *([_text(value) for value in row.values()] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for first, *others in lines:
        cells = (cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))
        print("  ".join([first.ljust(widths[0]), *cells]), flush=True)


def show_tables(tables: Mapping[str, Sequence[Mapping[str, Any]]], head: str, page: Path | None = None) -> None:
    """Print tables, and write them between the marks of a page.

    Args:
        tables: By title.
        head: First line of what is written.
        page: The page; None only prints.
    """
    text = [head]
    for title, rows in tables.items():
        print(f"\n{title}")
        print_rows(rows)
        text.append(f"{title}:\n\n{markdown(list(rows[0]), [list(row.values()) for row in rows])}")
    if page is not None:
        replace_marked(page, "\n\n".join(text).strip())


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)


def cpu_ms(job: Callable[[], object], repeats: int, least: bool = False) -> float:
    """Return the CPU time of a call, all threads of this process, after one call to warm up: the median, or the least [ms]."""
    times = []
    for _ in range(repeats + 1):
        used = time.process_time()
        job()
        times.append(time.process_time() - used)
    return 1e3 * float(min(times[1:]) if least else np.median(times[1:]))


def scene(name: str, **changes: Any) -> SceneConfig:
    """Return a scene of the repository, with changes by dotted keys given as `a__b=value`."""
    loaded = load_scene(ROOT / "config" / "scenes" / f"{name}.yaml")
    return loaded.updated({key.replace("__", "."): value for key, value in changes.items()}) if changes else loaded


def add_data(parser: ArgumentParser) -> None:
    """The option `--data`: the folder of recordings of others."""
    parser.add_argument(
        "--data", type=Path, default=os.environ.get("FORETOUCH_DATA"), help="folder of recordings (or FORETOUCH_DATA)"
    )
