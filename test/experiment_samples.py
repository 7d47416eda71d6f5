# SPDX-License-Identifier: Apache-2.0
"""Made-up grasps whose labels follow from object, time and place of the grasp."""

import json
from typing import Any

import numpy as np

from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Grasp, Sample
from foretouch_lab.experiments import Row, find_experiment
from foretouch_lab.learning.data import Dataset

_ALONG_X = np.eye(3)[:, [1, 2, 0]]  # Z, the third column, runs from g2 to g1
OBJECTS = ("campbells", "cheezit", "coffee", "pringles", "rugby", "spam", "train", "wood")


def make_samples(objects: int = 8, each: int = 12, seed: int = 0) -> list[Sample]:
    """Ordered by object and time."""
    rng = np.random.default_rng(seed)
    return [_sample(rng, OBJECTS[k], k, number) for k in range(objects) for number in range(each)]


def make_collection(objects: int = 8, each: int = 12) -> Dataset:
    """The same as a collection of a made-up hash."""
    samples = make_samples(objects, each)
    return Dataset("made-up", tuple(samples), f"{objects}x{each}", {})


def _sample(rng: np.random.Generator, name: str, place: int, number: int) -> Sample:
    size = np.array([0.05, 0.08, 0.1])
    xyz = rng.uniform(-0.5, 0.5, (90, 3)) * size + [0.0, 0.0, 1.2]
    along = rng.uniform(-0.4, 0.4) * size[1]
    grasp = Grasp(np.array([size[0] / 2, along, 1.2]), np.array([-size[0] / 2, along, 1.2]), _ALONG_X)
    offset = 20.0 * (place % 3) + number
    touch = biotac_touch(
        np.hstack(
            [
                2800.0 + offset + 1000.0 * along + rng.normal(),
                1800.0 - offset + rng.normal(),
                3000.0 + np.linspace(1.0, 5.0, 24) * offset + rng.normal(0.0, 4.0, 24),
                3200.0 - np.linspace(500.0, 900.0, 24) * along + rng.normal(0.0, 4.0, 24),
            ]
        )
    )
    stamp = (1_562_000_000 + 86_400 * place + 60 * number) * 1_000_000_000
    return Sample(f"{name}/{number}", name, Cloud(xyz.astype(np.float32)), grasp, touch, stamp_ns=stamp)


def cell_rows(name: str, data: Any, **changes: Any) -> tuple[list[Row], Any]:
    """Rows of all cells of an experiment's preset `smoke` with changes, run in this process; and the settings."""
    experiment = find_experiment(name)
    settings = experiment.resolve("smoke", changes)
    cells = experiment.cells(settings, data)
    rows = [{**cell.values, **row} for cell in cells for row in experiment.run(cell, settings, data)]
    return json.loads(json.dumps(rows)), settings
