# SPDX-License-Identifier: Apache-2.0
"""A grasp that the simulated hand executes, from the order to the report. No node, no thread.

A simulated Shadow Hand: takes grasps on the objects of a scene and sends what its fingertips read.

`/rh/tactile` goes on at 100 Hz as long as the node is active: at rest, and through every grasp that it executes.
The contact is solved for the object as it lay at the stamp of the cloud that the grasp was planned on; a camera
that is given the same scene (`scene.*`) sees it lie there.

Threads: the executor's callbacks keep the newest grasps; one thread sends, by the stamps that each message is due
at; another solves contacts, so that a hard one delays no message.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

from geometry_msgs.msg import Pose, Quaternion
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_srvs.srv import Trigger

from foretouch.config import setting
from foretouch.errors import ConfigError, ForetouchError
from foretouch.grasp import quaternion_xyzw
from foretouch.ros.messages.conversions import grasp_from_msg, header_to_msg, point_to_msg, stamp_ns, stamp_to_msg
from foretouch.ros.messages.tactile import FINGERS, biotac_all_to_msg
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.ros.runtime.workers import Worker
from foretouch.simulation.execution import Course, CourseConfig, SimulatedHand
from foretouch.simulation.message_faults import FaultConfig, MessageFaults
from foretouch.simulation.resting import RestingFingers
from foretouch.simulation.show import ShowConfig
from foretouch.simulation.world import CAMERA_FRAME
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, GraspArray

__all__ = ["Execution", "HandConfig", "HandNode", "Order", "executed_to_msg"]


@dataclass(frozen=True, eq=False)
class Order:
    """A grasp to execute.

    Attributes:
        message: `GraspArray`; its first grasp is meant.
        planned_ns: Stamp of the cloud that it was planned on [ns].
        arrived: When it was taken (`time.monotonic`) [s].
    """

    message: Any
    planned_ns: int
    arrived: float


@dataclass(frozen=True, eq=False)
class Execution:
    """A course under way.

    Attributes:
        order: What was asked for.
        course: What the hand does, a row a message.
        first: Number of the message that is row 0.
    """

    order: Order
    course: Course
    first: int = 0


def executed_to_msg(execution: Execution, first_ns: int, period_ns: int) -> ExecutedGrasp:
    """What was done.

    Args:
        execution: Of the grasp.
        first_ns: Stamp of the message that was row 0 [ns].
        period_ns: Between two messages [ns].
    """
    course, planned = execution.course, execution.order.message
    times = {
        name: stamp_to_msg(0 if row is None else first_ns + row * period_ns)
        for name, row in (("start", course.start), ("contact", course.contact), ("release", course.release))
    }
    x, y, z, w = map(float, quaternion_xyzw(course.rotation))
    achieved = Pose(position=point_to_msg(course.midpoint), orientation=Quaternion(x=x, y=y, z=z, w=w))
    header = header_to_msg(planned.header.frame_id, first_ns + len(course.counts) * period_ns)
    grasp_id = planned.grasps[0].id
    return ExecutedGrasp(header=header, grasp_id=grasp_id, achieved=achieved, success=course.success, **times)


_GRASPING = ("TH", "MF")  # in the order of a course's fingers
_LATE_NS = 1_000_000_000  # beyond this, messages are left out rather than made up for
_DEPTH = 100
_POLL_S = 0.01


@dataclass(frozen=True, kw_only=True)
class HandConfig(NodeConfig):
    """Settings of the simulated hand."""

    scene: ShowConfig = field(default_factory=ShowConfig)
    course: CourseConfig = field(default_factory=CourseConfig)
    faults: FaultConfig = field(default_factory=FaultConfig)
    automatic: bool = setting(True, "Whether the best of the newest grasps is taken whenever the hand is idle")
    biotacs: tuple[str, ...] = setting(
        ("MF", "TH"), "Fingers that carry a BioTac; the others send zeros", choices=FINGERS, read_only=True
    )
    tactile_frame: str = setting("rh_tactile", "Frame of the tactile messages", read_only=True)
    frame_id: str = setting(CAMERA_FRAME, "Frame of the scene's camera: grasps in another are refused", read_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not set(_GRASPING) <= set(self.biotacs):
            raise ConfigError(f"HandConfig.biotacs: {list(self.biotacs)} lacks TH or MF, which grasp")


class HandNode(ForetouchNode[HandConfig]):
    """The hand as a lifecycle node.

    Attributes:
        phase: `idle`, or what `Course.phase` says of the grasp under way.
        executed: Grasps by outcome: `success`, or the reason of the failure.
    """

    def __init__(self, name: str = "hand", **options: Any) -> None:
        self.phase = "idle"
        self.executed: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._newest: GraspArray | None = None
        self._taken_ns = -1  # stamp of the cloud whose grasp was taken last
        self._busy = False
        self._ready: Execution | None = None
        self._current: Execution | None = None
        self._repeats = 0
        self._late = 0
        self._began = time.monotonic()
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._hand: SimulatedHand | None = None
        self._resting: list[RestingFingers] = []
        super().__init__(name, HandConfig, **options)

    @property
    def busy(self) -> bool:
        """Whether a grasp is being executed or made ready."""
        return self._busy

    # Hooks of the base.

    def setup(self) -> None:
        """Read the scene, advertise, subscribe."""
        scene = self.config.scene.load()
        self._hand = SimulatedHand(scene, self.config.course)
        at_rest = SimulatedHand(scene, self.config.course)  # each thread has its own
        self._idle_fingers = [name for name in self.config.biotacs if name not in _GRASPING]
        self._resting = [RestingFingers(at_rest, k) for k in range(1 + len(self._idle_fingers))]
        self._faults = MessageFaults(self.config.faults)
        self._solver: Worker[Order] = Worker("hand-contact", 1, self._solve, lambda _, why: self._give_up(why))
        self._tactile = self.advertise(BiotacAll, "/rh/tactile", depth=_DEPTH)
        self._told = self.advertise(ExecutedGrasp, "executed_grasp", depth=_DEPTH)
        self._service = self.create_service(
            Trigger, "execute_grasp", self._execute, callback_group=MutuallyExclusiveCallbackGroup()
        )
        self.subscribe(GraspArray, "grasps", self._take)

    def start(self) -> None:
        """Send, from a thread."""
        self._stopping.clear()
        self._solver.start()
        self._thread = threading.Thread(target=self._run, name="hand", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Break off; a grasp under way is not told of."""
        self._stopping.set()
        if self._thread is not None:
            self._solver.stop()
            self._thread.join()
            self._thread = None
            if self._ready is not None or self._current is not None:
                self._ready = self._current = None
                self._give_up("stopped")

    def teardown(self) -> None:
        """Forget scene and grasps."""
        if self._hand is not None:
            self.destroy_service(self._service)
        self._hand = self._newest = None
        self._resting.clear()

    def config_changed(self, config: HandConfig) -> None:
        """Faults may come and go while it runs."""
        if self._hand is not None:
            self._faults.config = config.faults

    def notes(self) -> dict[str, str]:
        """What the hand is doing, and what became of grasps and messages."""
        faults = self._faults if self._hand is not None else MessageFaults(self.config.faults)
        return {
            "phase": self.phase,
            "tactile.sent": str(faults.passed),
            "tactile.dropped.injected": str(faults.dropped),
            "tactile.moved.injected": str(faults.moved),
            "tactile.left_out.late": str(self._late),
            **{f"executed.{outcome}": str(count) for outcome, count in self.executed.items()},
        }

    # Which grasp.

    def _take(self, message: GraspArray) -> None:
        with self._lock:
            self._newest = message
        if self.config.automatic:
            self._order()

    def _execute(self, _request: Any, response: Any) -> Any:
        response.success, response.message = self._order()
        return response

    def _order(self) -> tuple[bool, str]:
        """Take the best of the newest grasps; whether it was taken, and its id or why not."""
        with self._lock:
            newest = self._newest
            if self.state_name != "active":
                return False, f"the hand is {self.state_name}"
            if self._busy:
                return False, "the hand is busy"
            if newest is None or not newest.grasps:
                return False, "there is no grasp"
            planned_ns = stamp_ns(newest.header.stamp)
            if planned_ns <= self._taken_ns:
                return False, "there is no new grasp"
            self._busy, self._taken_ns = True, planned_ns
        self._solver.put(Order(newest, planned_ns, self.statistics.arrive()))
        return True, newest.grasps[0].id

    def _give_up(self, reason: str) -> None:
        self.statistics.drop(reason)
        self._idle()

    def _idle(self) -> None:
        self.phase = "idle"
        with self._lock:
            self._busy = False

    # Contact, in the solver's thread.

    def _solve(self, order: Order) -> None:
        header = order.message.header
        try:
            if header.frame_id != self.config.frame_id:
                raise ConfigError(f"grasps: frame {header.frame_id!r} is not the camera's, {self.config.frame_id!r}")
            self._ready = Execution(order, self._course(order))
        except ForetouchError as err:
            self.get_logger().warning(str(err))
            self._give_up("refused")
        except Exception as err:  # noqa: BLE001  a thread that ends silently would leave everybody waiting
            self.get_logger().error(f"{type(err).__name__}: {err}")
            self._give_up("failed")

    def _course(self, order: Order) -> Course:
        assert self._hand is not None  # noqa: S101  setup made it
        grasp = grasp_from_msg(order.message.grasps[0])
        slot = self.config.scene.slot(order.planned_ns)
        self._repeats += 1
        return self._hand.execute(grasp, slot, self._repeats, time.monotonic() - self._began)

    # Messages, in the sender's thread.

    def _run(self) -> None:
        while self.state_name != "active":  # until then nothing goes out
            if self._stopping.wait(_POLL_S):
                return
        period_ns = round(1e9 / self.config.course.rate_hz)
        start_ns, start, number = self.get_clock().now().nanoseconds, time.monotonic(), 0
        while True:
            due = start + number * period_ns * 1e-9
            if self._stopping.wait(max(0.0, due - time.monotonic())):
                return
            missed = int((time.monotonic() - due) / (period_ns * 1e-9))
            if missed * period_ns > _LATE_NS:  # the machine slept: what is long past is left out
                self._late += missed
                number += missed
            try:
                self._send(number, start_ns, period_ns)
            except Exception as err:  # noqa: BLE001  a thread that ends silently would leave everybody waiting
                if self.context.ok():
                    self.get_logger().error(f"{type(err).__name__}: {err}")
                return
            number += 1

    def _send(self, number: int, start_ns: int, period_ns: int) -> None:
        counts = self._fingers(number)
        stamp = self._faults.stamp(start_ns + number * period_ns)
        if stamp is not None:
            self._tactile.publish(biotac_all_to_msg(counts, self.config.tactile_frame, stamp))
        current = self._current
        if current is not None and number - current.first >= len(current.course.counts) - 1:
            self._current = None
            self._tell(current, start_ns + current.first * period_ns, period_ns)

    def _fingers(self, number: int) -> dict[str, Any]:
        """(25,) counts of each finger that has a BioTac."""
        if self._current is None and self._ready is not None:
            self._current, self._ready = replace(self._ready, first=number), None
        elapsed_s = time.monotonic() - self._began
        grasping, *idle = [fingers.read(elapsed_s) for fingers in self._resting]
        current = self._current
        if current is not None:
            row = min(number - current.first, len(current.course.counts) - 1)
            grasping, self.phase = current.course.counts[row], current.course.phase(row)
        # A finger that does not grasp is one more of the middle finger's make.
        return {
            **dict(zip(_GRASPING, grasping, strict=True)),
            **{name: pair[1] for name, pair in zip(self._idle_fingers, idle, strict=True)},
        }

    def _tell(self, execution: Execution, first_ns: int, period_ns: int) -> None:
        """Publish what was done, and be idle again."""
        course = execution.course
        self.executed[course.reason or "success"] += 1
        if course.success:
            self.statistics.use(execution.order.arrived, (first_ns - execution.order.planned_ns) * 1e-9)
        else:
            self.get_logger().warning(f"grasp {execution.order.message.grasps[0].id}: {course.message}")
            self.statistics.drop(course.reason)
        self._idle()
        self._told.publish(executed_to_msg(execution, first_ns, period_ns))
