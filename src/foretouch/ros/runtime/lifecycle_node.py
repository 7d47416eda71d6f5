# SPDX-License-Identifier: Apache-2.0
"""The base class of all nodes: lifecycle, parameters, QoS and diagnostics.

A node implements four hooks, `_setup` and `_teardown` (configure, clean up) and `_start` and `_stop` (activate,
deactivate). An error in `_setup` or `_start` refuses the transition and is logged in one line.

Inputs are subscribed to with sensor-data QoS, outputs are published reliably: this pair is compatible with every
publisher and subscriber. Outputs that are kept for late subscribers are transient local. All can be overridden
(`qos_overrides.<topic>...` parameters). rclpy logs subscribers with incompatible QoS.
"""

import gc
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from foretouch.config import Settings, setting
from foretouch.dataset.topics import NAMESPACE
from foretouch.errors import ForetouchError
from foretouch.ros.runtime.diagnostics import InputStatistics, InputSummary, Losses, diagnostic_status
from foretouch.ros.runtime.direct import DirectInput, DirectPublisher, direct_topics
from foretouch.ros.runtime.discovery import find_conflicts
from foretouch.ros.runtime.executor import InputGroup
from foretouch.ros.runtime.internal_errors import GuardedCallbacks
from foretouch.ros.runtime.parameters import NodeSettings

_C = TypeVar("_C", bound="NodeConfig")
REQUESTS = QoSProfile(depth=5000)
"""Of services: what exceeds the depth is lost without a trace, with rclpy's own of 10 already 190 of 200 requests at once."""


@dataclass(frozen=True, kw_only=True)
class NodeConfig(Settings, read_only=True):
    """Settings of every node."""

    autostart: bool = setting(True, "Whether the node configures and activates itself")
    diagnostics_period_s: float = setting(1.0, "Time between reports in /diagnostics", bounds=(0.1, 60.0))
    direct: bool = setting(
        True, "Whether messages to nodes of the same process that have this set are handed over without the middleware"
    )


class ForetouchNode(GuardedCallbacks, LifecycleNode, Generic[_C]):
    """A lifecycle node with typed settings and diagnostics, whose process no error in a callback ends.

    Every field of `config_class` becomes a parameter; a `ConfigError` if one that is given at the start breaks a rule.
    `options` are for rclpy's `Node`; the namespace is `/foretouch` by default.
    """

    exclusive_topics: ClassVar[tuple[str, ...]] = ()
    """Topics that only one node of a graph publishes; another publisher is reported as a second graph."""

    def __init__(self, name: str, config_class: type[_C], **options: Any) -> None:
        super().__init__(name, **{"namespace": NAMESPACE, **options})
        self._closing = ExitStack()  # of what `_setup` made
        try:
            self._settings = NodeSettings(self, config_class, self._config_changed)
        except ForetouchError:
            self._destroy()  # or the context would, through the hooks of a node that is incomplete
            raise
        self.statistics = InputStatistics()
        self.state_name = "unconfigured"
        self.has_failed = False  # whether the process ends with exit status 1
        self.last_failure = ""  # why the latest step that failed did
        self.direct_topics = direct_topics(self.context)
        self._outputs: list[DirectPublisher] = []
        self._input_lock = threading.RLock()
        self._losses: dict[str, Losses] = {}
        self.conflicts: tuple[str, ...] = ()  # signs of a second graph in the namespace, a line each
        self.past_conflicts: list[str] = []  # all that there have been
        self._last: InputSummary | None = None
        self._last_errors: Counter[str] = Counter()
        self._input_group = InputGroup()
        own_group = MutuallyExclusiveCallbackGroup()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(self.config.diagnostics_period_s, self._report, callback_group=own_group)
        self.create_timer(1.0, self._look, callback_group=own_group)

    @property
    def config(self) -> _C:
        """The current settings; a change replaces the whole object."""
        return self._settings.value

    # Hooks that a node implements.

    def _setup(self) -> None:
        """Configure: make publishers and subscriptions, and load what takes long."""

    def _start(self) -> None:
        """Activate: start the work."""

    def _stop(self) -> None:
        """Deactivate: end what `_start` started; also called where nothing was started."""

    def _teardown(self) -> None:
        """Clean up: forget what `_setup` made, after what is in `_closing` was closed."""

    def _config_changed(self, config: _C) -> None:
        """React to a parameter that was changed at run time."""

    def has_ended(self) -> bool:
        """Whether the node has nothing more to do; its process may then end."""
        return False

    def errors(self) -> tuple[str, ...]:
        """What keeps the node from working, for /diagnostics."""
        return ()

    def warnings(self) -> tuple[str, ...]:
        """What the operator should know although the node works, for /diagnostics."""
        return ()

    def notes(self) -> dict[str, str]:
        """Further values for /diagnostics."""
        return {}

    # What a node uses.

    def advertise(
        self, message: type, topic: str, *, depth: int = 10, direct: bool = True, keep: bool = False
    ) -> DirectPublisher:
        """Make a reliable publisher, which publishes only while the node is active.

        Args:
            message: Type of the messages.
            topic: Name of the topic.
            depth: Messages that may wait for a subscriber.
            direct: Whether subscriptions of the same process may get the objects that are published, which must
                then stay as they are; not for serialised messages.
            keep: Whether a late subscriber that asks for it (transient local) gets the last `depth` messages.
        """
        durability = DurabilityPolicy.TRANSIENT_LOCAL if keep else DurabilityPolicy.VOLATILE

        overridden = [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY]
        publisher: DirectPublisher = self.create_publisher(
            message,
            topic,
            QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability),
            qos_overriding_options=QoSOverridingOptions([*overridden, *[QoSPolicyKind.DURABILITY] * keep]),
            publisher_class=DirectPublisher,
        )
        self.add_managed_entity(publisher)
        self._outputs.append(publisher)
        self._closing.callback(self._withdraw, publisher)
        if direct and self.config.direct:
            self.direct_topics.add(publisher)
        return publisher

    def subscribe(self, message: type, topic: str, callback: Callable[[Any], None], *, depth: int = 5) -> None:
        """Subscribe with sensor-data QoS; at most `depth` messages wait. Callbacks of a node never run at the same time."""
        losses = self._losses[topic] = Losses(self.statistics.lose)

        def _receive(content: Any) -> None:
            with self._input_lock:
                callback(content)

        def _take(content: Any, info: Any) -> None:
            if direct is None or not direct.is_copy(content):
                losses.arrived(info)
                _receive(content)

        direct: DirectInput | None = None
        subscription = self.create_subscription(
            message,
            topic,
            self.internal_errors.guarded(topic, _take),
            QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT),
            callback_group=self._input_group,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self._closing.callback(self.destroy_subscription, subscription)
        if self.config.direct:
            direct = DirectInput(subscription, self.internal_errors.guarded(topic, _receive))
            self._closing.callback(self.direct_topics.remove, direct)
            self.direct_topics.add(direct)

    def serve(self, kind: Any, name: str, callback: Callable[..., Any], group: CallbackGroup) -> None:
        """Offer a service until the node is cleaned up."""
        guarded = self.guarded_service(name, callback)
        service = self.create_service(kind, name, guarded, callback_group=group, qos_profile=REQUESTS)
        self._closing.callback(self.destroy_service, service)

    def _look(self) -> None:
        """What is done every second: look for a second graph, and send what is kept to late subscribers."""
        self.look_for_second_graph()
        for publisher in tuple(self._outputs):
            publisher.send_unsent()

    def look_for_second_graph(self) -> None:
        """Log signs of a second graph once, and report them in /diagnostics while they last."""
        found = find_conflicts(self, self.exclusive_topics)
        fresh = [text for text in found if text not in self.conflicts]
        self.conflicts = found
        self.past_conflicts += [text for text in fresh if text not in self.past_conflicts]
        if fresh:
            self.get_logger().warning(f"a second graph or source runs in {self.get_namespace()}: {'; '.join(fresh)}")

    def age_s(self, stamp_ns: int) -> float:
        """Age of a stamp on the node's clock [s]."""
        return float(self.get_clock().now().nanoseconds - stamp_ns) * 1e-9

    # Transitions.

    def autostart(self) -> bool:
        """Configure and activate, if the parameter `autostart` is set; False if a transition was refused."""
        steps = (self.trigger_configure, self.trigger_activate) if self.config.autostart else ()
        return all(step() == TransitionCallbackReturn.SUCCESS for step in steps)

    def stop(self) -> None:
        """End the work, whatever the state."""
        self._attempt(self._stop)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Set up."""
        if not self._attempt(self._setup):
            self._release()
            return TransitionCallbackReturn.FAILURE
        self.state_name = "inactive"
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start."""
        if not self._attempt(self._start):
            return TransitionCallbackReturn.FAILURE
        result = super().on_activate(state)
        gc.freeze()  # else all that was loaded is searched for garbage from time to time, for 0.1 s
        self.state_name = "active"
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop."""
        self.state_name = "inactive"
        self.stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Tear down, and destroy publishers and subscriptions."""
        result = super().on_cleanup(state)
        self._release()
        gc.collect()  # scenes and models refer to themselves, and would stay for minutes beside the next ones
        self.state_name = "unconfigured"
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and clean up."""
        self.stop()
        result = super().on_shutdown(state)
        self._release()
        self.state_name = "finalized"
        return result

    def destroy_node(self) -> None:
        """Stop and clean up, whatever the state."""
        self.stop()
        self._release()
        self._destroy()

    def _destroy(self) -> None:
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()  # else the node would be listed until it is garbage

    def _attempt(self, hook: Callable[[], None]) -> bool:
        try:
            hook()
        except ForetouchError as err:
            self.last_failure = str(err)
            self.get_logger().error(self.last_failure)
            return False
        except Exception as err:  # noqa: BLE001  rclpy would not report it
            self.last_failure = f"{type(err).__name__}: {err}"
            self.internal_errors.report(hook.__name__.strip("_"), err)
            return False
        return True

    def _release(self) -> None:
        gc.unfreeze()
        self._attempt(self._closing.close)
        self._attempt(self._teardown)

    def _withdraw(self, publisher: DirectPublisher) -> None:
        self._outputs.remove(publisher)
        self.direct_topics.remove(publisher)
        self.destroy_lifecycle_publisher(publisher)

    def _report(self) -> None:
        now, errors = self.statistics.summary(), self.internal_errors.counts()
        recent = [f"{count} internal errors in {name}" for name, count in (errors - self._last_errors).items()]
        status = diagnostic_status(
            self.get_fully_qualified_name(),
            self.state_name,
            now,
            self._last,
            errors=self.errors(),
            warnings=(*self.conflicts, *self.warnings(), *recent),
            notes={
                **self.notes(),
                **{f"lost_on_the_way.{topic}": str(one.count) for topic, one in self._losses.items() if one.count},
                **{f"internal_errors.{name}": str(count) for name, count in errors.items()},
            },
            silence_s=getattr(self.config, "silence_s", None),
        )
        self._last, self._last_errors = now, errors
        report = DiagnosticArray(status=[status])
        report.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(report)
