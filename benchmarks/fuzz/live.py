# SPDX-License-Identifier: Apache-2.0
"""Absurd messages, damaged bytes and absurd requests to the live graph, which runs in another process.

After each batch a good cloud must be answered bit-equal to before, the process must live, no answer may hold a number
that is not finite, no node may count an internal error, and the recording must go on.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

DOMAIN = 92
os.environ.update(ROS_DOMAIN_ID=str(DOMAIN), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")

from foretouch.ros.runtime.environment import prepare_environment  # noqa: E402

prepare_environment()

import rclpy  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rcl_interfaces.msg import Parameter, ParameterValue  # noqa: E402
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter as PythonParameter  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from benchmarks.common import ROOT, write_csv  # noqa: E402
from benchmarks.fuzz import messages as valid  # noqa: E402
from benchmarks.fuzz.absurd import change, pick, value_of  # noqa: E402
from benchmarks.fuzz.driver import COLUMNS, parser  # noqa: E402
from benchmarks.fuzz.files import mutated  # noqa: E402
from foretouch_msgs.action import SampleGrasps  # noqa: E402
from foretouch_msgs.msg import GraspArray, RecorderStatus, Status, TouchPredictionArray  # noqa: E402
from foretouch_msgs.srv import LabelGrasp, PredictTouch, StartRecording, StopRecording  # noqa: E402

NAMESPACE = "/foretouch"
NODES = ("segmentation", "grasp", "touch_predictor", "recorder", "hand")
SCENE = ROOT / "config" / "scenes" / "clean.yaml"
START_S = 120.0
ANSWER_S = 30.0  # that an answer may take on a busy computer
BATCH = 50  # messages or requests between two checks
DAMAGED = 0.3  # share of the messages whose bytes are damaged


@dataclass
class Heard:
    """What the graph has sent."""

    touch: dict[int, Any] = field(default_factory=dict)  # by stamp
    refused: int = 0
    not_finite: list[str] = field(default_factory=list)
    reports: dict[str, tuple[float, dict[str, str]]] = field(default_factory=dict)  # diagnostics by node
    recorder: Any = None


class Graph:
    """The graph in a child process, and a node here that talks to it.

    Args:
        folder: For recordings and logs.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.heard = Heard()
        self.sessions = 0
        self.own = ""  # topic on which absurd messages are being sent from here
        self._known_errors: Counter[str] = Counter()

        rclpy.init()
        self.node = rclpy.create_node("fuzzer", namespace=NAMESPACE)
        self._deep = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
        for kind, topic, heard in (
            (TouchPredictionArray, "touch", self._hear_touch),
            (GraspArray, "grasps", self._hear_grasps),
            (RecorderStatus, "recorder_status", lambda message: setattr(self.heard, "recorder", message)),
            (DiagnosticArray, "/diagnostics", self._hear_diagnostics),
        ):
            self.node.create_subscription(kind, topic, heard, self._deep)
        self.publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._action = ActionClient(self.node, SampleGrasps, "sample_grasps")
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        threading.Thread(target=executor.spin, daemon=True).start()
        self.start()

    def start(self) -> None:
        """Start the child, wait until all nodes are active, and begin a recording."""
        given: dict[str, Any] = {
            "diagnostics_period_s": 0.2,
            "grasp_hold": 0.0,  # a held grasp would depend on the clouds before
            "scene.path": SCENE,
            "automatic": False,
            "folder": self.folder,
        }
        words = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
        code = f"import sys; from foretouch.ros.executables import run; sys.exit(run(*{NODES!r}))"
        with (self.folder / "graph.log").open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", code, "--ros-args", *words], stdout=log, stderr=subprocess.STDOUT
            )
        self.heard.reports.clear()
        self._known_errors.clear()
        self.until(lambda: all(self.report(n).get("state") == "active" for n in NODES), START_S, "the graph starts")
        self.sessions += 1
        self.call(StartRecording, "start_recording", StartRecording.Request(path=f"set-{self.sessions}", object="can"))

    def close(self) -> None:
        """End the child."""
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(20.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def report(self, node: str, since: float = 0.0) -> dict[str, str]:
        """The last diagnostics of a node; empty if they are older than that."""
        time_s, values = self.heard.reports.get(node, (0.0, {}))
        return values if time_s >= since else {}

    def until(self, condition: Callable[[], Any], timeout_s: float, what: str) -> None:
        """Wait; a `TimeoutError` if it takes longer, a `ChildProcessError` if the graph has ended."""
        end = time.monotonic() + timeout_s
        while not condition():
            if self.process.poll() is not None:
                raise ChildProcessError(f"exit status {self.process.returncode}")
            if time.monotonic() > end:
                raise TimeoutError(f"{what}: not within {timeout_s:g} s")
            time.sleep(0.005)

    def send(self, topic: str, message: Any, kind: type | None = None) -> None:
        """Publish a message, or serialised bytes of a type."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(kind or type(message), topic, self._deep)
            self.until(self.publishers[topic].get_subscription_count, ANSWER_S, f"{topic}: a subscriber")
        self.publishers[topic].publish(message)

    def call(self, kind: type, name: str, request: Any) -> Any:
        """The answer of a service."""
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(kind, name)
        self.until(client.service_is_ready, ANSWER_S, f"{name}: the service")
        future = client.call_async(request)
        self.until(future.done, ANSWER_S, f"{name}: an answer")
        return future.result()

    def act(self, goal: Any) -> Any:
        """The result of the action; None for a goal that is rejected."""
        self.until(self._action.server_is_ready, ANSWER_S, "sample_grasps: the action")
        accepted = self._action.send_goal_async(goal)
        self.until(accepted.done, ANSWER_S, "sample_grasps: an acceptance")
        if not accepted.result().accepted:
            return None
        result = accepted.result().get_result_async()
        self.until(result.done, ANSWER_S, "sample_grasps: a result")
        return result.result().result

    def set(self, node: str, name: str, value: Any) -> Any:
        """Set a parameter; `value` is a `ParameterValue`, or a value of Python."""
        if not isinstance(value, ParameterValue):
            value = PythonParameter(name, value=value).get_parameter_value()
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        return self.call(SetParameters, f"{NAMESPACE}/{node}/set_parameters", request).results[0]

    def answer(self, cloud: Any) -> list[Any]:
        """The predictions for a cloud from vision alone, as numbers."""
        for name in ("use_tare", "use_touches"):
            self.set("touch_predictor", name, False)
        self.heard.touch.clear()
        sent: set[int] = set()
        end = time.monotonic() + ANSWER_S
        while not (answered := sent & self.heard.touch.keys()):  # an earlier flood may still fill the queues
            if time.monotonic() > end:
                raise TimeoutError("points: a good cloud is not answered")
            sent.add(stamped(cloud))
            self.send("points", cloud)
            with suppress(TimeoutError):
                self.until(lambda: sent & self.heard.touch.keys(), ANSWER_S / 10, "an answer")
        message = self.heard.touch[answered.pop()]
        for name in ("use_tare", "use_touches"):
            self.set("touch_predictor", name, True)
        return [message.status, *(numbers_of(one) for one in message.predictions)]

    def internal_errors(self) -> list[str]:
        """Internal errors that were counted since the last call."""
        since = time.monotonic()
        self.until(lambda: all(self.report(n, since) for n in NODES), ANSWER_S, "diagnostics of all nodes")
        found = Counter(
            {
                f"{node}: {key}": int(value)
                for node in NODES
                for key, value in self.report(node).items()
                if key.startswith("internal_errors.")
            }
        )
        new, self._known_errors = found - self._known_errors, found
        return [f"{count} {name}" for name, count in new.items()]

    def log(self) -> str:
        """The last errors in the log."""
        lines = (self.folder / "graph.log").read_text(errors="replace").splitlines()
        found = [line for line in lines if "internal error" in line or "Traceback" in line or "Error:" in line]
        return " | ".join(found[-2:])[-700:]

    def _hear_touch(self, message: Any) -> None:
        if self.own == "touch":
            return
        self.heard.touch[valid_stamp(message.header.stamp)] = message
        self.heard.refused += message.status != 0
        if message.status and not message.reason:
            self.heard.not_finite.append(f"touch: status {message.status} without a reason")
        try:
            valid.check_predictions(message)
        except (valid.NotFiniteError, valid.UnnamedError) as err:
            self.heard.not_finite.append(f"touch: {err}")

    def _hear_grasps(self, message: Any) -> None:
        if self.own == "grasps":
            return
        for one in message.grasps:
            numbers = [one.g1.x, one.g1.y, one.g1.z, one.g2.x, one.g2.y, one.g2.z, *one.rotation]
            if not np.isfinite(numbers).all():
                self.heard.not_finite.append(f"grasps: {numbers}")

    def _hear_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.heard.reports[status.name.rpartition("/")[2]] = (time.monotonic(), values)


def valid_stamp(stamp: Any) -> int:
    """Nanoseconds of a stamp."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def stamped(*sent: Any) -> int:
    """Give messages the stamp of now; returns it [ns]."""
    now = time.time_ns()
    for message in sent:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 1_000_000_000)
    return now


def numbers_of(one: Any) -> list[Any]:
    """All numbers of a prediction, as they were sent."""
    grasp = one.grasp
    contacts = [grasp.g1.x, grasp.g1.y, grasp.g1.z, grasp.g2.x, grasp.g2.y, grasp.g2.z]
    intervals = [(i.value, i.lower, i.upper) for i in (one.pdc_th, one.pdc_mf, *one.e_th, *one.e_mf)]
    return [one.status, repr(contacts), repr(list(grasp.rotation)), grasp.score, repr(intervals)]


# --- what is sent -----------------------------------------------------------------------------------------------


def topics() -> dict[str, tuple[Sequence[Any], tuple[str, Any] | None, float]]:
    """By topic: valid messages, a valid message of another topic that completes a set, and a pause [s]."""
    clouds, tables = valid.object_messages(), valid.table_message()
    return {
        "points": ([valid.scene_message()], None, 0.05),
        "object_cloud": (clouds, ("table", tables), 0.03),
        "table": ([tables], ("object_cloud", clouds[0]), 0.03),
        "grasps": ([valid.grasps_message()], ("object_cloud", clouds[0]), 0.03),
        "touch": ([valid.touch_message()], None, 0.01),
        "/rh/tactile": ([valid.tactile_message()], None, 0.005),
        "executed_grasp": ([valid.executed_message()], None, 0.01),
    }


def flood(graph: Graph, topic: str, rng: np.random.Generator, size: int) -> None:
    """A batch of absurd messages and of damaged bytes on one topic."""
    kept, other, pause = topics()[topic]
    for _ in range(size):
        message = pick(kept, rng)
        stamped(message, *(other[1:] if other else ()))
        if other:
            graph.send(*other)
        data = bytes(serialize_message(message))
        if rng.random() < DAMAGED:
            graph.send(topic, data[:4] + mutated(data[4:], rng), type(message))
        else:
            graph.send(topic, change(deserialize_message(data, type(message)), rng))
        time.sleep(pause)


def judged(status: int, reason: str) -> str:
    """The outcome of an answer by its status."""
    if status == Status.FAILED or (status != Status.OK and not reason):
        return "uncaught"
    return "read" if status == Status.OK else "refused"


def ask_touch(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd `predict_touch`."""
    message = graph.call(PredictTouch, "predict_touch", change(valid.touch_request(), rng)).touch
    valid.check_predictions(message)
    return judged(message.status, message.reason)


def ask_samples(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd `sample_grasps`."""
    result = graph.act(change(valid.sample_goal(), rng))
    return "refused" if result is None else judged(result.status, result.grasp_state)


def ask_label(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd `label_grasp`."""
    answer = graph.call(LabelGrasp, "label_grasp", change(valid.label_request(), rng))
    return "read" if answer.success else judged(2, answer.message)


PATHS = (
    "",
    "a" * 5000,
    "x\0y",
    "\n",
    "a/b/c",
    "set",
    "/dev/null/x",
    "/proc/self/x",
    "..",
    ".",
    "\u00e9\U0001f4a5",
    "-rf",
)


def ask_recording(graph: Graph, rng: np.random.Generator) -> str:
    """A recording that is begun twice, at absurd paths, or ended twice; at last, one that goes on."""
    if rng.random() < 0.5:
        graph.call(StopRecording, "stop_recording", StopRecording.Request())
    request = StartRecording.Request(
        path=pick(PATHS, rng), object=value_of("string", rng), note=value_of("string", rng)
    )
    answer = graph.call(StartRecording, "start_recording", request)
    graph.call(StopRecording, "stop_recording", StopRecording.Request())
    graph.sessions += 1
    again = StartRecording.Request(path=f"set-{graph.sessions}", object="can")
    if not graph.call(StartRecording, "start_recording", again).success:
        return "uncaught"
    return "read" if answer.success else judged(2, answer.message)


def ask_trigger(graph: Graph, rng: np.random.Generator) -> str:
    """`forget_touches` or `execute_grasp`."""
    answer = graph.call(Trigger, pick(("forget_touches", "execute_grasp"), rng), Trigger.Request())
    return "read" if answer.success else judged(2, answer.message)


def ask_parameter(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd value of a parameter that can be changed; it is set back afterwards."""
    node = pick(NODES, rng)
    names = graph.call(ListParameters, f"{NAMESPACE}/{node}/list_parameters", ListParameters.Request()).result.names
    name = pick(sorted(n for n in names if not n.startswith(("qos_overrides", "use_sim_time", "start_type"))), rng)
    known = graph.call(GetParameters, f"{NAMESPACE}/{node}/get_parameters", GetParameters.Request(names=[name]))
    before = known.values[0]
    value = change(ParameterValue(type=int(rng.integers(0, 12))), rng)
    if rng.random() < 0.5:
        value.type = before.type
    result = graph.set(node, name, value)
    if result.successful:
        graph.send("points", valid.scene_message())
        time.sleep(0.1)
        graph.set(node, name, before)
    return "read" if result.successful else judged(2, result.reason)


REQUESTS: dict[str, Callable[[Graph, np.random.Generator], str]] = {
    "predict_touch": ask_touch,
    "sample_grasps": ask_samples,
    "label_grasp": ask_label,
    "start_recording": ask_recording,
    "forget_touches": ask_trigger,
    "set_parameters": ask_parameter,
}
TOPICS = ("points", "object_cloud", "table", "grasps", "touch", "/rh/tactile", "executed_grasp")
KINDS = (*TOPICS, *REQUESTS)


# --- the course -------------------------------------------------------------------------------------------------


def batch(
    graph: Graph, kind: str, rng: np.random.Generator, expected: Any, size: int
) -> tuple[Counter[str], list[str], float]:
    """One batch and the checks after it: outcomes, faults, and the longest answer to a request [s]."""
    counts: Counter[str] = Counter()
    faults: list[str] = []
    slowest = 0.0
    refused = graph.heard.refused
    try:
        if kind in TOPICS:
            graph.own = kind
            flood(graph, kind, rng, size)
            time.sleep(1.0)
            graph.own = ""
        for _ in range(0 if kind in TOPICS else size):
            began = time.monotonic()
            try:
                outcome = REQUESTS[kind](graph, rng)
            except (valid.NotFiniteError, valid.UnnamedError) as err:
                outcome = "uncaught"
                faults.append(f"uncaught: {err}")
            slowest = max(slowest, time.monotonic() - began)
            counts[outcome] += 1
        again = graph.answer(valid.scene_message())
        if again != expected:
            counts["changed in silence"] += 1
            faults.append(f"changed in silence: a good cloud is answered with {again} instead of {expected}"[:600])
        faults += [f"uncaught: {text}: {graph.log()}" for text in graph.internal_errors()]
        faults += [f"uncaught: {text}" for text in graph.heard.not_finite[:3]]
        graph.heard.not_finite.clear()
        if not graph.heard.recorder.recording:
            faults.append(f"uncaught: the recording has ended: {graph.heard.recorder.reason}")
            ask_recording(graph, rng)
    except ChildProcessError as err:
        faults.append(f"signal: {err}: {graph.log()}")
        counts["signal"] += 1
        graph.start()
    except TimeoutError as err:
        faults.append(f"slow: {err}")
        counts["slow"] += 1
        graph.close()
        graph.start()
    counts["uncaught"] = max(counts["uncaught"], sum(text.startswith("uncaught") for text in faults))
    if kind in TOPICS:
        counts["refused"] = min(graph.heard.refused - refused, size)
        counts["read"] = max(0, size - counts.total())
    return counts, faults, slowest


def run(
    cases: int, seed: int, kinds: Sequence[str] = KINDS, size: int = BATCH
) -> tuple[list[dict[str, Any]], list[str]]:
    """Rows of the table, and a line for each fault."""
    rows, faults = [], []
    with tempfile.TemporaryDirectory(prefix="foretouch-live-") as name:
        graph = Graph(Path(name))
        try:
            expected = graph.answer(valid.scene_message())
            if len(expected) < 2:
                raise SystemExit(f"the good cloud has no prediction: {expected}")
            for kind in kinds:
                total: Counter[str] = Counter()
                slowest = 0.0
                batches = max(1, round(cases / len(kinds) / size))
                for k in range(batches):
                    rng = np.random.default_rng([seed, KINDS.index(kind), k])
                    counts, found, slow = batch(graph, kind, rng, expected, size)
                    total += counts
                    slowest = max(slowest, slow)
                    faults += [f"{kind} {seed} {k}: {text}" for text in found]
                    for text in found:
                        print(f"  {kind} {seed} {k}: {text}", flush=True)
                row = {"kind": f"live {kind}", "cases": batches * size, **{c: total[c] for c in COLUMNS[2:-1]}}
                rows.append({**row, "slowest_ms": round(slowest * 1e3, 1)})
                print("  ".join(str(value) for value in rows[-1].values()), flush=True)
        finally:
            graph.close()
    return rows, faults


def main() -> int:
    """Run all kinds; the exit status is 1 if a rule was broken."""
    options = parser(__doc__, KINDS, 1300)
    options.add_argument("--batch", type=int, default=BATCH, help=f"messages between two checks (default {BATCH})")
    arguments = options.parse_args()
    print("  ".join(COLUMNS))
    rows, faults = run(arguments.cases, arguments.seed, arguments.kind or KINDS, arguments.batch)
    if arguments.out:
        write_csv(arguments.out, rows)
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
