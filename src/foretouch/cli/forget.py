# SPDX-License-Identifier: Apache-2.0
"""`foretouch forget`: let a running graph forget readings, where there is no `ros2 service call`."""

import argparse

from foretouch.cli.inputs import add_options, positive_value
from foretouch.cli.output import print_json
from foretouch.errors import ForetouchError
from foretouch.ros.graph import checked_namespace
from foretouch.ros.runtime.environment import start_rclpy
from foretouch.topics import NAMESPACE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What is forgotten, and by which graph."""
    text = "touches: the readings of the current object, after it was replaced; history: all readings of the hand"
    parser.add_argument("what", metavar="touches|history", choices=["touches", "history"], help=text)
    add_options(parser, "--namespace")
    parser.add_argument("--wait", type=positive_value, default=5.0, metavar="S", help="longest wait for the graph [s]")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if there is no graph, or it does not answer."""
    namespace = checked_namespace(arguments.namespace or NAMESPACE)
    start_rclpy([])
    import rclpy
    from std_srvs.srv import Trigger

    name = f"{namespace.rstrip('/')}/forget_{arguments.what}"
    node = rclpy.create_node("forget", namespace=namespace)
    try:
        client = node.create_client(Trigger, name)  # type: ignore[var-annotated]
        if not client.wait_for_service(timeout_sec=arguments.wait):
            raise ForetouchError(f"{name}: no such service within {arguments.wait:g} s: is the graph running?")
        future = client.call_async(Trigger.Request())
        rclpy.spin_until_future_complete(node, future, timeout_sec=arguments.wait)
        if (answer := future.result()) is None:
            raise ForetouchError(f"{name}: no answer within {arguments.wait:g} s")
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    if arguments.json:
        print_json({"forgotten": arguments.what, "success": answer.success, "message": answer.message})
    else:
        print(answer.message)
    return int(not answer.success)
