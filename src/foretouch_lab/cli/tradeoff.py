# SPDX-License-Identifier: Apache-2.0
"""`foretouch tradeoff AREA`: measure skill and time of many settings, and name those on the frontier."""

import argparse
from copy import copy
from functools import partial
from pathlib import Path

from foretouch.cli.output import print_json, print_table, print_text, progress_bar, warn
from foretouch.cli.parser import CommandParser
from foretouch.config import parse_overrides
from foretouch.errors import ConfigError, FileError
from foretouch_lab.cli.experiment import add_sweep_arguments, data_source, print_list, run_experiment
from foretouch_lab.experiments.framework.manifest import MANIFEST_FILE, read_results
from foretouch_lab.experiments.framework.tradeoff import Area, find_area, list_areas, measure_here

_ALL = "all"


def add_arguments(parser: CommandParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        "area", metavar="AREA", help="chain, or another area; `list` prints all; `all` measures one after the other"
    )
    add_sweep_arguments(
        parser, "small", "small (default): minutes, trains no network; full: all settings; smoke: a try of the command"
    )
    parser.add_argument(
        "--here",
        type=Path,
        metavar="DIR",
        help="only time, on this machine, what is on the frontier of the table in DIR, such as docs/results/tradeoff/chain (default: measure skills, too)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a skill could not be measured."""
    if arguments.area == "list":
        return print_list("areas", {area.area: area for area in list_areas()}, as_json=arguments.json)
    if arguments.area == _ALL:
        return _run_all(arguments)
    return _run_one(find_area(arguments.area), arguments)


def _run_one(area: Area, arguments: argparse.Namespace) -> int:
    return run_experiment(area, arguments) if arguments.here is None else _run_here(area, arguments)


def _run_all(arguments: argparse.Namespace) -> int:
    """Run all areas, with folders of their names; with --resume those that have a table are left as they are."""
    if (arguments.out is None) == (arguments.here is None) or arguments.data is not None or arguments.overrides:
        raise ConfigError(f"tradeoff {_ALL}: takes -o DIR or --here DIR, and neither --data nor settings")
    status, areas = 0, list_areas()
    for number, area in enumerate(areas, 1):
        own = copy(arguments)
        if own.here is not None:
            own.here = arguments.here / area.area
            _run_here(area, own)
            continue
        own.out = arguments.out / area.area
        if arguments.resume and (own.out / area.results).is_file() and not arguments.redraw:
            warn(f"{area.area}: measured before")
            continue
        warn(f"{area.area}: {number} of {len(areas)} areas")
        own.resume = arguments.resume and (own.out / MANIFEST_FILE).is_file()
        status = max(status, run_experiment(area, own))
    return status


def _run_here(area: Area, arguments: argparse.Namespace) -> int:
    """Print the times of the frontier of a table beside those of this machine."""
    rows = read_results(arguments.here / area.results)
    if not rows or "yardstick_ms" not in rows[0]:
        raise FileError(arguments.here / area.results, f"is not a table of {area.command}")
    settings = area.resolve(arguments.preset, parse_overrides(arguments.overrides))
    with progress_bar("reading the data", hidden=arguments.json) as update:
        data = area.load(settings, area.prepare(settings, data_source(area, arguments), arguments.here))
        table = measure_here(area, settings, data, rows, partial(update, description="times"))
    if arguments.json:
        print_json({"area": area.area, "columns": list(table.columns), "rows": table.rows, "notes": list(table.notes)})
        return 0
    print_table(table.title, list(table.columns), [list(row) for row in table.rows])
    for note in table.notes:
        print_text(note)
    return 0
