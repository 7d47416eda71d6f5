# SPDX-License-Identifier: Apache-2.0
"""The ROS row of the self-test: a cloud over DDS, and a hostile request to a running node.

`python -m foretouch.ros.self_test` prints one line of JSON. It talks on this machine only, in a domain and a namespace
of its own, so that a running robot is not disturbed.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from foretouch.errors import ConfigError, ForetouchError
from foretouch.ros.runtime.environment import prepare_environment
from foretouch.selftest.rows import RowResult

_FIX = "foretouch doctor: check rclpy, foretouch_msgs and shared memory"
_PATIENCE_S = 20.0


def check() -> RowResult:
    """Run the row; it is skipped where ROS 2 or the messages are not installed."""
    began = time.monotonic()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    prepare_environment()
    try:
        import rclpy

        import foretouch_msgs.msg  # noqa: F401
    except ImportError as err:
        return RowResult("ROS", "skipped", f"not installed: {err}")
    rclpy.init(domain_id=60 + os.getpid() % 40)
    try:
        steps = _run()
    except ForetouchError as err:
        return RowResult("ROS", "failed", "stopped", str(err), _FIX, time.monotonic() - began)
    finally:
        rclpy.try_shutdown()
    return RowResult("ROS", "ok", ", ".join(steps), seconds=time.monotonic() - began)


def _run() -> list[str]:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    from foretouch.ros.executables import make_nodes

    namespace = f"/foretouch_self_test_{os.getpid()}"
    probe = Node("probe", namespace=namespace)
    (node,) = make_nodes("touch_predictor", namespace=namespace)
    executor = SingleThreadedExecutor()
    try:
        executor.add_node(probe)
        executor.add_node(node)
        node.autostart()

        def wait(done: Callable[[], Any], what: str) -> None:
            end = time.monotonic() + _PATIENCE_S
            while not done():
                if time.monotonic() > end:
                    raise ConfigError(f"{what}: nothing in {_PATIENCE_S:g} s")
                executor.spin_once(timeout_sec=0.05)

        return [_round_trip(probe, wait), _hostile_request(probe, wait, node)]
    finally:
        node.stop()
        executor.shutdown(timeout_sec=1.0)
        node.destroy_node()
        probe.destroy_node()


def _round_trip(probe: Any, wait: Callable[[Callable[[], Any], str], None]) -> str:
    """Publish a cloud until it arrives, and compare it."""
    from sensor_msgs.msg import PointCloud2

    from foretouch.dataset.messages import decode_cloud
    from foretouch.ros.messages.clouds import cloud_to_msg
    from foretouch.selftest.references import exact_cloud

    received: list[Any] = []
    probe.create_subscription(PointCloud2, "cloud", received.append, 1)
    publisher = probe.create_publisher(PointCloud2, "cloud", 1)
    cloud = exact_cloud()

    def sent() -> bool:
        if not received and publisher.get_subscription_count():
            publisher.publish(cloud_to_msg(cloud))
        return bool(received)

    wait(sent, "a cloud over DDS")
    if not np.array_equal(decode_cloud(received[0]).xyz, cloud.xyz):
        raise ConfigError("a cloud over DDS: other points arrived")
    return "cloud over DDS"


def _hostile_request(probe: Any, wait: Callable[[Callable[[], Any], str], None], node: Any) -> str:
    """Ask for three grasps, one of them 1e160 m wide, and then for a good one."""
    from foretouch.ros.messages.clouds import cloud_to_msg
    from foretouch.ros.messages.conversions import grasp_to_msg
    from foretouch.selftest.references import exact_cloud, exact_grasps
    from foretouch_msgs.msg import Status
    from foretouch_msgs.srv import PredictTouch

    client = probe.create_client(PredictTouch, "predict_touch")
    wait(client.service_is_ready, "predict_touch")

    def ask(width_m: float) -> list[int]:
        request = PredictTouch.Request(cloud=cloud_to_msg(exact_cloud()))
        request.grasps = [grasp_to_msg(grasp) for grasp in exact_grasps()]
        if width_m:
            request.grasps[1].g1.x = width_m
        future = client.call_async(request)
        wait(future.done, "predict_touch")
        return [one.status for one in future.result().touch.predictions]

    for width_m, expected in ((1e160, [Status.OK, Status.BAD_GRASP, Status.OK]), (0.0, [Status.OK] * 3)):
        found = ask(width_m)
        if found != expected:
            raise ConfigError(f"predict_touch: the statuses are {found}, not {expected}")
    if node.internal_errors.counts():
        raise ConfigError(f"touch_predictor: internal errors: {dict(node.internal_errors.counts())}")
    return "hostile request refused"


if __name__ == "__main__":
    sys.stdout.write(json.dumps({"row": "ROS", "state": "running"}) + "\n")
    sys.stdout.flush()
    result = check()
    sys.stdout.write(json.dumps(result.to_mapping()) + "\n")
    sys.stdout.flush()
    sys.exit(int(result.state == "failed"))
