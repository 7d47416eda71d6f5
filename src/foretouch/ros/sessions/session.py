# SPDX-License-Identifier: Apache-2.0
"""One recording session: a thread that takes messages out of the queue, writes them, and assembles samples.

The thread owns the writer, so that waiting for the disk delays no callback. Its `status` is a value that is replaced
as a whole after each batch of messages.
"""

import math
import threading
import time
import traceback
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

from foretouch.cloud.messages import decode_objects, read_header
from foretouch.dataset.labelling.assembler import Role, SampleAssembler
from foretouch.dataset.labelling.buffers import SeenObjects
from foretouch.dataset.labelling.matcher import Label, RejectedGrasp
from foretouch.dataset.recordings.records import TopicCounts
from foretouch.dataset.recordings.sample_codec import SAMPLE_TOPIC
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.errors import FileError, ForetouchError
from foretouch.ros.messages.conversions import duration_to_msg
from foretouch.ros.messages.requests import read_serialized
from foretouch.ros.runtime.subscription import SerializedMessage, type_name
from foretouch.ros.sessions.hold_evaluator import HoldEvaluator
from foretouch.ros.sessions.operator import Action, Operator, OperatorState
from foretouch.ros.sessions.subscriptions import MessageQueue, RecorderInputs, names_and_counts
from foretouch.types import Sample, stamp_ns
from foretouch_msgs.msg import RecorderStatus, Status, TouchHold, TouchPrediction, TouchPredictionArray

_PREDICTIONS: Final = 1000  # messages that are kept until their grasps are executed: half a minute at 30 Hz
_NO_HOLD: Final = TouchHold(chance=math.nan, status=Status.REFUSED, reason="nothing was recorded yet")


@dataclass(frozen=True, kw_only=True)
class SessionStatus:
    """State of a session; immutable."""

    message: RecorderStatus = field(
        default_factory=lambda: RecorderStatus(
            pairing_error=math.nan, pairing_error_max=math.nan, touch_hold=_NO_HOLD, disk_left=math.inf
        )
    )  # without its header and the topics
    accounts: Mapping[str, TopicCounts] = field(default_factory=dict)  # by topic, without what waits
    anomalies: Counter[str] = field(default_factory=Counter)  # of tactile stamps, and messages that were not decoded
    operator: OperatorState = OperatorState()
    last: tuple[TouchPrediction | None, Sample] | None = None  # of the latest sample with a touch


class RecordingSession:
    """Records until `close`, or until the disk is full or fails, or the file is removed.

    Args:
        writer: Open; it is closed here.
        inputs: What is received.
        assembler: Makes samples of the messages.
        operator: Its actions are done under the lock of the assembler.
        queue_bytes: Limit of the messages that wait for the disk.
        warn: Called with a line about a grasp without a sample, or a message that cannot be decoded.
        publish: Called for each grasp with the chance that it holds.

    Attributes:
        status: The state; replaced as a whole.
        ended: Set when everything is written and the file is closed.
    """

    def __init__(
        self,
        writer: RecordingWriter,
        inputs: RecorderInputs,
        assembler: SampleAssembler,
        operator: Operator,
        queue_bytes: int,
        warn: Callable[[str], object],
        publish: Callable[[TouchHold], object],
    ) -> None:
        self.writer = writer
        self.status = SessionStatus()
        self.ended = threading.Event()
        self._began_s = time.monotonic()
        self._inputs = inputs
        self._queue = MessageQueue(queue_bytes)
        self._assembler = assembler
        self._assembler_lock = threading.Lock()  # labels and the operator's actions come from other threads
        self._operator = operator
        self._dropping = False  # what is received in a pause
        self._predictions: OrderedDict[int, bytes] = OrderedDict()  # serialised, by the stamp of their cloud
        self._last: tuple[TouchPrediction | None, Sample] | None = None
        self._warn = warn
        self._hold, self._publish = HoldEvaluator(writer.sensor), publish
        self._unreadable: Counter[str] = Counter()
        self._last_sample = ""
        self._errors_ns: deque[int] = deque(maxlen=1000)
        self._sizes: deque[tuple[float, int]] = deque()
        self._error = ""
        for name, topic in inputs.topics.items():
            writer.add_topic(name, type_name(topic.message))
        writer.before_end = self._account_for_rest
        self._update_status()
        inputs.open(self._queue)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def label(self, label: Label) -> tuple[str, str]:
        """Add the operator's label of a grasp; gives the id of the grasp, and what becomes of the label."""
        with self._assembler_lock:
            return self._assembler.matcher.add_label(label, time.monotonic())

    def act(self, action: Action, text: str = "", grasp_id: str = "") -> str:
        """Do an action of the operator, and say what was done.

        Args:
            action: What to do.
            text: Of a note, or the name of an object.
            grasp_id: Grasp that it is about; "" for the last one.
        """
        with self._assembler_lock:
            return self._operator.act(action, text, grasp_id)

    def close(self) -> None:
        """Write all messages received so far, complete pending grasps, and close the file; may be called more than once."""
        self._inputs.close()
        self._queue.close()
        self._thread.join()

    # The thread.

    def _run(self) -> None:
        try:
            while not self._queue.closed and not self.writer.output.removed:
                self._process(*self._queue.take(0.1))
            self._queue.close()
            if self.writer.output.removed:  # it is still open: `close` counts its content as dropped
                self._error = f"{self.writer.file}: was removed during the recording"
                self._update_status()
            self._process(*self._queue.take(0.0), ending=True)
            self._operator.end_wait("the session has ended")
        except ForetouchError as err:
            self._error = str(err)
        except Exception as err:  # noqa: BLE001  a thread that ends silently would lose everything
            self._warn(traceback.format_exc())
            self._error = f"{type(err).__name__}: {err}"
        try:
            removed = self.writer.output.removed
            self.writer.close()
        except ForetouchError as err:
            self._error = str(err) if removed else self._error or str(err)
        self._update_status(recording=False)
        self.ended.set()

    def _account_for_rest(self) -> None:
        """Close the queue and count its messages as dropped; the writer calls this before it writes the last counts."""
        self._queue.close()
        left, refused = self._queue.take(0.0)
        for topic, count in (Counter(message.topic for message in left) + refused).items():
            self.writer.receive(topic, count)
            self.writer.drop(topic, "session ended", count)
        self._account_for_losses()

    def _account_for_losses(self) -> None:
        for topic, stream in self._inputs.streams.items():
            self.writer.lose(topic, stream.losses.count)

    def _process(self, messages: list[SerializedMessage], refused: Counter[str], *, ending: bool = False) -> None:
        for topic, count in refused.items():
            self.writer.receive(topic, count)
            self.writer.drop(topic, "queue full", count)
        self._account_for_losses()
        for message in messages:  # counted before anything can fail
            self.writer.receive(message.topic)
        messages = self._without_pause(messages)
        for message in messages:
            self.writer.write(
                message.topic,
                message.data,
                message.received_ns,
                publish_time_ns=max(0, message.sent_ns),
                sequence=None if message.sequence is None else message.sequence % 2**32,
            )
            self._assemble(message)
        if not messages:
            self.writer.flush()  # it checks its own timer only when something is written
        with self._assembler_lock:
            results = self._assembler.poll(time.monotonic(), ending=ending)
        for result in results:
            if isinstance(result, RejectedGrasp):
                self._warn(f"grasp {result.grasp_id}: no sample: {result.reason}: {result.message}")
                with self._assembler_lock:
                    self._operator.add_rejected(result.grasp_id, result.message)
                continue
            name = self.writer.append(result)
            if result.pairing_error_ns is not None:  # of a sample with a touch
                self._last_sample = name
                self._last = self._prediction(result), result
                self._errors_ns.append(result.pairing_error_ns)
            with self._assembler_lock:
                self._operator.add_sample(result, name)
        self._update_status()

    def _without_pause(self, messages: list[SerializedMessage]) -> list[SerializedMessage]:
        """Select the messages to record: none in a pause, which begins once the grasp that is being executed is complete."""
        with self._assembler_lock:
            expects = self._assembler.expects_grasp(time.monotonic())
            self._dropping = bool(self._operator.paused) and (self._dropping or not expects)
            if not expects:
                self._operator.end_wait("no grasp came")
        if not self._dropping:
            return messages
        for message in messages:
            self.writer.drop(message.topic, "paused")
        return []

    def _prediction(self, sample: Sample) -> TouchPrediction | None:
        """Find what was predicted for the grasp of a sample, if that was received."""
        data = self._predictions.get(sample.cloud.stamp_ns)
        predictions: Sequence[Any] = () if data is None else read_serialized(data, TouchPredictionArray).predictions
        sha256 = self.writer.sensor.sha256  # a model of another sensor may predict
        own = (prediction for prediction in predictions if prediction.sensor_sha256 == sha256)
        return next((prediction for prediction in own if prediction.grasp.id == sample.grasp.id), None)

    def _assemble(self, serialized: SerializedMessage) -> None:
        """Give a message to the assembler; one that cannot be decoded is counted, and is in the file nevertheless."""
        try:
            match self._inputs.topics[serialized.topic].role:
                case "touch":
                    self._predictions[read_header(serialized.data)[0]] = serialized.data
                    if len(self._predictions) > _PREDICTIONS:
                        self._predictions.popitem(last=False)
                case "tactile" | "cloud" | "table" | "grasps" | "executed" as role:
                    self._add(role, serialized)
        except FileError:
            raise
        except ForetouchError as err:
            name = f"unreadable {serialized.topic}"
            self._unreadable[name] += 1
            if self._unreadable[name] == 1:
                self._warn(f"{serialized.topic}: {err}")

    def _add(self, role: Role, serialized: SerializedMessage) -> None:
        decode = partial(read_serialized, serialized.data, self._inputs.topics[serialized.topic].message)
        message: Any
        if role == "cloud":
            message = SeenObjects.of_message(serialized.data, lambda: decode_objects(decode()))
        else:
            message = decode()
        now_s = time.monotonic()
        with self._assembler_lock:
            self._assembler.add(role, message, received_ns=serialized.received_ns, now_s=now_s)
        if role == "tactile":
            stamp = stamp_ns(message.header.stamp) if hasattr(message, "header") else serialized.received_ns
            evaluated = self._hold.update(message, stamp, self._assembler.held_ns, now_s)
            if evaluated is not None:
                self._publish(evaluated)

    def _update_status(self, *, recording: bool = True) -> None:
        now, size = time.monotonic(), self.writer.output.size
        self._sizes.append((now, size))
        while self._sizes[0][0] < now - 10.0:
            self._sizes.popleft()
        since_s, before = self._sizes[0]
        rate = (size - before) / (now - since_s) if now > since_s else 0.0
        assembler, writer = self._assembler, self.writer
        counted = list(writer.counts.topics.items())
        accounts = {name: replace(a, dropped=Counter(a.dropped)) for name, a in counted if name != SAMPLE_TOPIC}
        dropped: Counter[str] = sum((account.dropped for account in accounts.values()), Counter())
        reasons, drop_counts = names_and_counts(dropped)
        flowing = rate > 0.0 and not (self._error or writer.closed)
        errors = [error * 1e-9 for error in self._errors_ns] or [math.nan]
        with self._assembler_lock:
            sensors = assembler.sensor_states(now)
            outcomes, outcome_counts = names_and_counts(assembler.results)
            message = RecorderStatus(
                recording=recording,
                duration=duration_to_msg(now - self._began_s),
                path=str(writer.path),
                bytes_written=size,
                samples=writer.labelled,
                unlabelled=writer.samples - writer.labelled,
                status=Status.FAILED if self._error else Status.OK,
                reason=self._error,
                outcomes=outcomes,
                outcome_counts=outcome_counts,
                drop_reasons=reasons,
                drop_counts=drop_counts,
                last_sample=self._last_sample,
                pairing_error=errors[-1],
                pairing_error_max=max(errors),
                sensors=list(sensors),
                sensor_states=list(sensors.values()),
                touch_hold=self._hold.last,
                disk_left=writer.free_bytes / rate if flowing else math.inf,
            )
            anomalies = assembler.readings.anomalies + assembler.rejected_clouds + assembler.invalid + self._unreadable
            self.status = SessionStatus(
                message=message,
                accounts=accounts,
                anomalies=anomalies,
                operator=self._operator.state(),
                last=self._last,
            )
