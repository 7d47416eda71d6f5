# SPDX-License-Identifier: Apache-2.0
"""The rows of `foretouch doctor --self-test`: the shipped models and ROS on this machine.

Each row runs in a process of its own, `python -m foretouch.cli.selftest ROW`, so that a crash is one failed row.
`python -m foretouch.cli.selftest renew` stores the answers of the shipped models again, after a model was released.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from foretouch.errors import ConfigError, ForetouchError, ModelError, described, none_of
from foretouch.types import Cloud, Grasp

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
                [sys.executable, "-m", "foretouch.cli.selftest", name],
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


def _models() -> RowResult:
    """Hashes of the shipped models, and their answers against those that were stored with this version."""
    from foretouch.files import read_json
    from foretouch.models import available_models

    expected = read_json(_EXPECTED)
    names = sorted({*expected, *available_models()})
    faults = [fault for name in names if (fault := _fault(name, expected.get(name)))]
    found = f"{len(names) - len(faults)} of {len(names)} as expected"
    if faults:
        return RowResult("models", "failed", found, faults[0], "pip install --force-reinstall foretouch")
    return RowResult("models", "ok", found)


def _fault(name: str, expected: Any) -> str:
    """How a model differs from what was stored; "" if its answers are within the tolerance."""
    if expected is None:
        return f"model {name}: has no stored values to compare with"
    try:
        found = _answers(name)
    except ForetouchError as err:
        return f"model {name}: {err}"
    except Exception as err:  # noqa: BLE001 - any other error is what is searched for
        return f"model {name}: {described(err)}"
    if found["sha256"] != expected["sha256"]:
        return f"model {name}: sha256: {found['sha256']} is not {expected['sha256']} of this version"
    error = float(np.abs(np.subtract(found["counts"], expected["counts"])).max())
    return "" if error <= _TOLERANCE_COUNTS else f"model {name}: answers differ by {error:.3g} counts"


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

    from foretouch.cloud.messages import decode_cloud
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


ROWS: Final = {"models": _models, "ROS": _ros}
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
