# SPDX-License-Identifier: Apache-2.0
"""What `foretouch doctor --self-test` checks besides the installation: the shipped models and ROS on this machine.

`python -m foretouch.cli.selftest` stores the answers of the shipped models again, after a model was released.
"""

import json
import os
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import ConfigError, ModelError
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
    if missing := sorted(set(available_models()) ^ set(expected)):
        raise ModelError(f"model {missing[0]}: is not both installed and stored to compare with")
    for name, stored in expected.items():
        found = _answers(name)
        if found["sha256"] != stored["sha256"]:
            raise ModelError(f"model {name}: sha256: {found['sha256']} is not {stored['sha256']} of this version")
        error = float(np.abs(np.subtract(found["counts"], stored["counts"])).max())
        if not error <= _TOLERANCE_COUNTS:
            raise ModelError(f"model {name}: answers differ by {error:.3g} counts")


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


def check_ros() -> None:
    """Ask a running node over DDS for three grasps, one of them 1e160 m wide; a `ConfigError` names what fails.

    It talks on this machine only, in a domain and a namespace of its own, so that a running robot is not disturbed.
    """
    from foretouch.ros.runtime.environment import prepare_environment

    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    prepare_environment()
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    from foretouch.ros.executables import make_nodes
    from foretouch.ros.messages.clouds import cloud_to_msg
    from foretouch.ros.messages.conversions import grasp_to_msg
    from foretouch_msgs.msg import Status
    from foretouch_msgs.srv import PredictTouch

    rclpy.init(domain_id=60 + os.getpid() % 40)
    namespace = f"/foretouch_self_test_{os.getpid()}"
    probe, executor = Node("probe", namespace=namespace), SingleThreadedExecutor()
    (node,) = make_nodes("touch_predictor", namespace=namespace)
    try:
        executor.add_node(probe)
        executor.add_node(node)
        node.autostart()
        client = probe.create_client(PredictTouch, "predict_touch")
        request = PredictTouch.Request(cloud=cloud_to_msg(exact_cloud()))
        request.grasps = [grasp_to_msg(grasp) for grasp in exact_grasps()]
        request.grasps[1].g1.x = 1e160
        future = None
        end = time.monotonic() + _ROS_PATIENCE_S
        while future is None or not future.done():
            if time.monotonic() > end:
                raise ConfigError(f"predict_touch: nothing in {_ROS_PATIENCE_S:g} s")
            executor.spin_once(timeout_sec=0.05)
            if future is None and client.service_is_ready():
                future = client.call_async(request)
        found = [one.status for one in future.result().touch.predictions]
        if found != [Status.OK, Status.BAD_GRASP, Status.OK] or node.internal_errors.counts():
            raise ConfigError(f"predict_touch: statuses {found}, internal errors {dict(node.internal_errors.counts())}")
    finally:
        node.stop()
        executor.shutdown(timeout_sec=1.0)
        rclpy.try_shutdown()


if __name__ == "__main__":
    from foretouch.models import available_models

    lines = [f' "{name}": {json.dumps(_answers(name))}' for name in sorted(available_models())]
    _EXPECTED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
