# SPDX-License-Identifier: Apache-2.0
"""The rows of `foretouch doctor --self-test`: shipped models, numerical references, ROS and timings on this machine.

Each row runs in a process of its own, `python -m foretouch.selftest ROW`, so that a crash is one failed row.
`python -m foretouch.selftest renew` stores the answers of the shipped models again, after a model was released.
"""

import json
import math
import os
import signal
import subprocess
import sys
import time
import timeit
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Final, Literal

import numpy as np

from foretouch.errors import ConfigError, ForetouchError, ModelError, described, none_of
from foretouch.types import ASSUMED_TABLE, Cloud, Float32, Grasp

_CRASHED: Final = "foretouch doctor: a library that crashes is named there"
_PATIENCE_S: Final = 120.0  # of one row; the longest takes 6 s on an idle machine
_ROS_PATIENCE_S: Final = 20.0  # of one step of the ROS row
_EXPECTED: Final = Path(__file__).with_name("selftest_expected.json")
_TOLERANCE_COUNTS: Final = 0.5  # half of what a reading resolves; one bit in each coordinate moves an answer by 0.002


@dataclass(frozen=True)
class RowResult:
    """The outcome of one row."""

    row: str  # its name
    state: Literal["ok", "failed", "skipped"]
    found: str  # what was found, such as "6 of 6 as expected"
    cause: str = ""  # the first check that failed and why, in one line
    fix: str = ""  # what to do about it
    seconds: float = 0.0  # elapsed time


def run_rows(names: Sequence[str]) -> Iterator[RowResult]:
    """Run rows by name, each in a process; a row whose process dies or hangs has failed, a name that is none is refused."""
    for name in names:
        if name not in ROWS:
            raise ConfigError(f"--self-test: {none_of(name, ROWS)}")
    for name in names:
        yield _in_a_process(name)


def _in_a_process(name: str) -> RowResult:
    from foretouch.processes import one_thread_each

    try:
        with one_thread_each():
            done = subprocess.run(  # noqa: S603 - our own interpreter and module
                [sys.executable, "-m", "foretouch.selftest", name],
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_PATIENCE_S,
                check=False,
            )
    except subprocess.TimeoutExpired:
        return RowResult(name, "failed", "stopped", f"takes more than {_PATIENCE_S:g} s", _CRASHED)
    last = (done.stdout.strip().splitlines() or [""])[-1]  # a library may print lines before
    if last.startswith('{"row": '):
        return RowResult(**json.loads(last))
    status = done.returncode
    ending = signal.Signals(-status).name if status < 0 else f"exit status {status}"
    error = (done.stderr.strip().splitlines() or [""])[-1][:300]
    return RowResult(name, "failed", "stopped", f"its process ended by {ending}{error and f': {error}'}", _CRASHED)


# --- checks -----------------------------------------------------------------------------------------------------

_Check = tuple[str, float, Callable[[], float]]
"""Name with unit, bound, and function that returns the error."""


def _run_checks(row: str, checks: Sequence[_Check], fix: str) -> RowResult:
    faults = [text for name, bound, error in checks if (text := _fault(name, bound, error))]
    found = f"{len(checks) - len(faults)} of {len(checks)} as expected"
    return RowResult(row, "failed", found, faults[0], fix) if faults else RowResult(row, "ok", found)


def _fault(name: str, bound: float, error: Callable[[], float]) -> str:
    try:
        found = error()
    except ForetouchError as err:
        return f"{name}: {err}"
    except Exception as err:  # noqa: BLE001 - any other error is what is searched for
        return f"{name}: {described(err)}"
    return "" if found <= bound else f"{name}: the error {found:.3g} is not within {bound:g}"


def exact_cloud() -> Cloud:
    """Top and front of a tilted box of 68 x 71 x 95 mm: 1876 points, the same bits on every machine.

    Its size is one that the shipped models know, so that they do not answer with their mean.
    """
    tops, fronts = np.meshgrid(np.arange(28), np.arange(29)), np.meshgrid(np.arange(28), np.arange(1, 39))
    x = np.concatenate([one[0].ravel() for one in (tops, fronts)])
    y = np.concatenate([tops[1].ravel(), 0 * fronts[1].ravel()])
    z = np.concatenate([0 * tops[1].ravel(), fronts[1].ravel()])
    turned = np.stack([13 * x, 5 * y - 12 * z, 12 * y + 5 * z], axis=1) * 10 // 13  # in units of 1/4096 m
    return Cloud(((turned + np.array([0, 0, 4700])) / 4096.0).astype(np.float32))


def exact_grasps() -> list[Grasp]:
    """Three grasps of `exact_cloud`, two along x and one along y."""
    grasps = []
    for middle, width, axis in (((140, -60, 4820), 288, 0), ((140, -20, 4860), 288, 0), ((140, -60, 4820), 256, 1)):
        half = np.eye(3)[axis] * width / 8192.0
        x, z = np.eye(3)[(axis + 1) % 3], np.eye(3)[axis]
        centre = np.array(middle) / 4096.0
        grasps.append(Grasp(centre + half, centre - half, np.stack([x, np.cross(z, x), z], axis=1)))
    return grasps


# --- models -----------------------------------------------------------------------------------------------------


def _models() -> RowResult:
    """Hashes of the shipped models, and their answers against those that were stored with this version."""
    from foretouch.checked_files import read_json
    from foretouch.models import available_models

    expected = read_json(_EXPECTED)
    checks = [
        (f"model {name} [counts]", _TOLERANCE_COUNTS, partial(_difference, name, expected.get(name)))
        for name in sorted({*expected, *available_models()})
    ]
    return _run_checks("models", checks, "pip install --force-reinstall foretouch")


def _difference(name: str, expected: Any) -> float:
    """Largest difference from the stored values [counts]."""
    if expected is None:
        raise ModelError(f"{name}: has no stored values to compare with")
    found = _answers(name)
    if found["sha256"] != expected["sha256"]:
        raise ModelError(f"{name}: sha256: {found['sha256']} is not {expected['sha256']} of this version")
    return float(np.abs(np.subtract(found["counts"], expected["counts"])).max())


def _answers(name: str) -> dict[str, Any]:
    """Hash, and values and bounds for each grasp [counts]."""
    from foretouch.models import load_model

    model = load_model(name)
    rows = []
    for one in model.predict(exact_cloud(), exact_grasps()):
        if one.value is None or one.lower is None or one.upper is None:
            raise ModelError(f"{name}: {one.reason or 'has no bounds'}")
        rows += [part.values.round(3).tolist() for part in (one.value, one.lower, one.upper)]
    return {"sha256": model.sha256, "counts": rows}


def _renew() -> None:
    from foretouch.models import available_models

    lines = [f' "{name}": {json.dumps(_answers(name))}' for name in sorted(available_models())]
    _EXPECTED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


# --- references -------------------------------------------------------------------------------------------------


def _references() -> RowResult:
    """Numerical kernels against references in exact or double arithmetic.

    A bound is the number of additions times the resolution of the type, times the condition number where it is not 1.
    """
    checks: list[_Check] = [
        ("plane of a table [m, 1]", 1e-4, _table),  # its points are float32 and segmentation thins them out
        ("normals and curvature [1]", 1e-9, _normals),  # sums about the origin: (1.2 m / 0.01 m)² loses 4 digits
        ("centroid and radius 1 km away [relative]", 1e-12, _centroid),
        ("Hertz by the layer solver [relative]", 0.01, _hertz),  # what a grid of 48 x 48 cells resolves
        ("impedance [relative]", 1e-12, _impedance),
        ("released network in float32 [counts]", 0.1, _network),  # one bit in each coordinate moves it by 0.002
    ]
    return _run_checks("references", checks, "foretouch doctor: compare the versions of numpy, scipy and torch")


def table_scene(tilt: float = 0.6, rise: float = 0.05, width: int = 320, height: int = 240) -> Float32:
    """(height, width, 3): a table, tilted by `tilt` rad about x, with a box of `rise` [m] height."""
    focal = 0.75 * width
    u, v = np.meshgrid((np.arange(width) - width / 2) / focal, (np.arange(height) - height / 2) / focal)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    normal = np.array([0.0, -np.sin(tilt), -np.cos(tilt)])
    depth = 0.9 * np.cos(tilt) / -(rays @ normal)
    box = (np.abs(u - 0.05) < 0.06) & (np.abs(v) < 0.06)
    depth = np.where(box, (0.9 * np.cos(tilt) - rise) / -(rays @ normal), depth)
    depth[(depth < 0.0) | (depth > 4.0)] = np.nan
    return np.asarray(rays * depth[..., None], np.float32)


def _table() -> float:
    """Normal and distance of a table tilted by 0.6 rad, against the plane that made it."""
    from foretouch.cloud.segmentation.segment import segment

    plane = segment(Cloud(table_scene())).plane
    if plane is None:
        raise ConfigError("no table is found")
    true = np.array([0.0, math.sin(0.6), math.cos(0.6), -0.9 * math.cos(0.6)])
    return float(min(np.abs(sign * np.asarray(plane.coefficients) - true).max() for sign in (1.0, -1.0)))


def _normals() -> float:
    """Normals by summed moments, against eigenvectors of each neighbourhood's covariance about its mean."""
    from foretouch.cloud.geometry.pcl_filters import normals_and_curvature

    xyz = exact_cloud().xyz
    query = np.arange(0, len(xyz), 97)
    worst = 0.0
    for k, found, bent in zip(query, *normals_and_curvature(xyz, query), strict=True):
        near = xyz[((xyz - xyz[k]).astype(np.float64) ** 2).sum(axis=1) < 0.03**2].astype(np.float64)
        values, vectors = np.linalg.eigh(np.cov(near.T, bias=True))
        sine = float(np.linalg.norm(np.cross(vectors[:, 0], found)))
        worst = max(worst, sine, abs(float(bent) - float(values[0] / values.sum())))
    return worst


def _centroid() -> float:
    """Centroid and radius of the unit sphere, against sums of fractions."""
    from foretouch.cloud.geometry.sampling import UnitSphereFrame

    points = (np.random.default_rng(3).uniform(-0.08, 0.08, (300, 3)) + np.array([0.0, 0.0, 1000.0])).astype(np.float32)
    frame = UnitSphereFrame.fit(points)
    exact = [sum(map(_exact, column), Fraction(0)) / len(points) for column in points.T]
    radius = math.sqrt(
        max(sum(((_exact(x) - m) ** 2 for x, m in zip(row, exact, strict=True)), Fraction(0)) for row in points)
    )
    return max(abs(float(frame.centre[2]) / float(exact[2]) - 1.0), abs(frame.scale / radius - 1.0))


def _exact(number: Any) -> Fraction:
    return Fraction(float(number))


def _hertz() -> float:
    """Force of a ball of 10 mm on a half-space by the layer solver, against Hertz."""
    from foretouch.simulation.contact.layer import solve_layer
    from foretouch.simulation.contact.problem import Command, ContactProblem, Layer

    depth, radius, n = 1e-4, 0.01, 48
    body = Layer(modulus_pa=1e6, poisson=0.3)
    step = 2.6 * math.sqrt(radius * depth) / n
    offset = (np.arange(n) - (n - 1) / 2.0) * step
    gap = (offset[:, None] ** 2 + offset**2) / (2.0 * radius)
    force = solve_layer(ContactProblem(gap - gap.min(), step, (body,)), Command(depth_m=depth)).force_n
    return float(abs(force / (4.0 / 3.0 * body.plane_modulus_pa * math.sqrt(radius) * depth**1.5) - 1.0))


def _impedance() -> float:
    """Impedance of an electrode, against fractions."""
    from foretouch.tactile.readings import to_kohm

    counts = np.arange(1.0, 4095.0)
    exact = np.array([float((Fraction(4095, int(n)) - 1) * 10) for n in counts])
    return float(np.abs(to_kohm(counts) / exact - 1.0).max())


def _network() -> float:
    """The released network, folded and in float32, against its layers in float64 [counts]."""
    import torch

    from foretouch.models.network.checkpoint import load_network
    from foretouch.models.network.folding import fold
    from foretouch.models.network.preparation import prepare_cloud, prepare_grasps
    from foretouch.models.registry import find_card

    net, _ = load_network(find_card("touchnet-v1"))
    prepared = prepare_cloud(exact_cloud(), net.config)
    points = torch.from_numpy(prepared.points)[None]
    grasps = torch.from_numpy(prepare_grasps(exact_grasps(), prepared.frame, net.config))
    with torch.inference_mode():
        folded = fold(net)
        found = folded.regress(folded.features(points[0]), grasps)
        exact = net.double().counts(points.double().expand(len(grasps), -1, -1), grasps.double())
    return float((found.double() - exact).abs().max())


# --- ROS --------------------------------------------------------------------------------------------------------


def _ros() -> RowResult:
    """A cloud over DDS, and a hostile request to a running node.

    It talks on this machine only, in a domain and a namespace of its own, so that a running robot is not disturbed.
    """
    from foretouch.ros.runtime.environment import prepare_environment

    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    prepare_environment()
    try:
        import rclpy

        import foretouch_msgs.msg  # noqa: F401
    except ImportError as err:
        return RowResult("ROS", "skipped", f"not installed: {err}")
    rclpy.init(domain_id=60 + os.getpid() % 40)
    try:
        _run_node()
    except ForetouchError as err:
        fix = "foretouch doctor: check rclpy, foretouch_msgs and shared memory"
        return RowResult("ROS", "failed", "stopped", str(err), fix)
    finally:
        rclpy.try_shutdown()
    return RowResult("ROS", "ok", "cloud over DDS, hostile request refused")


def _run_node() -> None:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    from foretouch.ros.executables import make_nodes

    namespace = f"/foretouch_self_test_{os.getpid()}"
    probe = Node("probe", namespace=namespace)
    (node,) = make_nodes("touch_predictor", namespace=namespace)
    executor = SingleThreadedExecutor()

    def wait(done: Callable[[], Any], what: str) -> None:
        end = time.monotonic() + _ROS_PATIENCE_S
        while not done():
            if time.monotonic() > end:
                raise ConfigError(f"{what}: nothing in {_ROS_PATIENCE_S:g} s")
            executor.spin_once(timeout_sec=0.05)

    try:
        executor.add_node(probe)
        executor.add_node(node)
        node.autostart()
        _round_trip(probe, wait)
        _hostile_request(probe, wait)
        if node.internal_errors.counts():
            raise ConfigError(f"touch_predictor: internal errors: {dict(node.internal_errors.counts())}")
    finally:
        node.stop()
        executor.shutdown(timeout_sec=1.0)
        node.destroy_node()
        probe.destroy_node()


def _round_trip(probe: Any, wait: Callable[[Callable[[], Any], str], None]) -> None:
    """Publish a cloud until it arrives, and compare it."""
    from sensor_msgs.msg import PointCloud2

    from foretouch.dataset.messages import decode_cloud
    from foretouch.ros.messages.clouds import cloud_to_msg

    received: list[Any] = []
    probe.create_subscription(PointCloud2, "cloud", received.append, 1)
    publisher = probe.create_publisher(PointCloud2, "cloud", 1)

    def sent() -> bool:
        if not received and publisher.get_subscription_count():
            publisher.publish(cloud_to_msg(exact_cloud()))
        return bool(received)

    wait(sent, "a cloud over DDS")
    if not np.array_equal(decode_cloud(received[0]).xyz, exact_cloud().xyz):
        raise ConfigError("a cloud over DDS: other points arrived")


def _hostile_request(probe: Any, wait: Callable[[Callable[[], Any], str], None]) -> None:
    """Ask for three grasps, one of them 1e160 m wide, and then for a good one."""
    from foretouch.ros.messages.clouds import cloud_to_msg
    from foretouch.ros.messages.conversions import grasp_to_msg
    from foretouch_msgs.msg import Status
    from foretouch_msgs.srv import PredictTouch

    client = probe.create_client(PredictTouch, "predict_touch")
    wait(client.service_is_ready, "predict_touch")
    for width_m, expected in ((1e160, [Status.OK, Status.BAD_GRASP, Status.OK]), (0.0, [Status.OK] * 3)):
        request = PredictTouch.Request(cloud=cloud_to_msg(exact_cloud()))
        request.grasps = [grasp_to_msg(grasp) for grasp in exact_grasps()]
        if width_m:
            request.grasps[1].g1.x = width_m
        future = client.call_async(request)
        wait(future.done, "predict_touch")
        found = [one.status for one in future.result().touch.predictions]
        if found != expected:
            raise ConfigError(f"predict_touch: the statuses are {found}, not {expected}")


# --- timings ----------------------------------------------------------------------------------------------------


def _timings() -> RowResult:
    """Times of the main steps, for orientation; they fail nothing."""
    from foretouch.cloud.segmentation.segment import segment
    from foretouch.grasp import GeoGraspConfig, plan_grasps
    from foretouch.models import DEFAULT_MODEL, load_model

    image, cloud, grasps, model = Cloud(table_scene(width=848, height=480)), exact_cloud(), exact_grasps(), load_model()
    steps: dict[str, Callable[[], object]] = {
        "segment 848x480": lambda: segment(image),
        "grasp": lambda: plan_grasps(cloud, ASSUMED_TABLE, GeoGraspConfig()),
        DEFAULT_MODEL: lambda: model.predict(cloud, grasps),
    }
    return RowResult("timings", "ok", ", ".join(f"{name} {_median_ms(step):.1f} ms" for name, step in steps.items()))


def _median_ms(step: Callable[[], object]) -> float:
    return 1e3 * median(timeit.repeat(step, number=1, repeat=7))


ROWS: Final = {"models": _models, "references": _references, "ROS": _ros, "timings": _timings}
"""By name, in the order in which they run."""


def _main(name: str) -> int:
    """Run one row in this process and print its result as JSON."""
    if name == "renew":
        _renew()
    else:
        began = time.monotonic()
        result = ROWS[name]()
        sys.stdout.write(json.dumps(asdict(replace(result, seconds=time.monotonic() - began))) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1]))
