# SPDX-License-Identifier: Apache-2.0
"""The recorder's services: start and stop a recording, label a grasp.

Records what the graph, the robot and the hand send, and makes labelled samples of it.

Threads: the executor's callbacks put serialised messages into a queue and return; the session's thread writes them,
waits for the disk, pairs and makes samples. Services have a callback group of their own.
"""

from __future__ import annotations

import time
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import PointCloud2

from foretouch.dataset.pairing import Interval, Label
from foretouch.dataset.recording import Outcome, RecordingWriter
from foretouch.dataset.recording.record import check_name
from foretouch.errors import ConfigError, ForetouchError
from foretouch.ros.messages.conversions import stamp_ns
from foretouch.ros.messages.tactile import TactileAdapter, make_adapter
from foretouch.ros.recorder.config import RecorderConfig
from foretouch.ros.recorder.message_queue import MessageQueue
from foretouch.ros.recorder.sample_desk import DeskConfig, Roles, SampleDesk
from foretouch.ros.recorder.samples import SampleMaker
from foretouch.ros.recorder.session import Session, SessionView
from foretouch.ros.recorder.status import status_to_msg
from foretouch.ros.recorder.subscriptions import InputTopic, RecorderSubscriptions
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch_msgs.msg import ExecutedGrasp, GraspArray, RecorderStatus, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import LabelGrasp, StartRecording, StopRecording

__all__ = ["RecorderNode", "RecorderServices"]


_OUTCOMES: tuple[Outcome, ...] = ("unknown", "success", "failure")


class RecorderServices:
    """Offers the services until `destroy`.

    Args:
        node: The recorder.
        group: That the services run in.
    """

    def __init__(self, node: RecorderNode, group: CallbackGroup) -> None:
        self._node = node
        self._services: list[Any] = [
            node.create_service(kind, name, answer, callback_group=group)
            for kind, name, answer in (
                (StartRecording, "start_recording", self._start),
                (StopRecording, "stop_recording", self._stop),
                (LabelGrasp, "label_grasp", self._label),
            )
        ]

    def destroy(self) -> None:
        """Offer them no more."""
        for service in self._services:
            self._node.destroy_service(service)

    def _start(self, request: Any, response: Any) -> Any:
        try:
            if self._node.state_name != "active":
                raise ConfigError(f"the recorder is {self._node.state_name}")
            response.path = str(self._node.begin(request.path, request.object, request.note))
            response.success = True
        except ForetouchError as err:
            response.message = str(err)
        return response

    def _stop(self, _request: Any, response: Any) -> Any:
        if not self._node.in_session:
            response.message = self._node.reason or "nothing is being recorded"
            return response
        view = self._node.end()
        response.path, response.samples, response.message = self._node.path, view.samples, view.error
        response.success = not view.error
        return response

    def _label(self, request: Any, response: Any) -> Any:
        try:
            response.grasp_id, response.message = self._node.label(_label(request))
            response.success = True
        except ForetouchError as err:
            response.grasp_id, response.message = request.grasp_id, str(err)
        return response


def _label(request: Any) -> Label:
    """The request in the core's words.

    Raises:
        ConfigError: If the outcome is no known one.
        DatasetError: If the label of the object is no plain name.
    """
    if request.outcome >= len(_OUTCOMES):
        raise ConfigError(f"outcome: {request.outcome} is none of UNKNOWN, SUCCESS, FAILURE")
    if request.object:
        check_name(request.object, "object")
    start, contact, release = (stamp_ns(time) for time in (request.start, request.contact, request.release))
    return Label(
        grasp_id=request.grasp_id,
        object=request.object,
        discard=request.discard,
        note=request.note,
        outcome=_OUTCOMES[request.outcome],
        interval=Interval(start=start, contact=contact, release=release) if contact or release else None,
    )


_MB = 1_000_000
_TICK_S = 0.5
_DEPTH = 1000  # messages that the middleware may hold while this process does not get to run
_CLOUD_DEPTH = 100
_RAW_DEPTH = 20


class RecorderNode(ForetouchNode[RecorderConfig]):
    """The recorder as a lifecycle node; deactivating it ends the recording.

    Attributes:
        path: Of the dataset at hand, or of the last one; "" before the first.
        reason: Why the last recording ended by itself, or "".
    """

    def __init__(self, name: str = "recorder", **options: Any) -> None:
        self.path = ""
        self.reason = ""
        self._intake: RecorderSubscriptions | None = None
        self._offered: RecorderServices | None = None
        self._adapter: TactileAdapter | None = None
        self._session: Session | None = None
        self._view = SessionView()
        self._duration_s = 0.0
        super().__init__(name, RecorderConfig, **options)

    # Hooks of the base.

    def setup(self) -> None:
        """Subscribe, advertise, offer the services."""
        self._adapter = make_adapter(self.config.tactile)
        self._status = self.advertise(RecorderStatus, "recorder_status")
        self._intake = RecorderSubscriptions(self, self._wanted(self._adapter), self._mismatch)
        group = MutuallyExclusiveCallbackGroup()
        self._timer = self.create_timer(_TICK_S, self._tick, callback_group=group)
        self._offered = RecorderServices(self, group)

    def start(self) -> None:
        """Record, where the settings say so."""
        if self.config.record:
            self.begin(self.config.record, self.config.object, self.config.note)

    def stop(self) -> None:
        """End the recording at hand."""
        self.end()

    def teardown(self) -> None:
        """Listen no more."""
        if self._offered is not None:
            self._offered.destroy()
            self.destroy_timer(self._timer)
        if self._intake is not None:
            self._intake.destroy()
        self._offered = self._intake = self._adapter = None

    def errors(self) -> tuple[str, ...]:
        """Why the last recording ended by itself."""
        return (self.reason,) if self.reason else ()

    def notes(self) -> dict[str, str]:
        """The counts."""
        status = self.status()
        counts = dict(zip(status.outcomes, status.outcome_counts, strict=True))
        return {
            "phase": "recording" if status.recording else "idle",
            "received": str(status.received),
            "used": str(status.used),
            "dropped": str(sum(status.drop_counts)),
            "lost_on_the_way": str(status.lost),
            "rate_hz": f"{sum(topic.rate for topic in status.topics):.2f}",
            "samples": str(status.samples),
            "unlabelled": str(status.unlabelled),
            **{f"executed.{outcome}": str(count) for outcome, count in counts.items()},
            **{f"tactile.{name}": str(count) for name, count in self._view_now().oddities.items()},
            **{f"sensor.{name}": s for name, s in zip(status.sensors, status.sensor_states, strict=True)},
        }

    # Recording.

    @property
    def recording(self) -> bool:
        """Whether a session goes on."""
        return self._session is not None and not self._session.ended.is_set()

    @property
    def in_session(self) -> bool:
        """Whether there is something to end: a session that goes on, or has just ended by itself."""
        return self._session is not None

    @property
    def samples(self) -> int:
        """Labelled samples of the session at hand, or of the last one."""
        return self._view_now().samples

    def begin(self, path: str, label: str = "", note: str = "") -> Path:
        """Start a session; a dataset that is there goes on.

        Args:
            path: Of the dataset; "" for a name made of the time.
            label: Of the object on the table.
            note: For every sample.

        Returns:
            The dataset's path.

        Raises:
            ConfigError: If a session goes on.
            DatasetError: If the label is no plain name.
            FileError: If it cannot be written, or is of another hand or camera.
        """
        if self.recording:
            raise ConfigError(f"{self.path} is being recorded; stop it first")
        self.end()
        if label:
            check_name(label, "object")
        assert self._intake is not None  # noqa: S101  setup made it
        config = self.config
        target = Path(config.folder, path or datetime.now().astimezone().strftime("grasps-%Y-%m-%d-%H%M%S"))
        writer = RecordingWriter(target, config.who(), config.writing)
        for name, one in self._intake.inputs.items():
            writer.add_topic(name, one.topic.type_name)
        inbox = MessageQueue(config.queue_mb * _MB)
        self._intake.open(inbox)
        self._session = Session(writer, inbox, self._desk_maker(label, note), self._intake.lost, self._warn)
        self.path, self.reason = str(target), ""
        self.get_logger().info(f"recording into {writer.file}")
        return target

    def end(self) -> SessionView:
        """End the session, if one goes on; gives what became of the last one."""
        if self._intake is not None:
            self._intake.close()
        self._conclude()
        return self._view

    def label(self, label: Label) -> tuple[str, str]:
        """What the operator says of a grasp (see `GraspTouchMatcher.label`).

        Raises:
            ConfigError: If no session goes on.
            PairingError: If the grasp is not known, or its sample is complete.
        """
        session = self._session
        if session is None:
            raise ConfigError("nothing is being recorded")
        return session.desk.label(label)

    def status(self) -> RecorderStatus:
        """What `recorder_status` tells now."""
        session, view = self._session, self._view_now()
        return status_to_msg(
            view,
            {} if self._intake is None else self._intake.inflows(),
            path=self.path,
            recording=self.recording,
            duration_s=self._duration_s if session is None else time.monotonic() - session.began_s,
            reason=view.error or self.reason,
            now_ns=self.get_clock().now().nanoseconds,
        )

    # Its own affairs.

    def _tick(self) -> None:
        intake = self._intake
        for text in () if intake is None else intake.tick():
            self.get_logger().info(text)
        session = self._session
        if session is not None and session.ended.is_set():  # by itself; what still comes is counted as such
            self._conclude()
            self.get_logger().error(self.reason or "the recording has ended")
        self._status.publish(self.status())

    def _conclude(self) -> None:
        session = self._session
        if session is not None:
            session.close()
            self._view, self.reason, self._session = session.view, session.view.error, None
            self._duration_s = time.monotonic() - session.began_s

    def _desk_maker(self, label: str, note: str) -> Any:
        """Makes the desk of a session, given what writes a record."""
        assert self._adapter is not None  # noqa: S101  setup made both
        assert self._intake is not None  # noqa: S101
        config, name = self.config, self._intake.name
        roles = Roles(
            tactile=name(config.tactile_topic),
            clouds=name("object_cloud"),
            grasps=name("grasps"),
            executed=name("executed_grasp"),
        )
        maker = SampleMaker(object=label, note=note, others=self._adapter.others, flags=self._adapter.flags)
        how = DeskConfig(
            pairing=config.pairing,
            contact=config.contact,
            assume_grasps=config.assume_grasps,
            unlabelled_s=config.unlabelled_s if config.unlabelled else None,
        )
        return partial(SampleDesk, roles, self._adapter, maker, how, warn=self._warn)

    def _wanted(self, adapter: TactileAdapter) -> list[InputTopic]:
        topics = [
            InputTopic(self.config.tactile_topic, adapter.message, _DEPTH),
            InputTopic("object_cloud", PointCloud2, _CLOUD_DEPTH),
            InputTopic("table", TablePlane, _DEPTH),
            InputTopic("grasps", GraspArray, _DEPTH),
            InputTopic("touch", TouchPredictionArray, _DEPTH),
            InputTopic("executed_grasp", ExecutedGrasp, _DEPTH),
        ]
        return topics + [InputTopic("points", PointCloud2, _RAW_DEPTH)] * self.config.points

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text)

    def _view_now(self) -> SessionView:
        session = self._session
        return self._view if session is None else session.view
