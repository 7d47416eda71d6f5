# SPDX-License-Identifier: Apache-2.0
"""What the guard measures: each case is our way and a peer that does the same work, whose answers must agree."""

import functools
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from benchmarks.common import cpu_ms, scene
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.models.registry import load_model
from foretouch.pipeline import FoundObject, Pipeline
from foretouch.tactile import TOUCH_SIZE
from foretouch.types import Cloud, Float64, Grasp
from foretouch_lab.simulation.depth_scene import random_scene
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.world import SampleKey

_LONGEST_S = 400.0  # of one run of the graph, on a machine with other work
COUNTED = (20, 100)  # clouds of the two runs of the graph; their difference holds no start

Job = Callable[[], Any]
"""Runs once; returns an answer to compare, an array of numbers or None."""


@dataclass(frozen=True)
class Case:
    """One ratio: the CPU time of the peer over ours."""

    name: str
    peer: str  # what it is compared with
    make: Callable[[], tuple[Job, Job]]  # our way, and the peer
    gap: float = 0.0  # largest difference of the two answers
    own_clock: bool = False  # whether the jobs return their CPU seconds themselves, as programs do
    needs: str = ""  # an optional package of the peer


def require_close(name: str, difference: float, gap: float) -> None:
    """Stop where answers differ; those of a NaN do."""
    print(f"  {name}: answers differ by {difference:.1e}, allowed {gap:g}")
    if not difference <= gap:
        raise SystemExit(f"{name}: its answer is not that of its peer; nothing is timed")


@cache
def scene_cloud(width: int = 848, height: int = 480, seed: int = 1) -> Cloud:
    """A generated scene of three objects with noise and flying pixels."""
    rng = np.random.default_rng(seed)
    return random_scene(rng, width, height).render(rng, 0.001, True).cloud()


@cache
def target() -> FoundObject:
    """The object of a generated scene that gets grasps."""
    return Pipeline().segment(scene_cloud(seed=2)).targets[0]


@cache
def grasps() -> list[Grasp]:
    """A thousand grasps on the target."""
    xyz = target().cloud.xyz.astype(np.float64)
    pairs = np.random.default_rng(0).choice(len(xyz), (1000, 2))
    pairs = pairs[np.linalg.norm(xyz[pairs[:, 0]] - xyz[pairs[:, 1]], axis=1) > 0.01]
    return [Grasp(xyz[a], xyz[b], np.eye(3)) for a, b in pairs[np.arange(1000) % len(pairs)]]


def segmentation(width: int, height: int) -> Job:
    """Number of objects, points of each, and the table."""
    cloud = scene_cloud(width, height)

    def run() -> Float64:
        found = segment(cloud, SegmentationConfig())
        assert found.plane is not None
        return np.array([*(one.n_points for one in found.objects), *found.plane.normal])

    return run


def segmentation_against_open3d() -> tuple[Job, Job]:
    """Number of objects, and of a common pipeline: crop, RANSAC plane, DBSCAN of the points above it, small clusters dropped."""
    from foretouch.camera.libusb import ensure_libusb

    ensure_libusb()
    import open3d

    cloud = scene_cloud()

    def peer() -> Float64:
        flat = cloud.xyz.reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            near = flat[(flat[:, 2] > 0.16) & (flat[:, 2] < 2.0)].astype(np.float64)
        points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(near))
        open3d.utility.random.seed(0)
        plane, _ = points.segment_plane(0.01, 3, 100)
        plane = np.array(plane) * np.sign(plane[3])
        objects = points.select_by_index(np.flatnonzero(near @ plane[:3] + plane[3] > 0.006))
        clusters = np.asarray(objects.cluster_dbscan(0.01, 10)) + 1
        return np.array([np.count_nonzero(np.bincount(clusters)[1:] >= 150)])

    return lambda: np.array([segment(cloud).labels.max()]), peer


def geograsp(config: GeoGraspConfig) -> Job:
    """(6,) contacts of the best grasp [m]."""
    one = target()

    def run() -> Float64:
        plan = plan_grasps(one.cloud, one.plane, config, pixels=one.pixels, image_shape=one.image_shape)
        return np.concatenate([plan.grasps[0].g1, plan.grasps[0].g2])

    return run


def touch(model: str, count: int) -> Job:
    """(count, 50) predictions [counts]."""
    loaded, one, asked = load_model(model), target(), grasps()[:count]

    def run() -> Float64:
        return np.array([found.value.values for found in loaded.predict(one.cloud, asked) if found.value])

    return run


@contextmanager
def plain_layers() -> Iterator[None]:
    """Within, every PointNet of the package is torch's linear maps, batch norms, ReLUs and a maximum, on the same weights."""
    import torch

    from foretouch_lab.learning.network import pointnet

    def layer(own: Any, x: Any) -> Any:
        y = own.linear(x)
        return torch.relu(y if own.norm is None else own.norm(y.flatten(0, -2)).view_as(y))

    def pool(layers: Any, points: Any, _precision: Any) -> Any:
        return functools.reduce(lambda one, own: layer(own, one), layers, points).amax(dim=1)

    before = pointnet.Layer.forward, pointnet.pool
    pointnet.Layer.forward, pointnet.pool = layer, pool  # type: ignore[method-assign,assignment]
    try:
        yield
    finally:
        pointnet.Layer.forward, pointnet.pool = before  # type: ignore[method-assign]


def training_step() -> tuple[Job, Job]:
    """A supervised step of P2's network with eight random clouds, against torch's own layers."""
    import torch

    from foretouch.models.network.config import ModelConfig
    from foretouch_lab.learning.data.training_set import TrainingSet
    from foretouch_lab.learning.training.supervised import SupervisedTrainer, TrainConfig

    torch.set_num_threads(1)
    rng, config = np.random.default_rng(0), ModelConfig(channels="xyz+normals", outputs=("PDC_TH",))
    clouds = tuple(rng.uniform(-0.6, 0.6, (5000, 6)).astype(np.float32) for _ in range(8))
    asked = rng.normal(size=(8, config.grasp_size)).astype(np.float32)
    ids, labels = tuple("12345678"), rng.normal(2800.0, 100.0, (8, TOUCH_SIZE))
    data = TrainingSet(clouds, asked, labels, np.ones((8, 5)), config, ids)
    how = TrainConfig(epochs=1000, batch_size=8, optimiser="adam", device="cpu", precision="float32")
    fused, plain = (SupervisedTrainer(data, np.arange(8), how) for _ in range(2))

    def peer() -> None:
        with plain_layers():
            plain.run_epoch()

    fused.run_epoch()
    peer()
    found, expected = fused.net.state_dict(), plain.net.state_dict()
    # Running variances; weights would differ more, since Adam turns rounding of small gradients into steps of full size.
    names = [name for name in expected if name.endswith("running_var")]
    gaps = (float((found[name] - expected[name]).norm() / expected[name].norm().clamp(min=1e-6)) for name in names)
    require_close("training step", max(gaps), 1e-3)
    return lambda: fused.run_epoch() and None, peer


def simulator(name: str) -> Job:
    """Four samples of a scene, cloud and touch."""
    made = scene(name)
    engine = Engine(made, EFFECTS, ("cloud", "touch"))

    def run() -> Float64:
        return np.array([engine.run(SampleKey(made.seed, slot)).touch.values for slot in range(4)])

    return run


def pipeline() -> Job:
    """(50,) touch of the best grasp [counts]."""
    cloud, made = scene_cloud(seed=2), Pipeline()

    def run() -> Float64:
        return np.asarray(made.run(cloud).targets[0].predictions[0].value.values)

    return run


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


def against_yardstick(make: Callable[[], Job]) -> Callable[[], tuple[Job, Job]]:
    """The peer is `yardstick`."""

    def pair() -> tuple[Job, Job]:
        ours = make()

        def silent() -> None:
            ours()

        return silent, yardstick

    return pair


def graph() -> tuple[Job, Job]:
    """CPU seconds a cloud: the whole graph of `foretouch run` in one process, and `Pipeline.run` with its settings."""
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
    """CPU seconds of `foretouch run`, which ends once `count` clouds are answered."""
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
    """In the order of the table. A kernel is added by a line with `yard`."""

    def yard(name: str, make: Callable[[], Job]) -> Case:
        return Case(name, "a yardstick of NumPy", against_yardstick(make))

    return [
        Case("segmentation 848x480, Open3D", "Open3D's RANSAC and DBSCAN", segmentation_against_open3d, needs="open3d"),
        yard("segmentation 848x480", lambda: segmentation(848, 480)),
        yard("segmentation 1280x720", lambda: segmentation(1280, 720)),
        yard("GeoGrasp original", lambda: geograsp(GeoGraspConfig(method="original"))),
        yard("GeoGrasp completed", lambda: geograsp(GeoGraspConfig())),
        yard("contact model, 1 grasp", lambda: touch("default", 1)),
        yard("contact model, 100 grasps", lambda: touch("default", 100)),
        yard("contact model, 1000 grasps", lambda: touch("default", 1000)),
        yard("touchnet, 1 grasp", lambda: touch("touchnet-v1", 1)),
        yard("simulator, rigid", lambda: simulator("rigid")),
        yard("simulator, deformables", lambda: simulator("deformables")),
        Case("training step, fused", "torch's own layers", training_step),
        yard("cloud to touch", pipeline),
        Case("graph in one process", "Pipeline.run", graph, own_clock=True, needs="rclpy"),
    ]
