# SPDX-License-Identifier: Apache-2.0
"""What `foretouch doctor --self-test` checks besides the installation: the shipped models and ROS on this machine.

`python -m foretouch.cli.selftest` stores the answers of the shipped models again, after a model was released.
"""

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import ConfigError, ForetouchError, ModelError, described
from foretouch.types import Cloud, Grasp

_ROS_PATIENCE_S: Final = 20.0  # of one step of the check of ROS
_EXPECTED: Final = Path(__file__).with_name("selftest_expected.json")
_TOLERANCE_COUNTS: Final = 0.5  # half of what a reading resolves; one bit in each coordinate moves an answer by 0.002


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


def check_models() -> None:
    """Compare the shipped models and their answers with those stored with this version; a `ModelError` names the first that differs."""
    from foretouch.files import read_json
    from foretouch.models import available_models

    expected = read_json(_EXPECTED)
    for name in sorted({*expected, *available_models()}):
        if fault := _fault(name, expected.get(name)):
            raise ModelError(fault)


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


def check_ros() -> None:
    """Send a cloud and a hostile request over DDS to a running node; a `ConfigError` names what fails.

    It talks on this machine only, in a domain and a namespace of its own, so that a running robot is not disturbed.
    """
    from foretouch.ros.runtime.environment import prepare_environment

    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    prepare_environment()
    import rclpy

    rclpy.init(domain_id=60 + os.getpid() % 40)
    try:
        _run_node()
    finally:
        rclpy.try_shutdown()


def _run_node() -> None:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    from foretouch.ros.graph import make_nodes

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
        _hostile_request(probe, wait)
        if node.internal_errors.counts():
            raise ConfigError(f"touch_predictor: internal errors: {dict(node.internal_errors.counts())}")
    finally:
        node.stop()
        executor.shutdown(timeout_sec=1.0)
        node.destroy_node()
        probe.destroy_node()


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


if __name__ == "__main__":
    _renew()
