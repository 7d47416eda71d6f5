# SPDX-License-Identifier: Apache-2.0
"""The recorder: writes what the graph, the robot and the hand send, and assembles labelled samples.

Threads: callbacks of the executor put serialised messages into a queue and return; the thread of the session writes
them, waits for the disk, and assembles samples. Services have a callback group of their own.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_srvs.srv import SetBool, Trigger

from foretouch.config import Settings, setting
from foretouch.dataset.identity import Identity, check_name
from foretouch.dataset.labelling.assembler import AssemblerConfig, SampleAssembler
from foretouch.dataset.labelling.cut import Interval, PairingConfig
from foretouch.dataset.labelling.matcher import Label
from foretouch.dataset.recordings.writer import RecordingConfig, RecordingWriter
from foretouch.errors import ConfigError, ForetouchError, quoted
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.messages.tactile import TactileInput
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.ros.sessions.operator import Action, Operator
from foretouch.ros.sessions.session import RecordingSession, SessionStatus
from foretouch.ros.sessions.subscriptions import RecorderInputs, colour_topic, depth_topics, robot_topics, sample_topics
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TactileReader
from foretouch.topics import GRASPS_TOPIC
from foretouch.types import OUTCOMES, stamp_ns
from foretouch_msgs.msg import RecorderStatus, TouchHold
from foretouch_msgs.srv import LabelGrasp, StartRecording, StopRecording


@dataclass(frozen=True, kw_only=True)
class IdentityConfig(Settings, read_only=True):
    """Which hand and which camera: a dataset holds recordings of one of each."""

    hand: str = setting("unknown", "Model of the hand")
    hand_serial: str = setting("", "Serial number of the hand")
    camera: str = setting("unknown", "Model of the camera")
    camera_serial: str = setting("", "Serial number of the camera")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("hand", "camera"):
            if not getattr(self, name).strip():
                raise ConfigError(f"{name}: is empty; a dataset names the model of its {name}")


@dataclass(frozen=True, kw_only=True)
class RecorderConfig(NodeConfig, TactileInput):
    """Settings of the recorder."""

    folder: str = setting(".", "Folder of datasets with a relative path, or without a path", read_only=True)
    record: str = setting("", "Dataset to record from the start; empty waits for start_recording", read_only=True)
    object: str = setting("", "Label of the object on the table, for `record`", read_only=True)
    objects: tuple[str, ...] = setting(
        (), "Labels of the objects to record, in order: `next_object` takes the next; the first, if `object` is empty",
        read_only=True,
    )  # fmt: skip
    points: bool = setting(False, "Whether to record the camera's whole clouds too", read_only=True)
    depth: str = setting(
        "",
        "Topic of depth images to record with the camera infos beside it, such as depth/image_rect_raw, or one that ends with"
        " /compressedDepth; empty for none",
        read_only=True,
    )
    color: str = setting(
        "",
        "Topic of the colours of these images to record, such as color/image, or one that ends with /compressed; empty for none",
        read_only=True,
    )
    sample_color: bool = setting(
        True, "Whether samples keep the colours of their points, where object_cloud has them", read_only=True
    )
    unlabelled: bool = setting(True, "Whether clouds without an executed grasp become samples without a touch")
    unlabelled_s: float = setting(1.0, "Minimum time between two samples without a touch", bounds=(0.0, 3600.0))
    assume_grasps: bool = setting(
        False, "Whether a contact without a report is assigned to the best grasp of the last cloud before it"
    )
    queue_mb: int = setting(500, "Memory for messages that wait for the disk", bounds=(10, 100_000), read_only=True)
    identity: IdentityConfig = field(default_factory=IdentityConfig)
    pairing: PairingConfig = field(default_factory=PairingConfig)
    writing: RecordingConfig = field(default_factory=RecordingConfig)


def _decode_label(request: Any) -> Label:
    """Read the label in a request; a `ConfigError` or `DatasetError` if its outcome or the object's label is none."""
    if request.outcome >= len(OUTCOMES):
        raise ConfigError(f"outcome: {request.outcome} is not one of UNKNOWN, SUCCESS, FAILURE")
    if request.object:
        check_name(request.object, "object")
    start, contact, release = (stamp_ns(time) for time in (request.start, request.contact, request.release))
    return Label(
        grasp_id=request.grasp_id,
        object=request.object,
        discard=request.discard,
        note=request.note,
        outcome=OUTCOMES[request.outcome],
        interval=Interval(start=start, contact=contact, release=release) if contact or release else None,
    )


class RecorderNode(ForetouchNode[RecorderConfig]):
    """The recorder as a lifecycle node; deactivating it ends the recording."""

    default_name, config_class = "recorder", RecorderConfig
    exclusive_topics = (GRASPS_TOPIC,)

    def __init__(self, **options: Any) -> None:
        self.inputs: RecorderInputs | None = None  # once it is configured
        self._session: RecordingSession | None = None  # the current one, or the last
        self._told = False  # whether it is logged that it has ended by itself
        super().__init__(**options)

    def _setup(self) -> None:
        self.reader: TactileReader = make_reader(self.config.tactile)
        self._status = self.advertise(RecorderStatus, "recorder_status")
        self._hold = self.advertise(TouchHold, "touch_hold")
        topics = sample_topics(self.config, points=self.config.points)
        if self.config.depth:
            topics += depth_topics(self.config.depth)
        if self.config.color:
            topics.append(colour_topic(self.config.color))
        others, missing = robot_topics()
        if missing:
            self.get_logger().info(f"not installed, so that its topics are not recorded: {', '.join(missing)}")
        self.inputs = RecorderInputs(self, [*topics, *others])
        group = MutuallyExclusiveCallbackGroup()
        self.closing.callback(self.destroy_timer, self.every(0.5, self._tick))
        services: tuple[tuple[Any, str, Callable[[Any, Any], str]], ...] = (
            (StartRecording, "start_recording", self._start_recording),
            (StopRecording, "stop_recording", self._stop_recording),
            (LabelGrasp, "label_grasp", self._label_grasp),
            (LabelGrasp, "edit_grasp", self._edit_grasp),
            (LabelGrasp, "next_object", lambda request, _: self.act("object", request.object)),
            (SetBool, "pause_recording", lambda request, _: self.act("pause", "on" if request.data else "off")),
            (Trigger, "undo_edit", lambda *_: self.act("undo")),
        )
        for kind, name, act in services:
            self.serve(kind, name, partial(self._answer, act), group)

    def _start(self) -> None:
        if self.config.record:
            self.begin(self.config.record, self.config.object)

    def _stop(self) -> None:
        self.end()

    def diagnose(self, report: Report) -> None:
        """Report the counts, and why the last recording ended by itself."""
        status, session = self.status(), self.session_status()
        if self.reason:
            report.errors.append(self.reason)
        phase = "idle" if not status.recording else "paused" if session.operator.paused else "recording"
        counts = {
            "received": status.received,
            "used": status.used,
            "dropped": sum(status.drop_counts),
            "lost_on_the_way": status.lost,
            "samples": status.samples,
            "unlabelled": status.unlabelled,
            **{f"executed.{name}": count for name, count in zip(status.outcomes, status.outcome_counts, strict=True)},
            **{f"tactile.{name}": count for name, count in session.anomalies.items()},
        }
        report.values |= {"phase": phase, "object": session.operator.object}
        report.values |= {key: str(count) for key, count in counts.items()}
        report.values["rate_hz"] = f"{sum(topic.rate for topic in status.topics):.2f}"
        sensors = zip(status.sensors, status.sensor_states, strict=True)
        report.values |= {f"sensor.{name}": state for name, state in sensors}

    # Recording.

    def act(self, action: Action, text: str = "", grasp_id: str = "") -> str:
        """Do an action of the operator, and say what was done.

        Args:
            action: What to do.
            text: Of a note, or the name of an object.
            grasp_id: Grasp that it is about; "" for the last one.

        Raises:
            ConfigError: If nothing is being recorded.
        """
        return self._running().act(action, text, grasp_id)

    @property
    def identity(self) -> Identity:
        """Hand and camera, with all settings in which the recordings of a dataset must agree."""
        identity, tactile = self.config.identity, self.config.tactile
        thumb, middle = tactile.fingers
        hand = {"model": identity.hand, "serial": identity.hand_serial, "tactile": tactile.message_type}
        return Identity(
            hand={**hand, "thumb": thumb, "middle_finger": middle},
            camera={"model": identity.camera, "serial": identity.camera_serial},
        )

    @property
    def recording(self) -> bool:
        """Whether a session is running."""
        return self._session is not None and not self._session.ended.is_set()

    @property
    def reason(self) -> str:
        """Why the last recording ended by itself."""
        return str(self.session_status().message.reason)

    def session_status(self) -> SessionStatus:
        """Return the state of the current session, or of the last one."""
        return SessionStatus() if self._session is None else self._session.status

    def _running(self) -> RecordingSession:
        if self._session is None or self._session.ended.is_set():
            raise ConfigError(": ".join(filter(None, ("nothing is being recorded", self.reason))))
        return self._session

    def begin(self, path: str, label: str = "", note: str = "") -> Path:
        """Start a session and return the dataset's path; an existing dataset is extended.

        Args:
            path: Of the dataset, in `folder`; "" for a name made of the time.
            label: Of the object on the table.
            note: For every sample.

        Raises:
            ConfigError: If a session is running.
            DatasetError: If the label is not a plain name.
            FileError: If it cannot be written, or is of another hand or camera.
        """
        if self.recording:
            raise ConfigError(f"{self._running().writer.path} is being recorded; stop it first")
        self.end()
        inputs, config = self.inputs, self.config
        assert inputs is not None  # noqa: S101  made by setup
        label = label or next(iter(config.objects), "")
        for name in filter(None, (label, *config.objects)):
            check_name(name, "object")
        target = Path(config.folder, path or datetime.now().astimezone().strftime("grasps-%Y-%m-%d-%H%M%S"))
        writer = RecordingWriter(target, self.identity, config.writing, sensor=self.reader.sensor)
        assembling = AssemblerConfig(
            pairing=config.pairing,
            object=label,
            note=note,
            unlabelled_s=config.unlabelled_s if config.unlabelled else None,
            assume_grasps=config.assume_grasps,
            colours=config.sample_color,
            watch_sensors=True,
        )
        assembler = SampleAssembler(assembling, self.reader)
        operator = Operator(writer, assembler, config.objects, lambda: self.get_clock().now().nanoseconds)
        self._told = False
        queue_bytes, warn = config.queue_mb * 1_000_000, self.get_logger().warning
        self._session = RecordingSession(writer, inputs, assembler, operator, queue_bytes, warn, self._hold.publish)
        self.get_logger().info(f"recording into {writer.file}")
        return target

    def end(self) -> SessionStatus:
        """End the session, if one is running; gives the final state of the last one."""
        if self._session is not None:
            self._session.close()
        return self.session_status()

    def status(self) -> RecorderStatus:
        """Make the current `recorder_status`."""
        session = self.session_status()
        message = copy(session.message)
        message.header = header_to_msg("", self.get_clock().now().nanoseconds)
        message.topics = topics = [] if self.inputs is None else self.inputs.accounts(session.accounts)
        message.received, message.used = sum(topic.received for topic in topics), sum(topic.written for topic in topics)
        message.lost = sum(topic.lost for topic in topics)
        return message

    # Services and the timer.

    def _start_recording(self, request: Any, response: Any) -> str:
        if self.state_name != "active":
            raise ConfigError(f"the recorder is {self.state_name}")
        self._require_inside(request.path)
        response.path = str(self.begin(request.path, request.object, request.note))
        return ""

    def _require_inside(self, path: str) -> None:
        """Refuse a dataset outside of `folder`: anyone in the graph can ask for one."""
        folder = Path(self.config.folder).resolve()
        if "\0" in path or (path and folder not in Path(folder, path).resolve().parents):
            raise ConfigError(f"path: {quoted(path)} is not inside of the folder {folder} of the recorder")

    def _stop_recording(self, _request: Any, response: Any) -> str:
        self._running()
        last = self.end().message
        response.path, response.samples = last.path, last.samples
        if last.reason:
            raise ConfigError(last.reason)
        return ""

    def _label_grasp(self, request: Any, response: Any) -> str:
        response.grasp_id, label = request.grasp_id, _decode_label(request)
        response.grasp_id, text = self._running().label(label)
        return text

    def _answer(self, act: Callable[[Any, Any], str], request: Any, response: Any) -> Any:
        """Answer a request by what was done, or by why it was not."""
        try:
            response.message = act(request, response)
            response.success = True
        except ForetouchError as err:
            response.message = str(err)
        return response

    def _edit_grasp(self, request: Any, _: Any) -> str:
        label = _decode_label(request)
        edits: list[tuple[Action, str]] = []
        if label.object:
            edits.append(("relabel", label.object))
        if label.outcome != "unknown":
            edits.append((label.outcome, ""))
        if label.note:
            edits.append(("note", label.note))
        if label.discard:
            edits.append(("drop", ""))
        if not edits:
            raise ConfigError("the request changes nothing: set object, outcome, note or discard")
        return "; ".join(self.act(action, text, request.grasp_id) for action, text in edits)

    def _tick(self) -> None:
        if self.inputs is not None:
            self.inputs.tick()
        if self.reason and not self.recording and not self._told:
            self._told = True
            self.end()  # messages from now on are not received
            self.get_logger().error(self.reason)
        self._status.publish(self.status())
