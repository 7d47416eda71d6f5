# SPDX-License-Identifier: Apache-2.0
"""`foretouch sensor`: list, check and draw descriptions of tactile sensors."""

import argparse
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.cli.descriptions import Descriptions
from foretouch.cli.output import print_json, print_table
from foretouch.cli.parser import CommandParser
from foretouch.dataset.formats import open_samples
from foretouch.errors import TactileError
from foretouch.tactile.dead_taxels import dead_taxels
from foretouch.tactile.description import Sensor, load_sensor, sensor_files
from foretouch.types import REST, SECOND_NS, Bool, Float64, Index, TouchSeries

_STILL: Final = 20  # readings without change, through which a working taxel shows its noise
_SATURATED: Final = 0.01  # of a taxel's readings at an end of its range


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
    from foretouch.report.finger_figure import save_sensor_figure

    save_sensor_figure(load_sensor(name), path)


class _Tally:
    """What the readings of a sensor of D values show: rows for the grasps, or sums over them."""

    def __init__(self, sensor: Sensor) -> None:
        channels = sensor.channels
        limits = [channel.saturation or channel.limits for channel, _ in sensor.predicted for _ in channels.fingers]
        self._channels, (self._bottom, self._top) = channels, channels.by_modality(limits).T
        self.still, self.ends, self.outside = np.zeros((3, channels.size), np.int64)
        self.grasps = self.readings = self.repeated = 0
        self.levels, self.steps, self.noise, self.rests = (list[Float64]() for _ in range(4))

    def add(self, series: TouchSeries) -> None:
        """Add the readings of a grasp."""
        values = series.counts.astype(np.float64)
        self.grasps, self.readings = self.grasps + 1, self.readings + len(values)
        self.levels += [values.min(axis=0), np.median(values, axis=0), values.max(axis=0)]
        self.outside += ((values < self._channels.low) | (values > self._channels.high)).sum(axis=0)
        self.ends += ((values <= self._bottom) | (values >= self._top)).sum(axis=0)
        self.still += (np.ptp(values, axis=0) == 0.0) & (len(values) >= _STILL)
        self.repeated += int((np.diff(values, axis=0) == 0.0).all(axis=1).sum())
        self.steps.append(np.diff(series.stamps_ns) / SECOND_NS)
        if len(rest := values[series.phases == REST]) > 1:
            self.noise.append(rest.var(axis=0, ddof=1))
            self.rests.append(np.median(rest, axis=0))

    def modality(self, columns: Index, dead: Bool) -> dict[str, Any]:
        """Return the row of one modality, by which of its values are of dead taxels."""
        levels = np.array(self.levels)[:, columns]
        calm = np.sort(self.noise, axis=0)[: max(1, int(0.9 * len(self.noise)))]  # a tenth was least at rest
        drift = np.abs(np.diff(self.rests, axis=0)) if self.rests[1:] else None
        return {
            "range": [float(levels.min()), float(levels.max())],
            "outside": int(self.outside[columns].sum()),
            "noise": _median(np.sqrt(calm.mean(axis=0))[columns]) if self.noise else None,
            "drift": None if drift is None else _median(np.median(drift, axis=0)[columns]),
            "saturated": np.flatnonzero(self.ends[columns] > _SATURATED * self.readings).tolist(),
            "dead": np.flatnonzero(dead).tolist(),
            "stuck": np.flatnonzero(~dead & (self.still[columns] > 0)).tolist(),
        }


def compare_sensor(sensor: Sensor, path: Path) -> dict[str, Any]:
    """Measure ranges, noise, drift, rate and failed taxels of a dataset beside what a description states, in plain types.

    Training masks dead taxels (see `foretouch.tactile.dead_taxels`). A stuck taxel did not change during at least one grasp.
    Noise is the standard deviation at rest. Drift is the change of the rest level from one grasp to the next. Both are medians over taxels.
    `corrections` lists setting, stated and recorded value.

    Raises:
        FileError: If there is no dataset.
        TactileError: If its readings have another number of values, or it holds none.
    """
    tally, channels = _Tally(sensor), sensor.channels
    for sample in open_samples(path):
        if (series := sample.readings) is not None and len(series.counts):
            if series.counts.shape[1] != channels.size:
                rule = f"{series.counts.shape[1]} values in a reading, and {channels.size} of {channels.sensor}"
                raise TactileError(f"{path}: {sample.id}: {rule}")
            tally.add(series)
    if not tally.grasps:
        raise TactileError(f"{path}: holds no readings")
    step = float(np.median(np.concatenate(tally.steps))) if any(map(len, tally.steps)) else 0.0
    rate_hz = 1.0 / step if step > 0.0 else None
    dead, failed = dead_taxels(sensor, np.array(tally.levels)), np.zeros(channels.size, np.bool_)
    failed[sensor.taxel_columns[dead]] = True
    modalities = {name: tally.modality(columns, failed[columns]) for name, columns in channels.modality_columns.items()}
    return {
        "grasps": tally.grasps,
        "readings": tally.readings,
        "rate_hz": rate_hz,
        "repeated": tally.repeated / max(1, tally.readings - tally.grasps),
        "modalities": modalities,
        "corrections": _corrections(sensor, dead, rate_hz, modalities),
    }


def _corrections(sensor: Sensor, dead: Bool, rate_hz: float | None, modalities: dict[str, Any]) -> list[list[str]]:
    rows, config = [], sensor.config
    if rate_hz is not None and abs(rate_hz / config.update_rate - 1.0) > 0.05:
        rows.append(["update_rate", f"{config.update_rate:g}", f"{rate_hz:.3g}"])
    for channel, _ in sensor.predicted:
        parts = [modalities[f"{channel.name}_{finger}"] for finger in sensor.channels.fingers]
        if any(part["outside"] for part in parts):
            ends = [min(part["range"][0] for part in parts), max(part["range"][1] for part in parts)]
            rows.append([f"{channel.name}: range", str(list(channel.limits)), str(ends)])
        noises = [part["noise"] for part in parts if part["noise"] is not None]
        if noises and not (channel.noise and 0.5 < np.median(noises) / channel.noise < 2.0):
            rows.append(
                [
                    f"{channel.name}: noise",
                    "none" if channel.noise is None else f"{channel.noise:g}",
                    f"{np.median(noises):.3g}",
                ]
            )
    for finger, failed in zip(config.chosen_fingers(), dead, strict=True):
        if (recorded := np.flatnonzero(failed).tolist()) != sorted(finger.dead):
            rows.append([f"{finger.name}: dead", str(list(finger.dead)), str(recorded)])
    return rows


def _median(values: Float64) -> float:
    return float(f"{np.median(values):.3g}")


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
