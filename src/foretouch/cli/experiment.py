# SPDX-License-Identifier: Apache-2.0
"""`foretouch experiment`: one command that rebuilds an experiment's table and figures, and goes on where it was killed."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.cli.inputs import positive_number
from foretouch.cli.output import print_json, print_table, warn
from foretouch.config import parse_overrides
from foretouch.errors import ConfigError, FileError, ForetouchError

if TYPE_CHECKING:
    from foretouch.experiments import Experiment
    from foretouch.experiments.framework.executors import Outcome

__all__ = ["add_arguments", "run"]

_ENVIRONMENT = "FORETOUCH_DATA"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which experiment, where to, and how."""
    parser.add_argument("name", metavar="NAME", help="such as cross_validation; `list` tells all")
    parser.add_argument("overrides", metavar="key=value", nargs="*", help="settings that differ from the preset's")
    parser.add_argument("-o", "--out", type=Path, metavar="DIR", help="folder of manifest, results.csv and figures")
    parser.add_argument("--preset", default="full", help="full (default), smoke, or another that the experiment has")
    parser.add_argument("--data", type=Path, metavar="PATH", help=f"by default the folder below {_ENVIRONMENT}")
    parser.add_argument("--resume", action="store_true", help="go on with the sweep that stands there, if any")
    parser.add_argument(
        "--workers", type=positive_number, help="processes (default: one a core); the results do not depend on it"
    )
    parser.add_argument("--address", help="run on Ray: auto, ray://host:port, or local for a node of this machine")
    parser.add_argument("--redraw", action="store_true", help="only write tables and figures of DIR/results.csv again")
    parser.add_argument("--json", action="store_true", help="one JSON object a cell, and the summary last")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a cell failed; the others are done then."""
    from foretouch.experiments import EXPERIMENTS, find_experiment

    if arguments.name == "list":
        return _list([find_experiment(name) for name in EXPERIMENTS], arguments.json)
    experiment = find_experiment(arguments.name)
    if arguments.out is None:
        raise ConfigError("experiment: -o DIR is needed")
    if arguments.redraw:
        return _redraw(experiment, arguments)
    return _sweep(experiment, arguments)


def _list(experiments: Sequence[Experiment[Any, Any]], as_json: bool) -> int:
    records = [{"name": one.name, "question": one.question, "presets": list(one.presets)} for one in experiments]
    if as_json:
        for record in records:
            print_json(record)
    else:
        rows = [[str(r["name"]), str(r["question"]), ", ".join(r["presets"])] for r in records]
        print_table("experiments", ["name", "question", "presets"], rows)
    return 0


def _redraw(experiment: Experiment[Any, Any], arguments: argparse.Namespace) -> int:
    from foretouch.experiments.framework.manifest import RESULTS_FILE, SUMMARY_FILE, read_results, require_experiment

    require_experiment(arguments.out, experiment.name)
    rows = read_results(arguments.out / RESULTS_FILE)
    if not rows:
        raise FileError(arguments.out / RESULTS_FILE, "holds no row: no cell has finished")
    figures = _report(experiment, rows, arguments.out)
    if arguments.json:
        print_json({"status": "done", "figures": figures})
    else:
        print(f"drawn: {', '.join([SUMMARY_FILE, *figures])}")
    return 0


def _report(experiment: Experiment[Any, Any], rows: Sequence[dict[str, Any]], out: Path) -> list[str]:
    """Write tables and figures of the results; names of the figures."""
    from foretouch.experiments.framework.figures import draw_figures
    from foretouch.experiments.framework.manifest import SUMMARY_FILE
    from foretouch.experiments.framework.tables import markdown

    if not rows:
        return []
    (out / SUMMARY_FILE).write_text(markdown(experiment.question, experiment.summarise(rows)), encoding="utf-8")
    return [path.name for path in draw_figures(experiment.name, rows, out)]


def _sweep(experiment: Experiment[Any, Any], arguments: argparse.Namespace) -> int:
    from foretouch.experiments import run_sweep

    settings = experiment.resolve(arguments.preset, parse_overrides(arguments.overrides))
    with _progress(arguments.json) as tell:
        result = run_sweep(
            experiment,
            settings,
            arguments.out,
            preset=arguments.preset,
            source=_source(experiment, arguments.data),
            resume=arguments.resume,
            workers=arguments.workers or len(os.sched_getaffinity(0)),
            address=arguments.address,
            tell=tell,
        )
    summary = {
        "status": "failed" if result.failures else "done",
        "experiment": experiment.name,
        "cells": result.cells,
        "reused": result.reused,
        "failed": result.failures,
        "rows": len(result.rows),
        "figures": _report(experiment, result.rows, arguments.out),
        "data_sha256": result.data_sha256,
        "path": str(arguments.out),
    }
    if arguments.json:
        print_json(summary)
    else:
        _show(experiment, result.rows, summary)
    for key, error in result.failures.items():
        warn(f"{key}: {error}")
    return 1 if result.failures else 0


def _source(experiment: Experiment[Any, Any], given: Path | None) -> Path | None:
    folder = os.environ.get(_ENVIRONMENT)
    if given is None and folder and experiment.data_folder is not None:
        return Path(folder) / experiment.data_folder
    return given


def _show(experiment: Experiment[Any, Any], rows: Sequence[dict[str, Any]], summary: dict[str, Any]) -> None:
    print(experiment.question)
    for table in experiment.summarise(rows) if rows else ():
        print_table(table.title, list(table.columns), [list(row) for row in table.rows])
        for note in table.notes:
            print(f"  {note}")
    failed = f", {len(summary['failed'])} failed" if summary["failed"] else ""
    print(f"{summary['cells']} cells ({summary['reused']} from before{failed}); {summary['path']}/results.csv", end="")
    print("".join(f", {name}" for name in summary["figures"]))


@contextmanager
def _progress(as_json: bool) -> Iterator[Callable[[Outcome, int, int], None]]:
    """A bar with the time left, where stderr is a terminal; with --json a line a cell on stdout."""
    if as_json:
        yield _tell_json
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading the data", total=None)

        def tell(outcome: Outcome, done: int, total: int) -> None:
            bar.update(task, total=total, completed=done, description=outcome.cell.key)

        try:
            yield tell
        except ForetouchError:
            bar.live.transient = True  # what was wrong is told in one line
            raise


def _tell_json(outcome: Outcome, done: int, total: int) -> None:
    record = {"cell": outcome.cell.key, "status": "failed" if outcome.rows is None else "done", "error": outcome.error}
    print_json({**record, "seconds": round(outcome.seconds, 3), "done": done, "cells": total})
    print(end="", flush=True)
