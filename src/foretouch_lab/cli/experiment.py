# SPDX-License-Identifier: Apache-2.0
"""`foretouch experiment`: run an experiment and write its table and figures, or resume an interrupted one."""

import argparse
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from foretouch.cli.inputs import ADDRESS_HELP, positive_number
from foretouch.cli.output import print_json, print_table, print_text, progress_bar, warn
from foretouch.cli.parser import CommandParser
from foretouch.config import parse_overrides
from foretouch.errors import ConfigError, FileError
from foretouch_lab.experiments import Experiment, Sweep, find_experiment, list_experiments
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.manifest import SUMMARY_FILE, read_results, require_experiment, write_summary

ENVIRONMENT = "FORETOUCH_DATA"


def add_arguments(parser: CommandParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        "name",
        metavar="NAME",
        help="name of an experiment, such as prequential; `list` prints all; or a module of your own, such as my_lab.stiffness",
    )
    add_sweep_arguments(parser, "full", "full (default), smoke, or another preset of the experiment")


def add_sweep_arguments(parser: CommandParser, preset: str, presets: str) -> None:
    """Declare the arguments on settings, data and output of a sweep, with the default preset and the help on presets."""
    parser.add_argument(
        "overrides", metavar="key=value", nargs="*", default=[], help="settings that differ from the preset"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of manifest, table and figures; required except for `list`",
    )
    parser.add_argument("--preset", default=preset, help=presets)
    parser.add_argument(
        "--data",
        type=Path,
        metavar="PATH",
        help=f"path of the data (default: the experiment's folder in {ENVIRONMENT})",
    )
    parser.add_argument("--resume", action="store_true", help="continue the sweep in DIR, if there is one")
    parser.add_argument(
        "--workers",
        type=positive_number,
        metavar="N",
        help="number of processes (default: one per core); does not change the results",
    )
    parser.add_argument("--address", help=ADDRESS_HELP)
    parser.add_argument("--redraw", action="store_true", help="only rewrite tables and figures from the table in DIR")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a cell failed."""
    if arguments.name == "list":
        return print_list(
            "experiments", {experiment.name: experiment for experiment in list_experiments()}, as_json=arguments.json
        )
    return run_experiment(find_experiment(arguments.name), arguments)


def print_list(title: str, experiments: Mapping[str, Experiment], *, as_json: bool) -> int:
    """Print names, questions and presets of experiments; exit status 0."""
    if as_json:
        for name, experiment in experiments.items():
            print_json({"name": name, "question": experiment.question, "presets": list(experiment.presets)})
    else:
        rows = [[name, experiment.question, ", ".join(experiment.presets)] for name, experiment in experiments.items()]
        print_table(title, ["name", "question", "presets"], rows)
    return 0


def data_source(experiment: Experiment, arguments: argparse.Namespace) -> Path | None:
    """Return --data, or the experiment's folder in `FORETOUCH_DATA`; None without either, or if it goes without a folder that is absent."""
    folder = os.environ.get(ENVIRONMENT)
    if arguments.data is None and folder and experiment.data_folder is not None:
        default = Path(folder) / experiment.data_folder
        return None if experiment.goes_without and not default.exists() else default
    given: Path | None = arguments.data
    return given


def run_experiment(experiment: Experiment, arguments: argparse.Namespace) -> int:
    """Run, resume or redraw an experiment; the exit status is 1 if a cell failed."""
    if arguments.out is None:
        raise ConfigError(f"{arguments.command}: -o DIR is required")
    if arguments.redraw:
        return _redraw(experiment, arguments)
    settings = experiment.resolve(arguments.preset, parse_overrides(arguments.overrides))
    source = data_source(experiment, arguments)
    with progress_bar("reading the data", hidden=arguments.json) as update:
        sweep = Sweep(
            experiment, settings, arguments.out, preset=arguments.preset, source=source, resume=arguments.resume
        )
        workers = arguments.workers or len(os.sched_getaffinity(0))
        show = _print_cell if arguments.json else lambda key, _seconds, _error, *counts: update(*counts, key)
        sweep.run(workers, arguments.address, show)
        sweep.finish(partial(update, description="times"))
    summary = {
        "status": "failed" if sweep.failures else "done",
        "experiment": experiment.name,
        **experiment.facts(sweep.rows),
        "cells": len(sweep.cells),
        "reused": sweep.reused,
        "finished": sweep.finished,
        "failed": sweep.failures,
        "rows": len(sweep.rows),
        "figures": _report(experiment, sweep.rows, arguments.out, sweep.origin(arguments.data)) if sweep.rows else [],
        "data_sha256": sweep.data_sha256,
        "path": str(arguments.out),
    }
    if arguments.json:
        print_json(summary)
    else:
        if arguments.preset == "smoke":
            print_text(
                "smoke: a quick trial with smaller settings; its numbers, also of baselines, are not those of the preset full"
            )
        _show(experiment, sweep.rows, summary)
    for key, error in sweep.failures.items():
        warn(f"{key}: {error}")
    return 1 if sweep.failures else 0


def _redraw(experiment: Experiment, arguments: argparse.Namespace) -> int:
    """Write summary and figures of the table in a folder."""
    require_experiment(arguments.out, experiment.name)
    file = arguments.out / experiment.results
    rows = read_results(file)
    if not rows:
        raise FileError(file, "contains no row: no cell has finished")
    try:
        figures = _report(experiment, rows, arguments.out)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ZeroDivisionError) as err:
        raise FileError(file, f"is not a table of {experiment.name}: {type(err).__name__}: {err}") from err
    if arguments.json:
        print_json({"status": "done", "figures": figures})
    else:
        print(f"drawn: {', '.join([SUMMARY_FILE, *figures])}")
    return 0


def _report(experiment: Experiment, rows: Sequence[Row], out: Path, origin: Sequence[str] | None = None) -> list[str]:
    """Write tables and figures of the results; returns the names of the figures."""
    write_summary(out, experiment, experiment.tables(rows), origin)
    return [path.name for path in experiment.draw(rows, out)]


def _show(experiment: Experiment, rows: Sequence[dict[str, Any]], summary: dict[str, Any]) -> None:
    print_text(experiment.question)
    for table in experiment.tables(rows):
        print_table(table.title, list(table.columns), [list(row) for row in table.rows])
        for note in table.notes:
            print_text(f"  {note}")
    failed = f", {len(summary['failed'])} failed" if summary["failed"] else ""
    cells = "" if summary["finished"] == summary["cells"] else f"{summary['finished']} of "
    written = ", ".join([f"{summary['path']}/{experiment.results}", *summary["figures"]])
    print(f"{cells}{summary['cells']} cells ({summary['reused']} reused{failed}); {written}")


def _print_cell(key: str, seconds: float, error: str, done: int, total: int) -> None:
    """Print a finished cell as a JSON object."""
    record = {"cell": key, "status": "failed" if error else "done", "error": error}
    print_json({**record, "seconds": round(seconds, 3), "done": done, "cells": total})
