# SPDX-License-Identifier: Apache-2.0
"""What benchmarks of the ROS graph need: a client in a ROS domain of its own, and nodes in child processes."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmarks.common import ROOT
from foretouch.ros.runtime.environment import prepare_environment

NAMESPACE: Final = "/foretouch"
SECOND: Final = 1_000_000_000
CALL_S: Final = 30.0  # that an answer may take on a busy computer


@dataclass(frozen=True)
class Report:
    """Diagnostics of one node in one process."""

    time_s: float  # `time.monotonic`
    values: Mapping[str, str]


class Client:
    """A node in this process that one thread serves; `reports` holds the latest diagnostics by node and process.

    Args:
        name: Of the node.
        domain: ROS domain, also of child processes.
    """

    def __init__(self, name: str, domain: int) -> None:
        prepare_domain(domain)
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        if not rclpy.ok():
            rclpy.init()
        self.node = rclpy.create_node(name, namespace=NAMESPACE)
        self.reports: dict[tuple[str, str], Report] = {}
        self.lock = threading.Lock()
        self.deep = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
        self._clients: dict[str, Any] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, self.deep)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)

    def serve(self) -> None:
        """Start the thread, once all subscriptions are made."""
        self._thread.start()

    def leave(self) -> None:
        """Leave the graph; a process that ends while its thread serves is aborted by the middleware of Jazzy now and then."""
        import rclpy

        self._executor.shutdown(timeout_sec=1.0)
        self._thread.join(2.0)
        self.node.destroy_node()
        rclpy.try_shutdown()

    def reported(self, node: str, before: Report | None, now: Report) -> None:
        """Called with each report of a node, and the one before of the same process."""

    def report(self, node: str) -> Mapping[str, str]:
        """Return the values of the latest report of a node; empty if there is none."""
        with self.lock:
            reports = [report for (name, _), report in self.reports.items() if name == node]
        return max(reports, key=lambda report: report.time_s).values if reports else {}

    def reported_at(self, node: str) -> float:
        """Return the time of the latest report of a node (`time.monotonic`) [s]; 0 if there is none."""
        with self.lock:
            return max((report.time_s for (name, _), report in self.reports.items() if name == node), default=0.0)

    def is_active(self, nodes: Sequence[str]) -> bool:
        """Return whether each node has reported that it is active."""
        return all(self.report(name).get("state") == "active" for name in nodes)

    def wait(self, condition: Callable[[], Any], timeout_s: float) -> bool:
        """Wait until a condition holds; False if it does not in time."""
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(0.005)
        return True

    def call(self, kind: type, name: str, request: Any) -> Any:
        """Return the answer of a service; None if there is none in time."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        if not self.wait(client.service_is_ready, CALL_S):
            return None
        future = client.call_async(request)
        return future.result() if self.wait(future.done, CALL_S) else None

    def set_parameter(self, node: str, name: str, value: Any) -> Any:
        """Return the result of setting a parameter; None without an answer."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        answer = self.call(SetParameters, f"{NAMESPACE}/{node}/set_parameters", request)
        return None if answer is None else answer.results[0]

    def _diagnose(self, message: Any) -> None:
        now = time.monotonic()
        with self.lock:
            for status in message.status:
                report = Report(now, {pair.key: pair.value for pair in status.values})
                key = status.name.rpartition("/")[2], report.values.get("pid", "")  # 0.3 names no process
                self.reported(key[0], self.reports.get(key), report)
                self.reports[key] = report


def prepare_domain(domain: int) -> None:
    """Let this process and its children use a ROS domain of this machine only."""
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    prepare_environment()


def spawn(nodes: Sequence[str], parameters: Mapping[str, Any], log: Path | None = None) -> subprocess.Popen[bytes]:
    """Start nodes in a child process.

    Args:
        nodes: Names.
        parameters: Of all of them.
        log: File that receives what the child writes, after what it holds; else it is not kept.
    """
    code = (
        "import sys; from foretouch.ros.executables import run; n = sys.argv.index('--ros-args'); "
        "sys.exit(run(*sys.argv[1:n], args=[sys.argv[0], *sys.argv[n:]]))"
    )
    given = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
    command = [sys.executable, "-c", code, *nodes, "--ros-args", *given]
    with (log or Path(os.devnull)).open("ab") as file:
        return subprocess.Popen(command, stdout=file, stderr=file, cwd=ROOT)


def end(process: subprocess.Popen[bytes], timeout_s: float = 20.0) -> bool:
    """End a child with SIGTERM, or after some time with SIGKILL; returns whether SIGTERM was enough.

    SIGINT would be ignored by children of what a shell started in the background.
    """
    process.terminate()
    try:
        process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True


def stamp_ns(stamp: Any) -> int:
    """Return the nanoseconds of a stamp."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def stamped(*messages: Any) -> int:
    """Give messages the stamp of now; returns it [ns]."""
    now = time.time_ns()
    for message in messages:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, SECOND)
    return now
