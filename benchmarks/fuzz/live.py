# SPDX-License-Identifier: Apache-2.0
"""Absurd messages, damaged bytes and absurd requests to the live graph, which runs in another process.

After each batch a good cloud must be answered bit-equal to before, the process must live, no answer may hold a number
that is not finite, no node may count an internal error, and the recording must go on.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ros import CALL_S, NAMESPACE, Client, end, prepare_domain, spawn, stamp_ns, stamped

DOMAIN = 92
prepare_domain(DOMAIN)

from rcl_interfaces.msg import ParameterValue  # noqa: E402
from rcl_interfaces.srv import GetParameters, ListParameters  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402

from benchmarks.common import ROOT, write_csv  # noqa: E402
from benchmarks.fuzz import messages as valid  # noqa: E402
from benchmarks.fuzz.changes import TEXTS, change, mutated, pick  # noqa: E402
from benchmarks.fuzz.driver import OUTCOMES, parser  # noqa: E402
from foretouch_msgs.action import SampleGrasps  # noqa: E402
from foretouch_msgs.msg import RecorderStatus, Status, TouchPredictionArray  # noqa: E402
from foretouch_msgs.srv import LabelGrasp, PredictTouch, StartRecording, StopRecording  # noqa: E402

NODES = ("segmentation", "grasp", "touch_predictor", "recorder", "hand")
START_S = 120.0
DAMAGED = 0.3  # share of the messages whose bytes are damaged
TOPICS = ("points", "object_cloud", "table", "grasps", "/rh/tactile", "executed_grasp")
PATHS = (*TEXTS, "a" * 5000, "x\0y", "a/b/c", "set", "/dev/null/x", "/proc/self/x", "..", ".", "-rf")


class Graph(Client):
    """The graph in a child process, and a node here that talks to it.

    Args:
        folder: For recordings and logs.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__("fuzzer", DOMAIN)
        self.folder = folder
        self.touch: dict[int, Any] = {}  # received predictions by stamp
        self.refused = 0
        self.faults: list[str] = []  # of received predictions
        self.recorder: Any = None
        self._sessions = 0
        self._known_errors: Counter[str] = Counter()
        self.node.create_subscription(TouchPredictionArray, "touch", self._hear_touch, self.deep)
        hear = lambda message: setattr(self, "recorder", message)  # noqa: E731
        self.node.create_subscription(RecorderStatus, "recorder_status", hear, self.deep)
        self._publishers: dict[str, Any] = {}
        self._action = ActionClient(self.node, SampleGrasps, "sample_grasps")
        self.serve()
        given = {
            "diagnostics_period_s": 0.2,
            "grasp_hold": 0.0,  # a held grasp would depend on the clouds before
            "scene.path": ROOT / "config" / "scenes" / "clean.yaml",
            "automatic": False,
            "folder": self.folder,
        }
        self.process = spawn(NODES, given, self.folder / "graph.log")
        self.wait(lambda: self.is_active(NODES), START_S, "the graph starts")
        self.record()

    def record(self) -> bool:
        """Begin another recording; False if it is refused."""
        self._sessions += 1
        request = StartRecording.Request(path=f"set-{self._sessions}", object="can")
        return bool(self.call(StartRecording, "start_recording", request).success)

    def wait(self, condition: Callable[[], Any], timeout_s: float, what: str = "an answer") -> bool:
        """Wait; a `TimeoutError` if it takes longer, a `ChildProcessError` if the graph has ended."""
        if not super().wait(lambda: self.process.poll() is not None or condition(), timeout_s):
            raise TimeoutError(f"{what}: not within {timeout_s:g} s")
        if self.process.poll() is not None:
            raise ChildProcessError(f"exit status {self.process.returncode}")
        return True

    def send(self, topic: str, message: Any, kind: type | None = None) -> None:
        """Publish a message, or serialised bytes of a type."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(kind or type(message), topic, self.deep)
            self.wait(self._publishers[topic].get_subscription_count, CALL_S, f"{topic}: a subscriber")
        self._publishers[topic].publish(message)

    def act(self, goal: Any) -> Any:
        """The result of the action; None for a goal that is rejected."""
        self.wait(self._action.server_is_ready, CALL_S, "sample_grasps: the action")
        accepted = self._action.send_goal_async(goal)
        self.wait(accepted.done, CALL_S, "sample_grasps: an acceptance")
        if not accepted.result().accepted:
            return None
        result = accepted.result().get_result_async()
        self.wait(result.done, CALL_S, "sample_grasps: a result")
        return result.result().result

    def answer(self) -> list[Any]:
        """The predictions for a good cloud from vision alone, as numbers."""
        cloud, sent = valid.scene_message(), set[int]()
        for name in ("use_tare", "use_touches"):
            self.set_parameter("touch_predictor", name, False)
        self.touch.clear()
        last = time.monotonic() + CALL_S
        while not (answered := sent & self.touch.keys()):  # an earlier flood may still fill the queues
            if time.monotonic() > last:
                raise TimeoutError("points: a good cloud is not answered")
            sent.add(stamped(cloud))
            self.send("points", cloud)
            with suppress(TimeoutError):
                self.wait(lambda: sent & self.touch.keys(), CALL_S / 10)
        message = self.touch[answered.pop()]
        for name in ("use_tare", "use_touches"):
            self.set_parameter("touch_predictor", name, True)
        return [message.status, *(numbers_of(one) for one in message.predictions)]

    def check(self, expected: Any) -> list[str]:
        """What is wrong after a batch: a line for each fault."""
        again = self.answer()
        faults = [] if again == expected else [f"changed in silence: answered with {again} instead of {expected}"[:600]]
        since = time.monotonic()
        self.wait(lambda: all(self.report(name, since) for name in NODES), CALL_S, "diagnostics of all nodes")
        values = {f"{node}: {key}": value for node in NODES for key, value in self.report(node).items()}
        found = Counter({name: int(value) for name, value in values.items() if ": internal_errors." in name})
        faults += [f"uncaught: {count} {name}: {self.log()}" for name, count in (found - self._known_errors).items()]
        faults += [f"uncaught: {text}" for text in self.faults[:3]]
        self._known_errors, self.faults = found, []
        if not self.recorder.recording:
            faults.append(f"uncaught: the recording has ended: {self.recorder.reason}")
            self.record()
        return faults

    def log(self) -> str:
        """The last errors in the log."""
        lines = (self.folder / "graph.log").read_text(errors="replace").splitlines()
        found = [line for line in lines if "internal error" in line or "Traceback" in line or "Error:" in line]
        return " | ".join(found[-2:])[-700:]

    def _hear_touch(self, message: Any) -> None:
        self.touch[stamp_ns(message.header.stamp)] = message
        self.refused += message.status != 0
        try:
            valid.check_predictions(message)
        except (valid.NotFiniteError, valid.UnnamedError) as err:
            self.faults.append(f"touch: {err}")


def numbers_of(one: Any) -> list[Any]:
    """All numbers of a prediction, as they were sent."""
    ends = (one.scalars, one.values, one.scalars_lower, one.lower, one.scalars_upper, one.upper)
    texts = repr(valid.contacts(one.grasp)), repr(list(one.grasp.rotation))
    return [one.status, *texts, one.grasp.score, repr([list(end) for end in ends])]


def flood(graph: Graph, topic: str, rng: np.random.Generator, size: int) -> None:
    """A batch of absurd messages and of damaged bytes on one topic."""
    clouds, table = valid.object_messages(), valid.table_message()
    kept, other = {  # valid messages, and one of another topic that completes a set
        "points": ([valid.scene_message()], None),
        "object_cloud": (clouds, ("table", table)),
        "table": ([table], ("object_cloud", clouds[0])),
        "grasps": ([valid.grasps_message()], ("object_cloud", clouds[0])),
        "/rh/tactile": ([valid.tactile_message()], None),
        "executed_grasp": ([valid.executed_message()], None),
    }[topic]
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
        time.sleep(0.03)
    time.sleep(1.0)


def judged(status: int, reason: str) -> str:
    """The outcome of an answer by its status."""
    if status == Status.FAILED or (status != Status.OK and not reason):
        return "uncaught"
    return "read" if status == Status.OK else "refused"


def ask_touch(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd `predict_touch`."""
    request = change(pick((valid.array_request, valid.touch_request), rng)(), rng)
    arrays = bool(len(request.contacts) or len(request.rotations))
    response = graph.call(PredictTouch, "predict_touch", request)
    message = response.batch if arrays else response.touch
    (valid.check_batch if arrays else valid.check_predictions)(message)
    return judged(message.status, message.reason)


def ask_samples(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd `sample_grasps`."""
    result = graph.act(change(valid.sample_goal(), rng))
    return "refused" if result is None else judged(result.status, result.grasp_state)


def ask_label(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd `label_grasp`."""
    answer = graph.call(LabelGrasp, "label_grasp", change(valid.label_request(), rng))
    return "read" if answer.success else judged(2, answer.message)


def ask_recording(graph: Graph, rng: np.random.Generator) -> str:
    """A recording that is begun twice, at absurd paths, or ended twice; at last, one that goes on."""
    if rng.random() < 0.5:
        graph.call(StopRecording, "stop_recording", StopRecording.Request())
    request = StartRecording.Request(path=pick(PATHS, rng), object=pick(TEXTS, rng), note=pick(TEXTS, rng))
    answer = graph.call(StartRecording, "start_recording", request)
    graph.call(StopRecording, "stop_recording", StopRecording.Request())
    if not graph.record():
        return "uncaught"
    return "read" if answer.success else judged(2, answer.message)


def ask_parameter(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd value of a parameter that can be changed; it is set back afterwards."""
    node = pick(NODES, rng)
    names = graph.call(ListParameters, f"{NAMESPACE}/{node}/list_parameters", ListParameters.Request()).result.names
    name = pick(sorted(n for n in names if not n.startswith(("qos_overrides", "use_sim_time", "start_type"))), rng)
    known = graph.call(GetParameters, f"{NAMESPACE}/{node}/get_parameters", GetParameters.Request(names=[name]))
    value = change(ParameterValue(type=int(rng.integers(0, 12))), rng)
    if rng.random() < 0.5:
        value.type = known.values[0].type
    result = graph.set_parameter(node, name, value)
    if result.successful:
        graph.send("points", valid.scene_message())
        time.sleep(0.1)
        graph.set_parameter(node, name, known.values[0])
    return "read" if result.successful else judged(2, result.reason)


REQUESTS: dict[str, Callable[[Graph, np.random.Generator], str]] = {
    "predict_touch": ask_touch,
    "sample_grasps": ask_samples,
    "label_grasp": ask_label,
    "start_recording": ask_recording,
    "set_parameters": ask_parameter,
}
KINDS = (*TOPICS, *REQUESTS)


def batch(graph: Graph, kind: str, rng: np.random.Generator, expected: Any, size: int) -> tuple[Any, list[str], float]:
    """One batch and the checks after it: outcomes, faults, and the longest answer to a request [s]."""
    counts: Counter[str] = Counter()
    faults: list[str] = []
    slowest, refused = 0.0, graph.refused
    if kind in TOPICS:
        flood(graph, kind, rng, size)
    for _ in range(0 if kind in TOPICS else size):
        began = time.monotonic()
        try:
            counts[REQUESTS[kind](graph, rng)] += 1
        except (valid.NotFiniteError, valid.UnnamedError) as err:
            faults.append(f"uncaught: {err}")
        slowest = max(slowest, time.monotonic() - began)
    faults += graph.check(expected)
    counts.update(text.partition(":")[0] for text in faults)
    if kind in TOPICS:
        counts["refused"] = min(graph.refused - refused, size)
        counts["read"] = max(0, size - counts.total())
    return counts, faults, slowest


def main() -> int:
    """Run all kinds; the exit status is 1 if a rule was broken, and an error if the graph ends or does not answer."""
    options = parser(__doc__.splitlines()[0], KINDS, 1200)
    options.add_argument("--batch", type=int, default=50, help="messages between two checks (default 50)")
    arguments = options.parse_args()
    kinds, rows, size = arguments.kind or KINDS, [], arguments.batch
    with tempfile.TemporaryDirectory(prefix="foretouch-live-") as folder:
        graph = Graph(Path(folder))
        try:
            expected = graph.answer()
            if len(expected) < 2:
                raise SystemExit(f"the good cloud has no prediction: {expected}")
            batches = max(1, round(arguments.cases / len(kinds) / size))
            for kind in kinds:
                total, slowest = Counter[str](), 0.0
                for number in range(batches):
                    rng = np.random.default_rng([arguments.seed, KINDS.index(kind), number])
                    counts, faults, longest = batch(graph, kind, rng, expected, size)
                    total, slowest = total + counts, max(slowest, longest)
                    print("".join(f"  {kind} {number}: {text}\n" for text in faults), end="", flush=True)
                row = {"kind": f"live {kind}", "cases": batches * size} | {name: total[name] for name in OUTCOMES}
                rows.append({**row, "slowest_ms": round(slowest * 1e3, 1)})
                print("  ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
        except (ChildProcessError, TimeoutError):
            print(graph.log())
            raise
        finally:
            end(graph.process)
            graph.leave()
    if arguments.out:
        write_csv(arguments.out, rows)
    return int(any(row[outcome] for row in rows for outcome in OUTCOMES[2:]))


if __name__ == "__main__":
    sys.exit(main())
