# SPDX-License-Identifier: Apache-2.0
"""A simulated Shadow Hand: executes grasps on the objects of a scene and publishes the readings of its fingertips.

Tactile messages are published at 100 Hz while the node is active, at rest and during every grasp. The contact is
computed for the pose that the object had at the stamp of the cloud that the grasp was planned on; a simulated camera
with the same `scene` parameters shows it in that pose. It sends messages of the scene's sensor: `BiotacAll` for the BioTac SP, else
those that the description of the sensor names.

Threads: the executor's callbacks store the newest grasps; one thread publishes each message when it is due; another
computes contacts, so that a slow computation delays no message.
"""

import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Pose
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_srvs.srv import Trigger

from foretouch.camera.config import ScheduleConfig
from foretouch.config import setting
from foretouch.errors import ConfigError, ForetouchError
from foretouch.grasp.messages import decode_grasp
from foretouch.ros.messages.conversions import header_to_msg, point_to_msg, rotation_to_msg, stamp_to_msg
from foretouch.ros.messages.tactile import message_class
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import NodeConfig, ThreadNode
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.ros.runtime.workers import Worker
from foretouch.topics import EXECUTED_TOPIC, GRASPS_TOPIC, TACTILE_TOPIC
from foretouch.types import stamp_ns
from foretouch_lab.ros.hand_messages import biotac_all_to_msg, sensor_to_msg
from foretouch_lab.simulation.execution import Counts, GraspTimingConfig, GraspTrajectory, SimulatedHand
from foretouch_lab.simulation.message_faults import FaultConfig, MessageFaults
from foretouch_lab.simulation.scene import scheduled_scene
from foretouch_lab.simulation.world import CAMERA_FRAME
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, GraspArray

_GRASPING = ("TH", "MF")  # in the order of a trajectory's fingers
_DEPTH = 100
_PRESS_S = 1.0  # how long a person presses a finger


class _RunningGrasp(NamedTuple):
    """A grasp that is being executed."""

    planned: GraspArray  # its first grasp is executed
    arrived: float  # when it was accepted (`time.monotonic`) [s]
    trajectory: GraspTrajectory  # motion and readings of the hand, one row per message
    first: int = 0  # number of the message of row 0


def _executed_to_msg(running: _RunningGrasp, first_ns: int, period_ns: int) -> ExecutedGrasp:
    """Report a grasp; `first_ns` is the stamp of row 0 and `period_ns` the time between two messages [ns]."""
    trajectory, planned = running.trajectory, running.planned
    times = {
        name: stamp_to_msg(0 if row is None else first_ns + row * period_ns)
        for name, row in (("start", trajectory.start), ("contact", trajectory.contact), ("release", trajectory.release))
    }
    achieved = Pose(position=point_to_msg(trajectory.midpoint), orientation=rotation_to_msg(trajectory.rotation))
    header = header_to_msg(planned.header.frame_id, first_ns + len(trajectory.counts) * period_ns)
    return ExecutedGrasp(
        header=header, grasp_id=planned.grasps[0].id, achieved=achieved, success=trajectory.success, **times
    )


@dataclass(frozen=True, kw_only=True)
class HandNodeConfig(NodeConfig):
    """Settings of the simulated hand."""

    scene: ScheduleConfig = field(default_factory=ScheduleConfig)
    course: GraspTimingConfig = field(default_factory=GraspTimingConfig)
    faults: FaultConfig = field(default_factory=FaultConfig)
    automatic: bool = setting(True, "Whether the best of the newest grasps is executed whenever the hand is idle")
    frame_id: str = setting(CAMERA_FRAME, "Frame of the scene's camera: grasps in another are refused", read_only=True)


class HandNode(ThreadNode[HandNodeConfig]):
    """The hand as a lifecycle node."""

    default_name, config_class = "hand", HandNodeConfig

    def __init__(self, **options: Any) -> None:
        self.phase = "idle"  # or the phase of the current grasp (`GraspTrajectory.phase`)
        self.busy = False  # whether a grasp is being executed or computed
        self.executed: Counter[str] = Counter()  # grasps by outcome: `success`, or the reason of the failure
        self._lock = threading.Lock()
        self._newest: GraspArray | None = None
        self._accepted_ns = -1  # stamp of the cloud of the last accepted grasp
        self._ready: _RunningGrasp | None = None
        self._current: _RunningGrasp | None = None
        self._repeats = 0
        self._pressed: tuple[Counts, float] | None = None  # what a person adds to the counts, and until when
        self._behind_s = 0.0  # longest since the last report
        self._began = time.monotonic()
        self._hand: SimulatedHand | None = None
        self._resting: SimulatedHand
        self._faults = MessageFaults(FaultConfig())
        super().__init__(**options)

    def _setup(self) -> None:
        self._faults = MessageFaults(self.config.faults)
        scene = scheduled_scene(self.config.scene)
        self._hand = SimulatedHand(scene, self.config.course)
        if scene.campaign is not None and self.config.scene.origin_ns:  # sensors stay on while this node is restarted
            self._began = time.monotonic() - self.age_s(self.config.scene.origin_ns)
        self._resting = SimulatedHand(scene, self.config.course)  # not shared between threads
        self._sensor = sensor = self._hand.sensor
        kind = BiotacAll if sensor.is_biotac else message_class(sensor.config.source.type)
        self._solver: Worker[tuple[GraspArray, float]] = Worker(
            "hand-contact",
            lambda job: self._solve(*job),
            partial(self.internal_errors.report, "contact"),
            lambda _, why: self._drop(why),
            depth=4,
        )
        self._tactile = self.advertise(kind, TACTILE_TOPIC, depth=_DEPTH)
        self._message_class: Any = kind
        self._executed_publisher = self.advertise(ExecutedGrasp, EXECUTED_TOPIC, depth=_DEPTH)
        self.serve(Trigger, "execute_grasp", self._on_execute, MutuallyExclusiveCallbackGroup())
        for k, name in enumerate(_GRASPING):
            self.serve(Trigger, f"press_{name.lower()}", partial(self._on_press, k), MutuallyExclusiveCallbackGroup())
        self.subscribe(InputTopic(GRASPS_TOPIC, GraspArray), self._on_grasps)

    def _start(self) -> None:
        self._solver.start()

    def _stop(self) -> None:
        """A grasp that is being executed is not reported."""
        if self._hand is not None:
            self._solver.stop()
        super()._stop()
        self._abandon("stopped")

    def _teardown(self) -> None:
        self._hand = self._newest = None

    def _config_changed(self, config: HandNodeConfig) -> None:
        self._faults.config = config.faults

    def diagnose(self, report: Report) -> None:
        """Report the phase of the hand, counts of grasps and messages, and whether this computer keeps up.

        The stamps of late readings are older than the readings.
        """
        behind_s, self._behind_s = self._behind_s, 0.0
        if behind_s > 0.25:  # the difference of stamps and reception that grasps are rejected for by default
            report.warnings.append(f"readings were {behind_s:.1f} s late: the computer is overloaded")
        report.values["phase"] = self.phase
        counts = {"sent": self._faults.passed, "dropped.injected": self._faults.dropped}
        counts["moved.injected"] = self._faults.moved
        report.values |= {f"tactile.{name}": str(count) for name, count in counts.items()}
        report.values |= {f"executed.{outcome}": str(count) for outcome, count in self.executed.items()}

    # Commands.

    def _on_grasps(self, message: GraspArray) -> None:
        with self._lock:
            self._newest = message
        if self.config.automatic:
            self._accept()

    def _on_execute(self, _request: Any, response: Any) -> Any:
        response.success, response.message = self._accept()
        return response

    def _on_press(self, finger: int, _request: Any, response: Any) -> Any:
        if self._hand is not None:
            press = self._hand.press(finger)
            self._pressed = (
                np.stack([press if k == finger else 0 * press for k in range(2)]),
                time.monotonic() + _PRESS_S,
            )
            response.success = True
        return response

    def _accept(self) -> tuple[bool, str]:
        """Start the best of the newest grasps; returns whether it was accepted, and its id or the reason."""
        with self._lock:
            newest = self._newest
            if self.state_name != "active":
                return False, f"the hand is {self.state_name}"
            if self.busy:
                return False, "the hand is busy"
            if newest is None or not newest.grasps:
                return False, "there is no grasp"
            planned_ns = stamp_ns(newest.header.stamp)
            if planned_ns <= self._accepted_ns:
                return False, "there is no new grasp"
            self.busy, self._accepted_ns = True, planned_ns
        self._solver.put((newest, self.statistics.receive()))
        return True, newest.grasps[0].id

    def _abandon(self, reason: str) -> None:
        """Drop the grasp that is being executed or is ready for it, if there is one."""
        if self._ready is not None or self._current is not None:
            self._ready = self._current = None
            self._drop(reason)

    def _drop(self, reason: str) -> None:
        self.statistics.drop(reason)
        self._idle()

    def _idle(self) -> None:
        self.phase = "idle"
        with self._lock:
            self.busy = False

    # Contacts, computed in the solver's thread.

    def _solve(self, planned: GraspArray, arrived: float) -> None:
        frame, expected = planned.header.frame_id, self.config.frame_id
        try:
            if frame != expected:
                raise ConfigError(f"grasps: frame {frame!r} is not the camera's, {expected!r}")
            assert self._hand is not None  # noqa: S101  setup made it
            grasp = decode_grasp(planned.grasps[0])
            slot = self.config.scene.slot(stamp_ns(planned.header.stamp))
            self._repeats += 1
            trajectory = self._hand.execute(grasp, slot, self._repeats, time.monotonic() - self._began)
            self._ready = _RunningGrasp(planned, arrived, trajectory)
        except ForetouchError as err:
            self.get_logger().warning(str(err))
            self._drop("refused")
        except Exception as err:  # noqa: BLE001  the end of a thread must be reported
            self.internal_errors.report("execute_grasp", err)
            self._drop("failed")

    # Messages, published by the sender's thread.

    def _run(self) -> None:
        period_ns = round(1e9 / self.config.course.rate_hz)
        start_ns = self.get_clock().now().nanoseconds
        start = time.monotonic()
        number = 0
        while True:
            due = start + number * period_ns * 1e-9
            if self.stopping.wait(max(0.0, due - time.monotonic())):
                return
            self._behind_s = max(self._behind_s, time.monotonic() - due)
            try:
                self._send(number, start_ns, period_ns)
            except Exception as err:  # noqa: BLE001  it would end the thread
                if not self.context.ok():
                    return
                self.internal_errors.report("hand", err)
                self._abandon("failed")
            number += 1

    def _send(self, number: int, start_ns: int, period_ns: int) -> None:
        counts = self._fingers(number)
        if (stamp := self._faults.stamp(start_ns + number * period_ns)) is not None:
            self._tactile.publish(self._message(self._faults.readings(counts), stamp))
        current = self._current
        if current is not None and number - current.first >= len(current.trajectory.counts) - 1:
            self._finish(current, start_ns + current.first * period_ns, period_ns)

    def _message(self, counts: dict[str, Any], stamp: int) -> Any:
        if self._sensor.is_biotac:
            return biotac_all_to_msg(counts, "rh_tactile", stamp)
        return sensor_to_msg(self._message_class, self._sensor, [counts[name] for name in _GRASPING], stamp)

    def _fingers(self, number: int) -> dict[str, Any]:
        """Readings of each finger that has a sensor, the one at g1 as TH and that at g2 as MF."""
        if self._current is None and self._ready is not None:
            self._current, self._ready = self._ready._replace(first=number), None
        elapsed_s = time.monotonic() - self._began
        grasping = self._resting.read(elapsed_s)
        current = self._current
        if current is not None:
            row = min(number - current.first, len(current.trajectory.counts) - 1)
            grasping, self.phase = current.trajectory.counts[row], current.trajectory.phase(row)
        if self._pressed is not None and time.monotonic() < self._pressed[1]:
            grasping = grasping.copy()
            grasping[:, : self._pressed[0].shape[1]] += self._pressed[0]
        return dict(zip(_GRASPING, grasping, strict=True))

    def _finish(self, running: _RunningGrasp, first_ns: int, period_ns: int) -> None:
        """Report the grasp and become idle."""
        trajectory, message = running.trajectory, _executed_to_msg(running, first_ns, period_ns)
        self._current = None
        self.executed[trajectory.reason or "success"] += 1
        if trajectory.success:
            self.statistics.use(running.arrived, (first_ns - stamp_ns(running.planned.header.stamp)) * 1e-9)
        else:
            self.get_logger().warning(f"grasp {running.planned.grasps[0].id}: {trajectory.message}")
            self.statistics.drop(trajectory.reason)
        self._idle()
        self._executed_publisher.publish(message)
