# SPDX-License-Identifier: Apache-2.0
"""What the guard measures: each case is our way and a peer that does the same work, whose answers must agree."""

import importlib.util
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from benchmarks.common import scene
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.models.registry import load_model
from foretouch.pipeline import FoundObject, Pipeline
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


def why_not(case: Case) -> str:
    """Why a case cannot be measured here; "" if it can."""
    if case.needs and importlib.util.find_spec(case.needs) is None:
        return f"{case.needs}: not installed"
    return ""


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
    """Both count the objects; Open3D on voxels of 5 mm."""
    from foretouch.camera.libusb import ensure_libusb

    ensure_libusb()
    import open3d

    cloud = scene_cloud()

    def peer() -> Float64:
        flat = cloud.xyz[cloud.xyz[..., 2] < 2.0].astype(np.float64)
        points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(flat)).voxel_down_sample(0.005)
        open3d.utility.random.seed(0)
        plane, _ = points.segment_plane(0.01, 3, 100)
        plane = np.array(plane) * np.sign(plane[3])
        above = np.flatnonzero(np.asarray(points.points) @ plane[:3] + plane[3] > 0.012)
        clusters = np.asarray(points.select_by_index(above).cluster_dbscan(0.015, 6))
        return np.array([np.count_nonzero(np.bincount(clusters + 1)[1:] >= 100)])

    return lambda: np.array([len(segment(cloud, SegmentationConfig()).objects)]), peer


def geograsp(config: GeoGraspConfig) -> Job:
    """(6,) contacts of the best grasp [m]."""
    one = target()

    def run() -> Float64:
        plan = plan_grasps(one.cloud, one.plane, config, pixels=one.pixels, image_shape=one.image_shape)
        return np.concatenate([plan.grasps[0].g1, plan.grasps[0].g2])

    return run


def geograsp_against_scipy() -> tuple[Job, Job]:
    """The baseline of benchmarks/geograsp, on the points that `max_points` leaves."""
    from benchmarks.geograsp import baseline
    from foretouch.grasp.preprocessing import finite_points

    one, config = target(), GeoGraspConfig(method="original")
    thinned = finite_points(one.cloud, one.pixels, one.image_shape).downsampled(config).xyz

    def peer() -> Float64:
        ranking, (first, second) = baseline.plan(thinned, one.plane, config)
        return np.concatenate([first.candidates.xyz[ranking.first[0]], second.candidates.xyz[ranking.second[0]]])

    return geograsp(config), peer


def touch(model: str, count: int) -> Job:
    """(count, 50) predictions [counts]."""
    loaded, one, asked = load_model(model), target(), grasps()[:count]

    def run() -> Float64:
        return np.array([found.value.values for found in loaded.predict(one.cloud, asked) if found.value])

    return run


def networks() -> tuple[Job, Job]:
    """One shared network of P2's width against four eager ones in the layout of most public PointNets, for one grasp."""
    import torch

    from benchmarks.guard.eager import channels_first, made_net
    from foretouch.models.network.checkpoint import NetworkEstimator
    from foretouch.models.network.config import ModelConfig
    from foretouch.models.touch_model import TouchModel
    from foretouch.tactile import MODALITIES

    torch.set_num_threads(1)
    shared = made_net(ModelConfig(), 0)
    four = [made_net(ModelConfig(outputs=(name,)), k) for k, name in enumerate(MODALITIES)]
    eager = [channels_first(net) for net in four]
    points, grasp, folded = torch.randn(1, 750, 3) * 0.4, torch.randn(1, 15), shared.folded()
    with torch.inference_mode():
        pairs = [(folded.regress(folded.features(points[0]), grasp), shared.counts(points, grasp))]
        pairs += [(net.counts(points, grasp), peer(points, grasp)) for net, peer in zip(four, eager, strict=True)]
    for one, other in pairs:  # folded and eager, and points in rows and channels first
        require_close("touchnet", float((one - other).abs().max()), 0.01)
    model = TouchModel(NetworkEstimator(ModelConfig(), folded), {"name": "full width", "sha256": ""})
    one, asked = target(), grasps()[:1]

    def peer() -> None:
        with torch.inference_mode():
            for net in eager:
                net(points, grasp)

    return lambda: model.predict(one.cloud, asked) and None, peer


def training_step() -> tuple[Job, Job]:
    """A supervised step of P2's network with eight clouds, against torch's own layers."""
    import torch

    from benchmarks.training import bench

    torch.set_num_threads(1)
    require_close("training step", bench.difference(lambda: bench.supervised(bench.FULL, 8, "float32", 1)), 1e-3)
    fused, plain = (bench.supervised(bench.FULL, 8, "float32", 1) for _ in range(2))

    def peer() -> None:
        with bench.plain_composition():
            plain.run_epoch()

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
                path = Path(folder) / f"{k:03}.npz"
                if k < len(clouds):
                    np.savez(path, xyz=clouds[k].xyz)
                else:
                    path.symlink_to(Path(folder) / f"{k % len(clouds):03}.npz")
            (few, few_s), (many, many_s) = (_program_seconds(folder, count) for count in COUNTED)
        return (many_s - few_s) / (many - few)

    def peer() -> float:
        before = _cpu_seconds(resource.RUSAGE_SELF)
        for k in range(20):
            made.run(clouds[k % len(clouds)])
        return (_cpu_seconds(resource.RUSAGE_SELF) - before) / 20

    return ours, peer


def _program_seconds(folder: str, count: int) -> tuple[int, float]:
    """Answered clouds and CPU seconds of `foretouch run`, which ends once `count` are answered."""
    before = _cpu_seconds(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "foretouch.cli.main", "run", "--source", folder, "--count", str(count), "--json"]
    domain = os.environ.get("ROS_DOMAIN_ID", "88")
    environment = {**os.environ, "ROS_DOMAIN_ID": domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment, timeout=_LONGEST_S)
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    predicted = sum(bool(one.get("predictions")) for one in answers)
    if predicted < count:
        raise SystemExit(f"graph: {predicted} of {count} clouds were answered: {done.stderr[-500:]}")
    return predicted, _cpu_seconds(resource.RUSAGE_CHILDREN) - before


def _cpu_seconds(who: int) -> float:
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def all_cases() -> list[Case]:
    """In the order of the table. A kernel is added by a line with `yard`."""

    def yard(name: str, make: Callable[[], Job]) -> Case:
        return Case(name, "a yardstick of NumPy", against_yardstick(make))

    return [
        Case("segmentation 848x480, Open3D", "Open3D on voxels of 5 mm", segmentation_against_open3d, needs="open3d"),
        yard("segmentation 848x480", lambda: segmentation(848, 480)),
        yard("segmentation 1280x720", lambda: segmentation(1280, 720)),
        Case("GeoGrasp original, SciPy", "SciPy's tree, all normals", geograsp_against_scipy, 1e-6),
        yard("GeoGrasp original", lambda: geograsp(GeoGraspConfig(method="original"))),
        yard("GeoGrasp completed", lambda: geograsp(GeoGraspConfig())),
        yard("contact model, 1 grasp", lambda: touch("default", 1)),
        yard("contact model, 100 grasps", lambda: touch("default", 100)),
        yard("contact model, 1000 grasps", lambda: touch("default", 1000)),
        Case("touchnet, shared", "four eager networks", networks),
        yard("simulator, rigid", lambda: simulator("rigid")),
        yard("simulator, deformables", lambda: simulator("deformables")),
        Case("training step, fused", "torch's own layers", training_step),
        yard("cloud to touch", pipeline),
        Case("graph in one process", "Pipeline.run", graph, own_clock=True, needs="rclpy"),
    ]
