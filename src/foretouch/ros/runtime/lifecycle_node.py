# SPDX-License-Identifier: Apache-2.0
"""The base class of all nodes: lifecycle, parameters, QoS and diagnostics.

A node implements four hooks, `_setup` and `_teardown` (configure, clean up) and `_start` and `_stop` (activate,
deactivate). An error in `_setup` or `_start` refuses the transition and is logged in one line.

Inputs follow the QoS of their publishers (see `FollowingSubscription`), outputs are published reliably. Outputs that are kept for
late subscribers are transient local. All can be overridden (`qos_overrides.<topic>...` parameters).
"""

import inspect
import os
import threading
from abc import abstractmethod
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, Generic, TypeVar, cast

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, ForetouchError, quoted, shown
from foretouch.ros.runtime.diagnostics import InputStatistics, Report
from foretouch.ros.runtime.discovery import find_conflicts
from foretouch.ros.runtime.internal_errors import InternalErrors, failed_response
from foretouch.ros.runtime.parameters import NodeSettings, set_known
from foretouch.ros.runtime.subscription import FollowingSubscription, InputTopic
from foretouch.topics import NAMESPACE

_C = TypeVar("_C", bound="NodeConfig")
REQUESTS = QoSProfile(depth=5000)
"""Of services: what exceeds the depth is lost without a trace, with rclpy's own of 10 already 190 of 200 requests at once."""
# Each event would take as long as a subscription in every wait of rclpy's executor.
_NO_EVENTS: Final = PublisherEventCallbacks(use_default_callbacks=False)


@dataclass(frozen=True, kw_only=True)
class NodeConfig(Settings, read_only=True):
    """Settings of every node."""

    autostart: bool = setting(True, "Whether the node configures and activates itself")
    diagnostics_period_s: float = setting(1.0, "Time between reports in /diagnostics", bounds=(0.1, 60.0))


class ForetouchNode(LifecycleNode, Generic[_C]):
    """A lifecycle node with typed settings and diagnostics, whose process no error in a callback ends.

    Every field of `config_class` becomes a parameter; a `ConfigError` if one that is given at the start breaks a rule.
    `options` are for rclpy's `Node`; the namespace is `/foretouch` by default.
    """

    default_name: ClassVar[str]
    config_class: ClassVar[type[NodeConfig]]
    exclusive_topics: ClassVar[tuple[str, ...]] = ()
    """Topics that only one node of a graph publishes; another publisher is reported as a second graph."""

    def __init__(self, **options: Any) -> None:
        super().__init__(self.default_name, **{"namespace": NAMESPACE, **options})
        self.internal_errors = InternalErrors(self.get_logger().error)
        self.closing = ExitStack()  # of what `_setup` made, closed when the node is cleaned up
        try:
            self._settings = NodeSettings(self, cast("type[_C]", self.config_class), self._config_changed)
        except ForetouchError:
            super().destroy_node()  # or the context would, through the hooks of a node that is incomplete
            raise
        for service in self.services:  # of parameters and of the lifecycle
            callback = service.callback
            if service.srv_type is ChangeState:
                callback = partial(self._change_state, callback)
            elif service.srv_type in (SetParameters, SetParametersAtomically):
                callback = partial(set_known, self, callback)
            service.callback = self.internal_errors.guarded(service.srv_name, callback, failed_response)
        self.statistics = InputStatistics()
        self.state_name = "unconfigured"
        self.failure = ""  # why the node could not be configured or activated, or its thread has ended
        self._followed: dict[str, FollowingSubscription] = {}  # by topic
        self.conflicts: tuple[str, ...] = ()  # signs of a second graph in the namespace, a line each
        self.past_conflicts: list[str] = []  # all that there have been
        self._input_group = MutuallyExclusiveCallbackGroup()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10, event_callbacks=_NO_EVENTS)
        self.every(self.config.diagnostics_period_s, self._publish_report)
        self.every(0.5, self._look)

    @property
    def config(self) -> _C:
        """The current settings; a change replaces the whole object."""
        return self._settings.value

    # Hooks that a node implements; an error is logged, and is the `failure`.

    def _setup(self) -> None:
        """Configure: make publishers and subscriptions, and load what takes long."""

    def _start(self) -> None:
        """Activate: start the work."""

    def _stop(self) -> None:
        """Deactivate: end what `_start` started; also called where nothing was started."""

    def _teardown(self) -> None:
        """Clean up: forget what `_setup` made, after what is in `closing` was closed."""

    def _config_changed(self, config: _C) -> None:
        """React to a parameter that was changed at run time."""

    def has_ended(self) -> bool:
        """Return whether the node has nothing more to do; its process may then end."""
        return False

    def diagnose(self, report: Report) -> None:
        """Add to a report for /diagnostics what is wrong, and further values."""

    # What a node uses.

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the full name of a topic; a `ConfigError` if it is none."""
        try:
            return str(super().resolve_topic_name(topic, only_expand=only_expand))
        except RuntimeError as err:  # of rcl
            rule = "is not the name of a topic: words of letters, digits and _ with / between them"
            raise ConfigError(f"{quoted(topic)} {rule}") from err

    def advertise(self, message: type, topic: str, *, depth: int = 10, keep: bool = False) -> LifecyclePublisher:
        """Make a reliable publisher, which publishes only while the node is active.

        Args:
            message: Type of the messages.
            topic: Name of the topic.
            depth: Messages that may wait for a subscriber.
            keep: Whether a late subscriber that asks for it (transient local) gets the last `depth` messages.
        """
        durability = DurabilityPolicy.TRANSIENT_LOCAL if keep else DurabilityPolicy.VOLATILE
        overridden = [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY]
        if keep:
            overridden.append(QoSPolicyKind.DURABILITY)
        publisher = self.create_lifecycle_publisher(
            message,
            topic,
            QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability),
            qos_overriding_options=QoSOverridingOptions(overridden),
            event_callbacks=_NO_EVENTS,
        )
        self.closing.callback(self.destroy_lifecycle_publisher, publisher)
        return publisher

    def subscribe(self, topic: InputTopic, callback: Callable[[Any], None]) -> FollowingSubscription:
        """Subscribe until the node is cleaned up; callbacks of a node never run at the same time.

        Args:
            topic: What to subscribe to.
            callback: Called with each message.
        """
        fail, lose = self.internal_errors.report, self.statistics.lose
        subscription = FollowingSubscription(self, topic, callback, fail, self._input_group, lose)
        self._followed[topic.name] = subscription
        return subscription

    def unsubscribe(self, name: str) -> None:
        """End the subscription to a topic, by its name before remapping."""
        self._followed.pop(name).destroy()

    def serve(self, kind: Any, name: str, callback: Callable[..., Any], group: CallbackGroup) -> None:
        """Offer a service until the node is cleaned up.

        Args:
            kind: Type of the service.
            name: Of the service.
            callback: Answers a request; a coroutine function must not raise.
            group: Callback group.
        """
        guarded = callback
        if not inspect.iscoroutinefunction(callback):
            guarded = self.internal_errors.guarded(name, callback, failed_response)
        service = self.create_service(kind, name, guarded, callback_group=group, qos_profile=REQUESTS)
        self.closing.callback(self.destroy_service, service)

    def every(self, period_s: float, callback: Callable[[], None]) -> Any:
        """Make a timer, which goes on while the clock of a simulator stands.

        Args:
            period_s: Between two calls [s].
            callback: Errors are counted by its name.
        """
        guarded = self.internal_errors.guarded(callback.__name__.strip("_"), callback)
        clock, group = Clock(clock_type=ClockType.STEADY_TIME), MutuallyExclusiveCallbackGroup()
        return self.create_timer(period_s, guarded, callback_group=group, clock=clock)

    def _look(self) -> None:
        """Do what is due now and then: follow the publishers, and look for a second graph."""
        for subscription in tuple(self._followed.values()):
            for line in subscription.follow():
                self.get_logger().info(line)
        self.look_for_second_graph()

    def look_for_second_graph(self) -> None:
        """Log signs of a second graph once, and report them in /diagnostics while they last."""
        self.conflicts = find_conflicts(self, self.exclusive_topics)
        fresh = [text for text in self.conflicts if text not in self.past_conflicts]
        self.past_conflicts += fresh
        if fresh:
            cure = "end one, or set another namespace or ROS_DOMAIN_ID"
            where = self.get_namespace()
            self.get_logger().warning(f"a second graph or source runs in {where}: {'; '.join(fresh)}; {cure}")

    def age_s(self, stamp_ns: int) -> float:
        """Compute the age of a stamp on the node's clock [s]."""
        return float(self.get_clock().now().nanoseconds - stamp_ns) * 1e-9

    # Transitions.

    def _change_state(self, callback: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        """Change the state, or refuse a transition that the state does not admit; rclpy raises an error for it."""
        try:
            return callback(request, response)
        except Exception:  # noqa: BLE001  rclpy declares no type for it; errors of hooks are caught in `_attempt`
            asked = shown(request.transition.label) or request.transition.id
            self.get_logger().warning(f"transition {asked}: refused in the state {self.state_name}")
            response.success = False
            return response

    def autostart(self) -> bool:
        """Configure and activate, if the parameter `autostart` is set; False if a transition was refused."""
        steps = (self.trigger_configure, self.trigger_activate) if self.config.autostart else ()
        return all(step() == TransitionCallbackReturn.SUCCESS for step in steps)

    def stop(self) -> None:
        """End the work, whatever the state."""
        self._attempt(self._stop)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Set up."""
        self.failure = ""
        if not self._attempt(self._setup):
            self._release()
            return TransitionCallbackReturn.FAILURE
        self.state_name = "inactive"
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start."""
        self.failure = ""
        if not self._attempt(self._start):
            self.stop()  # what it has started
            return TransitionCallbackReturn.FAILURE
        result = super().on_activate(state)
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
        super().destroy_node()

    def _attempt(self, hook: Callable[[], None]) -> bool:
        try:
            hook()
        except ForetouchError as err:
            self.failure = str(err)
            self.get_logger().error(self.failure)
            return False
        except Exception as err:  # noqa: BLE001  rclpy would not report it
            if self.context.ok():
                self.failure = self.internal_errors.report(hook.__name__.strip("_"), err)
            return False
        return True

    def _release(self) -> None:
        for name in tuple(self._followed):  # before what their callbacks use
            self.unsubscribe(name)
        self._attempt(self.closing.close)
        self._attempt(self._teardown)

    def reported(self) -> Report:
        """Make a report of what is wrong now, without the counts of inputs."""
        report = Report()
        self._describe(report)
        return report

    def _describe(self, report: Report) -> None:
        if self.failure:
            report.errors.append(self.failure)
        report.warnings += self.conflicts
        for name, subscription in tuple(self._followed.items()):
            report.warnings += subscription.excluded
            if subscription.losses.count:
                report.values[f"lost_on_the_way.{name}"] = str(subscription.losses.count)
        self.diagnose(report)

    def _publish_report(self) -> None:
        report, rate_hz = Report(), self.statistics.summary().rate_hz
        report.values |= {"state": self.state_name, "pid": str(os.getpid())}
        active = self.state_name == "active"
        self.statistics.add_to(report, getattr(self.config, "silence_s", None) if active else None)
        self._describe(report)
        self.internal_errors.add_to(report)
        status = report.to_msg(self.get_fully_qualified_name(), f"{self.state_name}, {rate_hz:.1f} Hz")
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


class ThreadNode(ForetouchNode[_C]):
    """A node that works in a thread while it is active.

    Attributes:
        stopping: Set when the thread must end.
        ended: Set when it has ended.
    """

    def __init__(self, **options: Any) -> None:
        self.stopping, self.ended = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        super().__init__(**options)

    @abstractmethod
    def _run(self) -> None:
        """Work until `stopping` is set."""

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start, and then the thread: what it published before would be lost."""
        result = super().on_activate(state)
        if result == TransitionCallbackReturn.SUCCESS:
            self.stopping.clear()
            self.ended.clear()
            self._thread = threading.Thread(target=self._work, name=self.get_name(), daemon=True)
            self._thread.start()
        return result

    def _stop(self) -> None:
        """End the thread."""
        self.stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _work(self) -> None:
        self._attempt(self._run)
        self.ended.set()
