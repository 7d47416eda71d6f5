# SPDX-License-Identifier: Apache-2.0
"""`foretouch sensor`: list, check and draw descriptions of tactile sensors."""

import argparse
from pathlib import Path
from typing import Any

from foretouch.cli.inputs import error_line
from foretouch.cli.output import print_json, print_table, warn
from foretouch.cli.parser import CommandParser
from foretouch.errors import ForetouchError
from foretouch.files import PICTURE_SUFFIXES, require_writable
from foretouch.tactile.description import load_sensor, sensor_files


def add_arguments(parser: CommandParser) -> None:
    """One action each."""
    for name, summary, count in (
        ("list", "List the sensors of the package", 0),
        ("check", "Check descriptions of sensors", "+"),
        ("show", "Draw the taxels of a sensor with their normals", 1),
    ):
        action = parser.add_command(name, summary)
        action.add_json()
        if count:
            about = "YAML file, or the name of a sensor of the package"
            action.add_argument("sensors", metavar="SENSOR", nargs=count, help=about)
        if name == "check":
            about = "dataset to compare the description with: ranges, noise, drift, rate, and taxels that failed"
            action.add_argument("--against", type=Path, metavar="DS", help=about)
        if name == "show":
            action.add_argument("-o", "--out", type=Path, required=True, metavar="F.png", help="image file")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a description breaks a rule."""
    if arguments.action == "show":
        from foretouch.report.sensor_figure import save_sensor_figure

        require_writable(arguments.out, *PICTURE_SUFFIXES)
        save_sensor_figure(load_sensor(arguments.sensors[0]), arguments.out)
    if arguments.action == "check" and arguments.against is not None:
        return _compare(arguments)
    records = [_record(name) for name in (sensor_files() if arguments.action == "list" else arguments.sensors)]
    found = [record for record in records if record["status"] == "ok"]
    for record in records if arguments.json else ():
        print_json(record)
    if found and not arguments.json:
        columns = ["sensor", "fingers", "taxels", "values of a taxel", "what it is"]
        print_table("Tactile sensors", columns, [_row(record) for record in found])
    for record in records:
        if record["status"] != "ok":
            warn(record["reason"])
    return int(len(found) < len(records))


def _compare(arguments: argparse.Namespace) -> int:
    """Print what a recording shows of each modality, and the corrections that follow."""
    from foretouch.dataset.sensor_check import compare_sensor

    for name in arguments.sensors:
        found = compare_sensor(load_sensor(name), arguments.against)
        if arguments.json:
            print_json({"input": name, "against": str(arguments.against), **found})
            continue
        modalities = found["modalities"]
        columns = [key.replace("_", " ") for key in next(iter(modalities.values()))]
        rows = [
            [key, *("" if one in (None, []) else str(one) for one in row.values())] for key, row in modalities.items()
        ]
        print_table(f"{name}: {found['readings']} readings of {found['grasps']} grasps", ["modality", *columns], rows)
        print_table("corrections", ["setting", "stated", "recorded"], found["corrections"])
    return 0


def _record(name: str) -> dict[str, Any]:
    """The JSON object of a sensor."""
    try:
        sensor = load_sensor(name)
    except ForetouchError as err:
        return {"input": name, "status": "refused", "reason": error_line(name, err)}
    config = sensor.config
    return {
        "input": name,
        "status": "ok",
        "name": config.name,
        "summary": config.summary,
        "sha256": sensor.sha256,
        "type": config.source.type,
        "fingers": [finger.name for finger in config.fingers],
        "taxels": sensor.size,
        "dead": {finger.name: list(finger.dead) for finger in config.fingers if finger.dead},
        "values": [{"name": one.name, "unit": one.unit} for one in config.values],
        "scalars": [{"name": one.name, "unit": one.unit} for one in config.scalars],
    }


def _row(record: dict[str, Any]) -> list[str]:
    values = ", ".join(f"{one['name']} [{one['unit']}]" for one in record["values"])
    return [record["name"], ", ".join(record["fingers"]), str(record["taxels"]), values, record["summary"]]
