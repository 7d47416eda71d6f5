# SPDX-License-Identifier: Apache-2.0
"""What the scripts beside this one share: the scenes of the repository, and samples of them."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foretouch.dataset.store import sample_digest
from foretouch.simulation.effects import EFFECTS
from foretouch.simulation.engine import Engine
from foretouch.simulation.scene import SceneConfig, load_scene
from foretouch.simulation.simulate import Simulation
from foretouch.simulation.world import SampleKey
from foretouch.types import GraspSample

FOLDER = Path(__file__).parents[2] / "config" / "scenes"


def scene(name: str, **changes: Any) -> SceneConfig:
    """A scene by name, with changes by dotted keys given as `a__b=value`."""
    loaded = load_scene(FOLDER / f"{name}.yaml")
    return loaded.updated({key.replace("__", "."): value for key, value in changes.items()}) if changes else loaded


@dataclass(frozen=True)
class Run:
    """One run over a scene."""

    samples: list[GraspSample]
    sha256: str
    wall_s: float
    cpu_s: float
    simulation: Simulation


def simulate(config: SceneConfig, count: int, workers: int = 1) -> Run:
    """All samples at once; CPU time is that of the effects, wherever they ran."""
    simulation = Simulation(config)
    start = time.perf_counter()
    samples = list(simulation.samples(count, workers))
    wall = time.perf_counter() - start
    content = hashlib.sha256(b"".join(sample_digest(sample) for sample in samples))
    cpu = sum(timing.seconds for timing in simulation.timings.values())
    return Run(samples, content.hexdigest(), wall, cpu, simulation)


def engine(config: SceneConfig, *outputs: str) -> Engine:
    """An engine for some keys of the state."""
    return Engine(config, EFFECTS, outputs)


def keys(config: SceneConfig, count: int) -> list[SampleKey]:
    """The first tries of the first slots."""
    return [SampleKey(config.seed, slot) for slot in range(count)]
