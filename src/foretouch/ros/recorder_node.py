# SPDX-License-Identifier: Apache-2.0
"""Records what the graph, the robot and the hand send, and makes labelled samples of it.

Threads: the executor's callbacks put serialised messages into a queue and return; the session's thread writes them,
waits for the disk, pairs and makes samples. Services have a callback group of their own.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import PointCloud2

from foretouch.dataset.pairing import Interval, Label
from foretouch.dataset.recording import Outcome, RecordingWriter
from foretouch.dataset.recording.record import check_name
from foretouch.errors import ConfigError, ForetouchError
from foretouch.ros.conversions import stamp_ns
from foretouch.ros.node_base import ForetouchNode
from foretouch.ros.recorder_config import RecorderConfig
from foretouch.ros.recorder_desk import DeskConfig, Roles, SampleDesk
from foretouch.ros.recorder_inbox import Arrival, Inbox
from foretouch.ros.recorder_inputs import InputTopic, RecorderInput
from foretouch.ros.recorder_samples import SampleMaker
from foretouch.ros.recorder_session import Session, SessionView
from foretouch.ros.recorder_status import Inflow, status_to_msg
from foretouch.ros.tactile_adapters import TactileAdapter, make_adapter
from foretouch_msgs.msg import ExecutedGrasp, GraspArray, RecorderStatus, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import LabelGrasp, StartRecording, StopRecording

__all__ = ["RecorderNode"]

_MB = 1_000_000
_TICK_S = 0.5
_DEPTH = 1000  # messages that the middleware may hold while this process does not get to run
_CLOUD_DEPTH = 100
_RAW_DEPTH = 20
_OUTCOMES: tuple[Outcome, ...] = ("unknown", "success", "failure")


class RecorderNode(ForetouchNode[RecorderConfig]):
    """The recorder as a lifecycle node; deactivating it ends the recording."""

    def __init__(self, name: str = "recorder", **options: Any) -> None:
        self._inputs_of: dict[str, RecorderInput] = {}
        self._adapter: TactileAdapter | None = None
        self._roles: Roles | None = None
        self._inbox: Inbox | None = None
        self._session: Session | None = None
        self._view = SessionView()
        self._path = ""
        self._file = ""
        self._reason = ""
        self._duration_s = 0.0
        self._arrived: Counter[str] = Counter()
        self._ticks: deque[tuple[float, Counter[str]]] = deque(maxlen=11)
        super().__init__(name, RecorderConfig, **options)

    # Hooks of the base.

    def setup(self) -> None:
        """Subscribe, advertise, offer the services."""
        self._adapter = make_adapter(self.config.tactile)
        self._status = self.advertise(RecorderStatus, "recorder_status")
        for topic in self._wanted(self._adapter):
            one = RecorderInput(self, topic, self._take)
            self._inputs_of[one.name] = one
        names = {one.topic.name: name for name, one in self._inputs_of.items()}
        self._roles = Roles(
            tactile=names[self.config.tactile_topic],
            clouds=names["object_cloud"],
            grasps=names["grasps"],
            executed=names["executed_grasp"],
        )
        group = MutuallyExclusiveCallbackGroup()
        self._services = [
            self.create_service(StartRecording, "start_recording", self._start_recording, callback_group=group),
            self.create_service(StopRecording, "stop_recording", self._stop_recording, callback_group=group),
            self.create_service(LabelGrasp, "label_grasp", self._label_grasp, callback_group=group),
        ]
        self._timer = self.create_timer(_TICK_S, self._tick, callback_group=group)

    def start(self) -> None:
        """Record, where the settings say so."""
        if self.config.record:
            self.begin(self.config.record, self.config.object, self.config.note)

    def stop(self) -> None:
        """End the recording at hand."""
        self.end()

    def teardown(self) -> None:
        """Listen no more."""
        for one in self._inputs_of.values():
            one.destroy()
        if self._adapter is not None:
            for service in self._services:
                self.destroy_service(service)
            self.destroy_timer(self._timer)
        self._inputs_of.clear()
        self._adapter = self._roles = None

    def errors(self) -> tuple[str, ...]:
        """Why the last recording ended by itself."""
        return (self._reason,) if self._reason else ()

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
            raise ConfigError(f"{self._path} is being recorded; stop it first")
        self.end()
        if label:
            check_name(label, "object")
        assert self._adapter is not None  # noqa: S101  setup made both
        assert self._roles is not None  # noqa: S101
        config = self.config
        target = Path(config.folder, path or datetime.now().astimezone().strftime("grasps-%Y-%m-%d-%H%M%S"))
        writer = RecordingWriter(target, config.who(), config.writing)
        for name, one in self._inputs_of.items():
            writer.add_topic(name, one.topic.type_name)
            one.reset()
        maker = SampleMaker(object=label, note=note, others=self._adapter.others, flags=self._adapter.flags)
        how = DeskConfig(
            pairing=config.pairing,
            contact=config.contact,
            assume_grasps=config.assume_grasps,
            unlabelled_s=config.unlabelled_s if config.unlabelled else None,
        )
        inbox = Inbox(config.queue_mb * _MB)
        make_desk = partial(SampleDesk, self._roles, self._adapter, maker, how, warn=self._warn)
        self._session = Session(writer, inbox, make_desk, self._warn)
        self._path, self._file, self._reason, self._inbox = str(target), str(writer.file), "", inbox
        self.get_logger().info("recording into " + self._file)
        return target

    def end(self) -> SessionView:
        """End the session, if one goes on; gives what became of the last one."""
        session, self._inbox = self._session, None
        if session is not None:
            session.close()
            self._view, self._reason, self._session = session.view, session.view.error, None
            self._duration_s = time.monotonic() - session.began_s
        return self._view

    def status(self) -> RecorderStatus:
        """What `recorder_status` tells now."""
        session, inbox = self._session, self._inbox
        waiting: Counter[str] = Counter() if inbox is None else inbox.waiting()
        rates = self._rates()
        inflows = {
            name: Inflow(waiting=waiting[name], lost=one.lost, reliable=one.reliable, rate_hz=rates.get(name, 0.0))
            for name, one in list(self._inputs_of.items())
        }
        view = self._view_now()
        return status_to_msg(
            view,
            inflows,
            path=self._path,
            recording=self.recording,
            duration_s=self._duration_s if session is None else time.monotonic() - session.began_s,
            reason=view.error or self._reason,
            now_ns=self.get_clock().now().nanoseconds,
        )

    # Callbacks.

    def _take(self, arrival: Arrival) -> None:
        self._arrived[arrival.topic] += 1
        inbox = self._inbox
        if inbox is not None:
            inbox.put(arrival)

    def _tick(self) -> None:
        for one in self._inputs_of.values():
            if one.adapt():
                kind = "reliable" if one.reliable else "best effort"
                self.get_logger().info(f"{one.name}: is offered {kind}, and subscribed to likewise")
        self._ticks.append((time.monotonic(), Counter(self._arrived)))
        session = self._session
        if session is not None and session.ended.is_set():  # by itself: the disk takes no more
            self.end()
            self.get_logger().error(self._reason or "the recording has ended")
        self._status.publish(self.status())

    def _start_recording(self, request: Any, response: Any) -> Any:
        try:
            if self.state_name != "active":
                raise ConfigError(f"the recorder is {self.state_name}")
            response.path = str(self.begin(request.path, request.object, request.note))
            response.success = True
        except ForetouchError as err:
            response.message = str(err)
        return response

    def _stop_recording(self, _request: Any, response: Any) -> Any:
        if self._session is None:
            response.message = self._reason or "nothing is being recorded"
            return response
        view = self.end()
        response.path, response.samples, response.message = self._path, view.samples, view.error
        response.success = not view.error
        return response

    def _label_grasp(self, request: Any, response: Any) -> Any:
        session = self._session
        try:
            if session is None:
                raise ConfigError("nothing is being recorded")
            response.grasp_id, response.message = session.desk.label(_label(request))
            response.success = True
        except ForetouchError as err:
            response.grasp_id, response.message = request.grasp_id, str(err)
        return response

    # Its own affairs.

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

    def _rates(self) -> dict[str, float]:
        if len(self._ticks) < 2:
            return {}
        (first_s, first), (last_s, last) = self._ticks[0], self._ticks[-1]
        return {name: (last[name] - first[name]) / (last_s - first_s) for name in last}


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
