# SPDX-License-Identifier: Apache-2.0
"""`foretouch tradeoff AREA`: measure skill and time of many settings, and name those on the frontier."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.cli.experiment import ENVIRONMENT, data_source, print_cell
from foretouch.cli.inputs import positive_number
from foretouch.cli.output import print_json, print_table, print_text, progress_bar, warn
from foretouch.config import parse_overrides
from foretouch.errors import ConfigError

if TYPE_CHECKING:
    from foretouch.experiments.framework.executors import CellResult
    from foretouch.tradeoff.area import Area
    from foretouch.tradeoff.run import TradeoffResult

_PROFILE_S = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "area",
        metavar="AREA",
        help="model, or another area; `list` prints all; `profile` measures how long predictions take here, for latency budgets",
    )
    parser.add_argument("overrides", metavar="key=value", nargs="*", help="settings that differ from the preset")
    parser.add_argument("-o", "--out", type=Path, metavar="DIR", help="output folder of table, picture and summary")
    parser.add_argument(
        "--preset", default="small", help="small (default): within 3 minutes, trains no network; full: all settings"
    )
    parser.add_argument(
        "--data", type=Path, metavar="PATH", help=f"path of the data (default: the area's folder in {ENVIRONMENT})"
    )
    parser.add_argument(
        "--resume", action="store_true", help="keep the finished skills in DIR; times are measured again"
    )
    parser.add_argument(
        "--times", action="store_true", help="measure times alone again; skills are those of DIR/results.csv"
    )
    parser.add_argument(
        "--workers", type=positive_number, help="number of processes that measure skills (default: one per core)"
    )
    parser.add_argument("--redraw", action="store_true", help="only rewrite picture and summary from DIR/tradeoff.csv")
    parser.add_argument("--model", default="default", help="of `profile`: name or path of the model")
    parser.add_argument("--json", action="store_true", help="print one JSON object per measured skill, and a summary")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a skill could not be measured."""
    from foretouch.tradeoff.area import area_names, find_area

    if arguments.area == "list":
        return _list([find_area(name) for name in area_names()], as_json=arguments.json)
    if arguments.area == "profile":
        return _profile(arguments)
    area = find_area(arguments.area)
    if arguments.out is None:
        raise ConfigError("tradeoff: -o DIR is required")
    if arguments.redraw:
        from foretouch.tradeoff.run import report

        figures = report(area, arguments.out)
        if arguments.json:
            print_json({"status": "done", "figures": figures})
        else:
            print(f"drawn: {', '.join(['summary.md', *figures])}")
        return 0
    return _measure(area, arguments)


def _list(areas: list[Area[Any, Any]], *, as_json: bool) -> int:
    if as_json:
        for area in areas:
            print_json({"name": area.name, "question": area.question, "presets": list(area.presets)})
    else:
        print_table("areas", ["name", "question"], [[area.name, area.question] for area in areas])
    return 0


def _profile(arguments: argparse.Namespace) -> int:
    from foretouch.models.budget import levels_of, load_profile
    from foretouch.models.registry import load_model

    levels = levels_of(load_model(arguments.model))
    with progress_bar("times", hidden=arguments.json) as update:
        profile = load_profile(levels, seconds=_PROFILE_S, again=True, say=warn, progress=update)
    if arguments.json:
        found = {level.name: {"skill": level.skill, "p95_s": profile.times[level.name]} for level in levels}
        print_json({"status": "done", "levels": found, "state": profile.state, "path": profile.origin})
        return 0
    counts = list(profile.times[levels[0].name])
    rows = [
        [level.name, "?" if level.skill is None else f"{level.skill:.3f}",
         *(f"{times[count] * 1e3:.3g}" if count in (times := profile.times[level.name]) else "" for count in counts)]
        for level in levels
    ]  # fmt: skip
    columns = ["level", "skill, blocks of time", *(f"{count} grasps, p95 [ms]" for count in counts)]
    print_table(f"levels of {levels[0].model.name} on this machine, which was {profile.state}", columns, rows)
    print(profile.origin)
    return 0


def _measure(area: Area[Any, Any], arguments: argparse.Namespace) -> int:
    from foretouch.tradeoff.run import estimate_seconds, run_tradeoff

    settings = area.resolve(arguments.preset, parse_overrides(arguments.overrides))
    workers = arguments.workers or len(os.sched_getaffinity(0))
    source = data_source(area, arguments.data)
    read = None
    if arguments.preset != "small" and not arguments.times:
        read = area.read(settings, source, arguments.out)
        minutes = estimate_seconds(area, settings, arguments.out, read.values, workers) / 60.0
        print(f"about {minutes:.0f} minutes with {workers} processes", file=sys.stderr)
    with progress_bar("reading the data", hidden=arguments.json) as update:

        def show(result: CellResult, done: int, total: int) -> None:
            update(done, total, f"skill: {result.cell.key}")

        result = run_tradeoff(
            area,
            settings,
            arguments.out,
            preset=arguments.preset,
            source=source,
            resume=arguments.resume,
            times_only=arguments.times,
            workers=workers,
            progress=print_cell if arguments.json else show,
            timing_progress=lambda done, total: update(done, total, "times"),
            read=read,
        )
    _show(area, result, arguments)
    for key, error in result.failures.items():
        warn(f"{key}: {error}")
    return 1 if result.failures else 0


def _show(area: Area[Any, Any], result: TradeoffResult, arguments: argparse.Namespace) -> None:
    from foretouch.tradeoff.frontier import frontier, of_request, summary_tables

    if arguments.json:
        lines = {
            panel.title: [row["variant"] for row in frontier(of_request(result.rows, panel.request), panel.skill)]
            for panel in area.panels
        }
        print_json({
            "status": "failed" if result.failures else "done",
            "area": area.name,
            "cells": result.cells,
            "reused": result.reused,
            "failed": result.failures,
            "skipped": result.skipped,
            "rows": len(result.rows),
            "frontier": lines,
            "figures": result.figures,
            "path": str(arguments.out),
        })  # fmt: skip
        return
    for table in summary_tables(area, result.rows, result.skipped):
        print_table(table.title, list(table.columns), [list(row) for row in table.rows])
        for note in table.notes:
            print_text(f"  {note}")
    print(f"{arguments.out}/tradeoff.csv, {', '.join(result.figures)}")
