# SPDX-License-Identifier: Apache-2.0
"""Absurd messages, damaged bytes and absurd requests to the live graph, which runs in another process.

After each batch a good cloud must be answered bit-equal to before, the process must live, no answer may hold a number
that is not finite, no node may count an internal error, and the recording must go on.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
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
from std_srvs.srv import Trigger  # noqa: E402

from benchmarks.common import ROOT, write_csv  # noqa: E402
from benchmarks.fuzz import messages as valid  # noqa: E402
from benchmarks.fuzz.absurd import change, pick, value_of  # noqa: E402
from benchmarks.fuzz.driver import COLUMNS, OUTCOMES, parser  # noqa: E402
from benchmarks.fuzz.files import mutated  # noqa: E402
from foretouch_msgs.action import SampleGrasps  # noqa: E402
from foretouch_msgs.msg import GraspArray, RecorderStatus, Status, TouchPredictionArray  # noqa: E402
from foretouch_msgs.srv import LabelGrasp, PredictTouch, StartRecording, StopRecording  # noqa: E402

NODES = ("segmentation", "grasp", "touch_predictor", "recorder", "hand")
START_S = 120.0
BATCH = 50  # messages or requests between two checks
DAMAGED = 0.3  # share of the messages whose bytes are damaged


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
        self.not_finite: list[str] = []
        self.recorder: Any = None
        self.own = ""  # topic on which absurd messages are being sent from here
        self._sessions = 0
        self._known_errors: Counter[str] = Counter()
        for kind, topic, hear in (
            (TouchPredictionArray, "touch", self._hear_touch),
            (GraspArray, "grasps", self._hear_grasps),
            (RecorderStatus, "recorder_status", lambda message: setattr(self, "recorder", message)),
        ):
            self.node.create_subscription(kind, topic, hear, self.deep)
        self._publishers: dict[str, Any] = {}
        self._action = ActionClient(self.node, SampleGrasps, "sample_grasps")
        self.serve()
        self.start()

    def start(self) -> None:
        """Start the child, wait until all nodes are active, and begin a recording."""
        given = {
            "diagnostics_period_s": 0.2,
            "grasp_hold": 0.0,  # a held grasp would depend on the clouds before
            "scene.path": ROOT / "config" / "scenes" / "clean.yaml",
            "automatic": False,
            "folder": self.folder,
        }
        self.process = spawn(NODES, given, self.folder / "graph.log")
        with self.lock:
            self.reports.clear()
        self._known_errors.clear()
        self.wait(lambda: self.is_active(NODES), START_S, "the graph starts")
        self.record()

    def record(self) -> bool:
        """Begin another recording; False if it is refused."""
        self._sessions += 1
        request = StartRecording.Request(path=f"set-{self._sessions}", object="can")
        return bool(self.call(StartRecording, "start_recording", request).success)

    def close(self) -> None:
        """End the child."""
        end(self.process)

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
        cloud = valid.scene_message()
        for name in ("use_tare", "use_touches"):
            self.set_parameter("touch_predictor", name, False)
        self.touch.clear()
        sent: set[int] = set()
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

    def internal_errors(self) -> list[str]:
        """Internal errors that were counted since the last call."""
        since = time.monotonic()
        self.wait(lambda: all(self.report(name, since) for name in NODES), CALL_S, "diagnostics of all nodes")
        values = {f"{node}: {key}": value for node in NODES for key, value in self.report(node).items()}
        found = Counter({name: int(value) for name, value in values.items() if ": internal_errors." in name})
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
        self.touch[stamp_ns(message.header.stamp)] = message
        self.refused += message.status != 0
        try:
            valid.check_predictions(message)
        except (valid.NotFiniteError, valid.UnnamedError) as err:
            self.not_finite.append(f"touch: {err}")

    def _hear_grasps(self, message: Any) -> None:
        for one in message.grasps if self.own != "grasps" else ():
            if not np.isfinite(numbers := [*valid.contacts(one), *one.rotation]).all():
                self.not_finite.append(f"grasps: {numbers}")


def numbers_of(one: Any) -> list[Any]:
    """All numbers of a prediction, as they were sent."""
    ends = (one.scalars, one.values, one.scalars_lower, one.lower, one.scalars_upper, one.upper)
    intervals = [list(end) for end in ends]
    texts = repr(valid.contacts(one.grasp)), repr(list(one.grasp.rotation))
    return [one.status, *texts, one.grasp.score, repr(intervals)]


# --- what is sent -----------------------------------------------------------------------------------------------


def topics() -> dict[str, tuple[Sequence[Any], tuple[str, Any] | None, float]]:
    """By topic: valid messages, a valid message of another topic that completes a set, and a pause [s]."""
    clouds, table = valid.object_messages(), valid.table_message()
    return {
        "points": ([valid.scene_message()], None, 0.05),
        "object_cloud": (clouds, ("table", table), 0.03),
        "table": ([table], ("object_cloud", clouds[0]), 0.03),
        "grasps": ([valid.grasps_message()], ("object_cloud", clouds[0]), 0.03),
        "touch": ([valid.touch_message()], None, 0.01),
        "/rh/tactile": ([valid.tactile_message()], None, 0.005),
        "executed_grasp": ([valid.executed_message()], None, 0.01),
    }


def flood(graph: Graph, topic: str, rng: np.random.Generator, size: int) -> None:
    """A batch of absurd messages and of damaged bytes on one topic."""
    kept, other, pause = topics()[topic]
    graph.own = topic
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
    time.sleep(1.0)
    graph.own = ""


def judged(status: int, reason: str) -> str:
    """The outcome of an answer by its status."""
    if status == Status.FAILED or (status != Status.OK and not reason):
        return "uncaught"
    return "read" if status == Status.OK else "refused"


def ask_touch(graph: Graph, rng: np.random.Generator) -> str:
    """An absurd `predict_touch`."""
    arrays = bool(rng.integers(2))
    request = change(valid.array_request() if arrays else valid.touch_request(), rng)
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


PATHS = ("", "a" * 5000, "x\0y", "\n", "a/b/c", "set", "/dev/null/x", "/proc/self/x", "..", ".", "é\U0001f4a5", "-rf")


def ask_recording(graph: Graph, rng: np.random.Generator) -> str:
    """A recording that is begun twice, at absurd paths, or ended twice; at last, one that goes on."""
    if rng.random() < 0.5:
        graph.call(StopRecording, "stop_recording", StopRecording.Request())
    names = {"object": value_of("string", rng), "note": value_of("string", rng)}
    answer = graph.call(StartRecording, "start_recording", StartRecording.Request(path=pick(PATHS, rng), **names))
    graph.call(StopRecording, "stop_recording", StopRecording.Request())
    if not graph.record():
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
    result = graph.set_parameter(node, name, value)
    if result.successful:
        graph.send("points", valid.scene_message())
        time.sleep(0.1)
        graph.set_parameter(node, name, before)
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
    slowest, refused = 0.0, graph.refused
    try:
        if kind in TOPICS:
            flood(graph, kind, rng, size)
        for _ in range(0 if kind in TOPICS else size):
            began = time.monotonic()
            try:
                outcome = REQUESTS[kind](graph, rng)
            except (valid.NotFiniteError, valid.UnnamedError) as err:
                outcome = "uncaught"
                faults.append(f"uncaught: {err}")
            slowest = max(slowest, time.monotonic() - began)
            counts[outcome] += 1
        again = graph.answer()
        if again != expected:
            counts["changed in silence"] += 1
            faults.append(f"changed in silence: a good cloud is answered with {again} instead of {expected}"[:600])
        faults += [f"uncaught: {text}: {graph.log()}" for text in graph.internal_errors()]
        faults += [f"uncaught: {text}" for text in graph.not_finite[:3]]
        graph.not_finite.clear()
        if not graph.recorder.recording:
            faults.append(f"uncaught: the recording has ended: {graph.recorder.reason}")
            graph.record()
    except (ChildProcessError, TimeoutError) as err:
        outcome = "slow" if isinstance(err, TimeoutError) else "signal"
        faults.append(f"{outcome}: {err}: {graph.log()}")
        counts[outcome] += 1
        graph.close()
        graph.start()
    counts["uncaught"] = max(counts["uncaught"], sum(text.startswith("uncaught") for text in faults))
    if kind in TOPICS:
        counts["refused"] = min(graph.refused - refused, size)
        counts["read"] = max(0, size - counts.total())
    return counts, faults, slowest


def run(graph: Graph, kind: str, batches: int, size: int, seed: int, expected: Any) -> tuple[Mapping[str, Any], bool]:
    """A row of the table, and whether a rule was broken; prints a line for each fault."""
    total: Counter[str] = Counter()
    slowest, failed = 0.0, False
    for number in range(batches):
        rng = np.random.default_rng([seed, KINDS.index(kind), number])
        counts, faults, longest = batch(graph, kind, rng, expected, size)
        total += counts
        slowest, failed = max(slowest, longest), failed or bool(faults)
        print("".join(f"  {kind} {seed} {number}: {text}\n" for text in faults), end="", flush=True)
    row = {"kind": f"live {kind}", "cases": batches * size, **{outcome: total[outcome] for outcome in OUTCOMES}}
    return {**row, "slowest_ms": round(slowest * 1e3, 1)}, failed


def main() -> int:
    """Run all kinds; the exit status is 1 if a rule was broken."""
    options = parser(__doc__, KINDS, 1300)
    options.add_argument("--batch", type=int, default=BATCH, help=f"messages between two checks (default {BATCH})")
    arguments = options.parse_args()
    kinds, rows, failed = arguments.kind or KINDS, [], False
    print("  ".join(COLUMNS))
    with tempfile.TemporaryDirectory(prefix="foretouch-live-") as folder:
        graph = Graph(Path(folder))
        try:
            expected = graph.answer()
            if len(expected) < 2:
                raise SystemExit(f"the good cloud has no prediction: {expected}")
            batches = max(1, round(arguments.cases / len(kinds) / arguments.batch))
            for kind in kinds:
                row, broken = run(graph, kind, batches, arguments.batch, arguments.seed, expected)
                rows, failed = [*rows, row], failed or broken
                print("  ".join(str(value) for value in row.values()), flush=True)
        finally:
            graph.close()
            graph.leave()
    if arguments.out:
        write_csv(arguments.out, rows)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
