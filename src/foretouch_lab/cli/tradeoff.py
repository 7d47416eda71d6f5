# SPDX-License-Identifier: Apache-2.0
"""`foretouch tradeoff AREA`: measure skill and time of many settings, and name those on the frontier."""

import argparse

from foretouch.cli.output import print_json, print_table, progress_bar, warn
from foretouch.models.registry import load_model
from foretouch_lab.cli.experiment import add_sweep_arguments, print_list, run_experiment
from foretouch_lab.experiments.framework.tradeoff import find_area, list_areas


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "area",
        metavar="AREA",
        help="model, or another area; `list` prints all; `profile` measures how long predictions take here, for latency budgets",
    )
    add_sweep_arguments(parser, "small", "small (default): within 3 minutes, trains no network; full: all settings")
    parser.add_argument(
        "--model", default="default", help="of `profile`: name or path of the model (default: contact-v2)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a skill could not be measured."""
    if arguments.area == "list":
        return print_list("areas", {area.area: area for area in list_areas()}, as_json=arguments.json)
    if arguments.area == "profile":
        return _profile(arguments)
    return run_experiment(find_area(arguments.area), arguments)


def _profile(arguments: argparse.Namespace) -> int:
    from foretouch.models.budget import levels_of, load_profile

    levels = levels_of(load_model(arguments.model))
    with progress_bar("times", hidden=arguments.json) as update:
        profile = load_profile(levels, seconds=30.0, again=True, say=warn, progress=update)
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
