# SPDX-License-Identifier: Apache-2.0
"""What the guard measures: each case is a piece of our work and a peer whose time no change of it moves."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from benchmarks.common import cpu_ms, scene
from benchmarks.random_scenes import random_scene
from foretouch.cloud.segmentation.segment import segment
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.models.registry import load_model
from foretouch.pipeline import Pipeline
from foretouch.tactile import TOUCH_SIZE
from foretouch.types import Cloud, Grasp
from foretouch.types.scene import Object
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.world import SampleKey

_LONGEST_S = 400.0  # of one run of the graph, on a machine with other work
COUNTED = (20, 100)  # clouds of the two runs of the graph; their difference holds no start

Job = Callable[[], Any]  # runs once


@dataclass(frozen=True)
class Case:
    """One ratio: the CPU time of the peer over ours."""

    name: str
    peer: str  # what it is compared with
    make: Callable[[], tuple[Job, Job]]  # our way, and the peer
    own_clock: bool = False  # whether the jobs return their CPU seconds themselves, as programs do


@cache
def scene_cloud(width: int = 848, height: int = 480, seed: int = 1) -> Cloud:
    """Return a generated scene of three objects with noise and flying pixels."""
    rng = np.random.default_rng(seed)
    return random_scene(rng, width, height).render(rng, 0.001, True).cloud()


@cache
def target() -> Object:
    """Return the object of a generated scene that gets grasps."""
    return Pipeline().segment(scene_cloud(seed=2)).targets[0]


@cache
def grasps() -> list[Grasp]:
    """Return a thousand grasps on the target."""
    xyz = target().cloud.xyz.astype(np.float64)
    pairs = np.random.default_rng(0).choice(len(xyz), (1000, 2))
    pairs = pairs[np.linalg.norm(xyz[pairs[:, 0]] - xyz[pairs[:, 1]], axis=1) > 0.01]
    return [Grasp(xyz[a], xyz[b], np.eye(3)) for a, b in pairs[np.arange(1000) % len(pairs)]]


def touch(model: str, count: int) -> Job:
    """Return a job that predicts so many grasps."""
    loaded = load_model(model)
    object_ = target()
    asked = grasps()[:count]
    return lambda: loaded.predict(object_.cloud, asked)


def training_step() -> Job:
    """Return a job: a supervised step of P2's network with eight random clouds."""
    import torch

    from foretouch.models.network.config import ModelConfig
    from foretouch_lab.learning.data.training_set import TrainingSet
    from foretouch_lab.learning.training.supervised import SupervisedTrainer, TrainConfig

    torch.set_num_threads(1)
    rng, config = np.random.default_rng(0), ModelConfig(channels="xyz+normals", outputs=("PDC_TH",))
    clouds = tuple(rng.uniform(-0.6, 0.6, (5000, 6)).astype(np.float32) for _ in range(8))
    asked = rng.normal(size=(8, config.grasp_size)).astype(np.float32)
    labels = rng.normal(2800.0, 100.0, (8, TOUCH_SIZE))
    data = TrainingSet(clouds, asked, labels, np.ones((8, 5)), config)
    how = TrainConfig(epochs=1000, batch_size=8, optimiser="adam", device="cpu", precision="float32")
    return SupervisedTrainer(data, np.arange(8), how).run_epoch


def simulator(name: str) -> Job:
    """Return a job that makes four samples of a scene, cloud and touch."""
    made = scene(name)
    engine = Engine(made, EFFECTS)
    return lambda: [engine.run(SampleKey(made.seed, slot)) for slot in range(4)]


def yardstick() -> None:
    """Fixed work of NumPy and SciPy alone, which no change of this package can move: for what has no other peer."""
    rng = np.random.default_rng(0)
    field: npt.NDArray[np.float64] = rng.random((64, 64))
    for _ in range(40):
        np.fft.irfft2(np.fft.rfft2(field))
        np.sort(field, axis=None)
        field @ field
    for row in np.tile(field, (8, 1)):
        float(np.abs(row).max())
    cKDTree(points := rng.random((2000, 3))).query(points, 20)


def graph() -> tuple[Job, Job]:
    """Return jobs that give CPU seconds a cloud: the whole graph of `foretouch run` in one process, and `Pipeline.run` with its settings."""
    clouds = [scene_cloud(seed=seed) for seed in (2, 4, 6, 8)]
    made = Pipeline()

    def ours() -> float:
        with tempfile.TemporaryDirectory() as folder:
            for k in range(max(COUNTED)):
                np.savez(Path(folder) / f"{k:03}.npz", xyz=clouds[k % len(clouds)].xyz)
            few, many = (_program_seconds(folder, count) for count in COUNTED)
        return (many - few) / (COUNTED[1] - COUNTED[0])

    def peer() -> float:
        return cpu_ms(lambda: [made.run(cloud) for cloud in clouds], 5) / len(clouds) / 1e3

    return ours, peer


def _program_seconds(folder: str, count: int) -> float:
    """Return CPU seconds of `foretouch run`, which ends once `count` clouds are answered."""
    command = [sys.executable, "-m", "foretouch.cli.main", "run", "--source", folder, "--count", str(count), "--json"]
    environment = {"ROS_DOMAIN_ID": "88", **os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    before = os.times()
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment, timeout=_LONGEST_S)
    after = os.times()
    predicted = sum(bool(json.loads(line).get("predictions")) for line in done.stdout.splitlines())
    if predicted < count:
        raise SystemExit(f"graph: {predicted} of {count} clouds were answered: {done.stderr[-500:]}")
    return after.children_user + after.children_system - before.children_user - before.children_system


def all_cases() -> list[Case]:
    """Return the cases in the order of the table. A kernel is added by a line with `yard`."""

    def yard(name: str, make: Callable[[], Job]) -> Case:
        return Case(name, "a yardstick of NumPy", lambda: (make(), yardstick))

    def plan(method: str) -> Job:
        object_, config = target(), GeoGraspConfig(method=method)
        return lambda: plan_grasps(
            object_.cloud, object_.plane, config, pixels=object_.pixels, image_shape=object_.image_shape
        )

    return [
        yard("segmentation 848x480", lambda: partial(segment, scene_cloud(848, 480))),
        yard("segmentation 1280x720", lambda: partial(segment, scene_cloud(1280, 720))),
        yard("GeoGrasp original", lambda: plan("original")),
        yard("GeoGrasp completed", lambda: plan("completed")),
        yard("contact model, 1 grasp", lambda: touch("default", 1)),
        yard("contact model, 100 grasps", lambda: touch("default", 100)),
        yard("contact model, 1000 grasps", lambda: touch("default", 1000)),
        yard("simulator, rigid", lambda: simulator("rigid")),
        yard("simulator, deformables", lambda: simulator("deformables")),
        yard("training step", training_step),
        yard("cloud to touch", lambda: partial(Pipeline().run, scene_cloud(seed=2))),
        Case("graph in one process", "Pipeline.run", graph, own_clock=True),
    ]
