# SPDX-License-Identifier: Apache-2.0
"""An executor that takes the messages of a node's inputs in a thread of its own.

rclpy builds a list of all that it waits for at every message: about 30 services, timers and events a node. The inputs
alone are a few entries. Their events belong to them: a new message also wakes a thread that waits for one of these.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from foretouch.ros.runtime.internal_errors import InternalErrors, spin_on

if TYPE_CHECKING:
    from rclpy.node import Node

_POLL_S = 1.0  # between checks whether the executor is shut down, beside being woken


class InputGroup(ReentrantCallbackGroup):
    """The callback group of a node's inputs; the node itself sees to it that they are never served at the same time."""


class GraphExecutor(SingleThreadedExecutor):
    """Serves all but the inputs of `ForetouchNode.subscribe` in the thread that spins, and these in a second thread.

    Args:
        errors: Where errors in taking a message are reported.
    """

    def __init__(self, errors: InternalErrors) -> None:
        self._inputs: _InputExecutor | None = None  # `wake` may be called as soon as the base class is made
        super().__init__()
        self._inputs = _InputExecutor(self)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(self._inputs, errors), name="inputs", daemon=True)
        self._thread.start()

    def can_execute(self, entity: Any) -> bool:
        """See rclpy's `Executor`."""
        return not isinstance(entity.callback_group, InputGroup) and super().can_execute(entity)

    def add_node(self, node: Node) -> bool:
        """See rclpy's `Executor`."""
        added = super().add_node(node)
        self.wake()
        return added

    def wake(self) -> None:
        """See rclpy's `Executor`."""
        super().wake()
        if self._inputs is not None:
            self._inputs.wake()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """See rclpy's `Executor`."""
        self._ending.set()
        self.wake()
        self._thread.join(timeout_sec)
        if self._inputs is not None:
            self._inputs.shutdown(timeout_sec)
        return super().shutdown(timeout_sec)

    def _serve(self, inputs: _InputExecutor, errors: InternalErrors) -> None:
        with suppress(ExternalShutdownException):
            spin_on(inputs, errors, self._ending.is_set, _POLL_S)


class _InputExecutor(SingleThreadedExecutor):
    """Takes the messages of the inputs of another executor's nodes."""

    def __init__(self, nodes_of: GraphExecutor) -> None:
        super().__init__()
        self._nodes_of = nodes_of

    def get_nodes(self) -> list[Node]:
        """See rclpy's `Executor`."""
        return self._nodes_of.get_nodes()

    def can_execute(self, entity: Any) -> bool:
        """See rclpy's `Executor`."""
        return isinstance(entity.callback_group, InputGroup) and super().can_execute(entity)
