# SPDX-License-Identifier: Apache-2.0
"""`foretouch sensor`: list, check and draw descriptions of tactile sensors."""

import argparse
from pathlib import Path
from typing import Any

from foretouch.cli.descriptions import Descriptions
from foretouch.cli.output import print_json, print_table
from foretouch.cli.parser import CommandParser
from foretouch.tactile.description import load_sensor, sensor_files


def add_arguments(parser: CommandParser) -> None:
    """Add an action for each thing to do with a description."""
    about = "dataset to compare the description with: ranges, noise, drift, rate, and taxels that failed"
    _SENSORS.add_arguments(parser).add_argument("--against", type=Path, metavar="DS", help=about)


def run(arguments: argparse.Namespace) -> int:
    """Run an action; the exit status is 1 if a description breaks a rule."""
    if arguments.action == "check" and arguments.against is not None:
        return _compare(arguments)
    return _SENSORS.run(arguments)


def _compare(arguments: argparse.Namespace) -> int:
    """Print what a recording shows of each modality, and the corrections that follow."""
    from foretouch.dataset.sensor_check import compare_sensor

    for name in arguments.descriptions:
        comparison = compare_sensor(load_sensor(name), arguments.against)
        if arguments.json:
            print_json({"input": name, "against": str(arguments.against), **comparison})
            continue
        modalities = comparison["modalities"]
        columns = [key.replace("_", " ") for key in next(iter(modalities.values()))]
        rows = [
            [key, *("" if cell in (None, []) else str(cell) for cell in row.values())]
            for key, row in modalities.items()
        ]
        print_table(
            f"{name}: {comparison['readings']} readings of {comparison['grasps']} grasps", ["modality", *columns], rows
        )
        print_table("corrections", ["setting", "stated", "recorded"], comparison["corrections"])
    return 0


def _facts(name: str) -> dict[str, Any]:
    sensor = load_sensor(name)
    config = sensor.config
    return {
        "name": config.name,
        "summary": config.summary,
        "sha256": sensor.sha256,
        "type": config.source.type,
        "fingers": [finger.name for finger in config.fingers],
        "taxels": sensor.size,
        "dead": {finger.name: list(finger.dead) for finger in config.fingers if finger.dead},
        "values": [{"name": value.name, "unit": value.unit} for value in config.values],
        "scalars": [{"name": scalar.name, "unit": scalar.unit} for scalar in config.scalars],
    }


def _row(record: dict[str, Any]) -> list[str]:
    values = ", ".join(f"{value['name']} [{value['unit']}]" for value in record["values"])
    return [record["name"], ", ".join(record["fingers"]), str(record["taxels"]), values, record["summary"]]


def _save_figure(name: str, path: Path) -> None:
    from foretouch.report.sensor_figure import save_sensor_figure

    save_sensor_figure(load_sensor(name), path)


_SENSORS = Descriptions(
    name="sensor",
    show="Draw the taxels of a sensor with their normals",
    title="Tactile sensors",
    columns=["sensor", "fingers", "taxels", "values of a taxel", "what it is"],
    files=sensor_files,
    facts=_facts,
    row=_row,
    save_figure=_save_figure,
)
