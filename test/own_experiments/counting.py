# SPDX-License-Identifier: Apache-2.0
"""An experiment of someone's own whose cells can be slow, fail, or be killed, and leave a trace of each start."""

from __future__ import annotations

import hashlib
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import DatasetError
from foretouch_lab.experiments import Cell, Experiment, Row, Table


@dataclass(frozen=True, kw_only=True)
class CountingSettings(Settings):
    cells: int = setting(6, "Number of cells", minimum=1)
    pause_s: float = setting(0.0, "Time that each takes", minimum=0.0)
    broken: tuple[int, ...] = setting((), "Cells that refuse")
    dies: tuple[int, ...] = setting((), "Cells whose process is killed each time")
    dies_once: tuple[int, ...] = setting((), "Cells whose process is killed the first time")
    shown: int = setting(100, "Rows of the table", minimum=0)
    trace: str = setting("", "Folder that gets a file a start")


@dataclass(frozen=True)
class Numbers:
    values: tuple[float, ...]
    sha256: str


def load(settings: CountingSettings, path: Path) -> Numbers:
    content = path.read_bytes()
    return Numbers(tuple(map(float, content.split())), hashlib.sha256(content).hexdigest())


def run(cell: Cell, settings: CountingSettings, data: Numbers) -> list[Row]:
    number = cell.values["number"]
    starts = 0
    if settings.trace:
        starts = len(list(Path(settings.trace).glob(f"{number}.*")))
        Path(settings.trace, f"{number}.{starts}").touch()
    if number in settings.dies or (number in settings.dies_once and starts == 0):
        os.kill(os.getpid(), signal.SIGKILL)
    if number in settings.broken:
        raise DatasetError(f"cell {number}: is broken")
    time.sleep(settings.pause_s)
    noise = np.random.default_rng(number).normal(size=(40, 40))
    return [{"value": float(np.linalg.svd(noise)[1].sum()) * value} for value in data.values]


EXPERIMENT = Experiment(
    name="counting",
    question="How far can one count?",
    module=__name__,
    settings=CountingSettings,
    presets={"full": {}, "smoke": {"cells": 2}},
    load=load,
    cells=lambda settings, data: [Cell(f"cell{k}", {"number": k}) for k in range(settings.cells)],
    run=run,
    tabulate=lambda settings, rows: [
        {"number": row["number"], "value": row["value"], "empty": None} for row in rows[: settings.shown]
    ],
    summarise=lambda rows: [Table("counted", ["number"], [[str(row["number"])] for row in rows])],
    resumable_settings=("cells", "shown"),
)
