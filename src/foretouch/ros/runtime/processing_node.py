# SPDX-License-Identifier: Apache-2.0
"""The base class of nodes that answer every cloud: inputs in, one answer out.

Threads: callbacks only store the newest input. A worker computes and publishes, so that services, parameters, lifecycle and
diagnostics respond meanwhile, and the next input is received. An input that a newer one replaces is counted as `superseded`.
"""

import time
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from std_msgs.msg import Header

from foretouch.config import setting
from foretouch.pipeline import PRESET_WORDS
from foretouch.ros.messages.requests import RefusalError, status_name
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.ros.runtime.workers import Worker
from foretouch.types import Cloud, Float32, stamp_ns
from foretouch_msgs.msg import Status

_P = TypeVar("_P", bound="ProcessingConfig")
_PATIENCE_S = 5.0  # with one answer, before a warning, and when the node is stopped
_SLOW = "the model, or what plans and segments, is slow; newer clouds replace those that wait"


class Input(NamedTuple):
    """What one answer is about."""

    header: Header  # of the cloud
    content: Any  # a message, or messages
    arrived: float  # `time.monotonic` [s]


@dataclass(frozen=True, kw_only=True)
class ProcessingConfig(NodeConfig):
    """Settings of every node that answers clouds."""

    preset: str = setting("default", PRESET_WORDS, read_only=True)
    silence_s: float = setting(5.0, "Longest time without an input before a warning", bounds=(0.1, 1e6))


class Step:
    """A part of the answers, with its topics: what it computes is called by the node, the rest by `ProcessingNode`."""

    def configure(self, config: Any) -> None:
        """Use other settings of the node."""

    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish empty outputs.

        Args:
            header: Of the cloud.
            status: Of `foretouch_msgs/Status`, why they are empty.
            reason: The same as text.
        """

    def look(self) -> None:
        """Do what is due twice a second, in the executor's thread."""

    def diagnose(self, report: Report) -> None:
        """Add to a report of the node."""


Published: TypeAlias = tuple[Step, Callable[[], object]]
"""A step, and what it publishes."""


class Answer(NamedTuple):
    """What a node answers to an input, complete before any of it is published."""

    status: int  # of `foretouch_msgs/Status`
    reason: str
    publish: Sequence[Published]  # in this order


class ProcessingNode(ForetouchNode[_P]):
    """Answers one input after the other, the newest next.

    Attributes:
        steps: What the node consists of; it makes them in `_setup`.
    """

    steps: tuple[Step, ...] = ()

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._worker: Worker[Input] = Worker(
            self.get_name(), self._work, self._fail, lambda _, reason: self.statistics.drop(reason), idle="inactive"
        )
        self._outcomes: Counter[str] = Counter()
        self._last_reason = ""
        self._silent_until = 0.0  # `time.monotonic` before which no refusal is logged [s]

    @abstractmethod
    def _answer(self, item: Input) -> Answer:
        """Convert messages to arrays, compute, and convert the result to messages, which are published then.

        Raises a `RefusalError` where there is no result, which all steps then publish.
        """

    def _refuse(self, header: Header, status: int, reason: str) -> None:
        for step in self.steps:
            step.refuse(header, status, reason)

    def _config_changed(self, config: _P) -> None:
        for step in self.steps:
            step.configure(config)

    def _look(self) -> None:
        super()._look()
        for step in self.steps:
            step.look()

    def _teardown(self) -> None:
        self.steps = ()

    def _start(self) -> None:
        self._worker.start()

    def _stop(self) -> None:
        """Finish the current input and drop what waits; an answer that takes longer than a few seconds is dropped, too."""
        if not self._worker.stop(_PATIENCE_S):
            self.get_logger().warning(f"stopped at a cloud that has taken longer than {_PATIENCE_S:g} s: {_SLOW}")

    def diagnose(self, report: Report) -> None:
        """Report numbers of answers by status, why the last was empty, and what the steps add."""
        report.values |= {f"answered.{name}": str(count) for name, count in sorted(self._outcomes.items())}
        report.values["last_reason"] = self._last_reason
        if (busy_s := self._worker.busy_s) > _PATIENCE_S:
            report.warnings.append(f"no answer for {busy_s:.0f} s: {_SLOW}")
        for step in self.steps:
            step.diagnose(report)

    def _receive(self, message: Any) -> None:
        """Take a message that is an input by itself."""
        self._worker.put(Input(message.header, message, self.statistics.receive()))

    def _fail(self, err: Exception) -> None:
        self.internal_errors.report(self.get_name(), err)
        self.statistics.drop("failed")

    def _work(self, item: Input) -> None:
        age_s = self.age_s(stamp_ns(item.header.stamp))
        answer: Answer | None = None
        try:
            answer = self._answer(item)
            status, reason = answer.status, answer.reason
        except RefusalError as refusal:
            status, reason = refusal.status, refusal.reason
        except Exception as err:  # noqa: BLE001  a bug must not end the node, and must be reported
            status, reason = Status.FAILED, str(err)
            if not self._worker.left_behind:
                reason = self.internal_errors.report(self.get_name(), err)
        if self._worker.left_behind:  # of a node that was stopped meanwhile
            self.statistics.drop("stopped")
            return
        if answer is None:
            self._refuse(item.header, status, reason)
        else:
            for step, publish in answer.publish:
                try:
                    publish()
                except Exception as err:  # noqa: BLE001  what the other steps have published stays their answer
                    status, reason = Status.FAILED, self.internal_errors.report(self.get_name(), err)
                    self.internal_errors.guarded(self.get_name(), step.refuse)(item.header, status, reason)
        self.statistics.use(item.arrived, age_s)
        self._note(status, reason)

    def _note(self, status: int, reason: str) -> None:
        """Count an answer, and log a refusal now and then."""
        self._outcomes[status_name(status)] += 1
        self._last_reason = reason
        if status not in (Status.OK, Status.INITIAL_POINTS) and time.monotonic() >= self._silent_until:
            self._silent_until = time.monotonic() + 5.0  # rclpy's own check takes 0.5 ms each time
            self.get_logger().warning(f"{status_name(status)}: {reason}")


def warm_up_cloud() -> Cloud:
    """Make a grey box on a table, seen from above: (120, 160, 3) float32 [m], with colours for models that use them.

    It is processed while a node configures: else half a second of imports and first allocations would delay the first
    clouds, which then wait for each other.
    """
    row, column = np.mgrid[0:120, 0:160].astype(np.float32)
    depth = np.full((120, 160), 0.8, np.float32)
    depth[52:68, 60:100] = 0.7  # the top of the box, 7 x 17 cm
    ray_x, ray_y = (column - 80.0) / 160.0, (row - 60.0) / 160.0
    xyz: Float32 = np.stack([ray_x * depth, ray_y * depth, depth], axis=-1)
    return Cloud(xyz, np.full(xyz.shape, 128, np.uint8), frame_id="warm_up")
