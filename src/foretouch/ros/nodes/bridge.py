# SPDX-License-Identifier: Apache-2.0
"""The live graph for Foxglove and Lichtblick: serves the topics over a WebSocket, as serialised messages with their definitions.

A topic is subscribed to only while a client asks for it. Callbacks of the executor pass the bytes on as they are; threads of
the Foxglove SDK send them. Of what a slow client has not fetched, the SDK drops the oldest messages. It reports that
once in half a minute and without numbers; /diagnostics counts these reports.
"""

import logging
import threading
import time
from dataclasses import dataclass
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import ReliabilityPolicy
from visualization_msgs.msg import MarkerArray

from foretouch.config import setting
from foretouch.dataset.recording.sample_codec import Definitions
from foretouch.errors import ConfigError, MissingDependencyError, shown
from foretouch.ros.messages.tactile import TactileInput
from foretouch.ros.recorder.subscriptions import InputTopic, SerializedInput, SerializedMessage, sample_topics
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.ros.runtime.origins import OriginGate
from foretouch_msgs.msg import ObjectArray, RecorderStatus

_DEPTH: Final = 100
_CLOUD_DEPTH: Final = 10
_SLOW: Final = "a client reads too slowly: its oldest messages are dropped"


@dataclass(frozen=True, kw_only=True)
class BridgeConfig(NodeConfig, TactileInput, read_only=True):
    """Settings of the bridge."""

    address: str = setting("127.0.0.1", "Address to listen on; 0.0.0.0 for other machines too")
    port: int = setting(8765, "Port to listen on; 0 for a free one", bounds=(0, 65535))
    allow_origin: tuple[str, ...] = setting(
        (), "Origins of web pages that may connect, such as https://app.foxglove.dev; programs need none"
    )
    backlog: int = setting(256, "Messages that may wait for a client; its oldest are dropped", bounds=(1, 100_000))


class _Reports(logging.Handler):
    """Counts the SDK's reports of slow clients, and logs its errors."""

    def __init__(self, node: "BridgeNode") -> None:
        super().__init__()
        self._node = node
        self.count = 0
        self.last_s = float("-inf")

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if record.name.endswith("send_lossy") and "full" in text:  # the messages for a client do not fit
            self.count += 1
            self.last_s = time.monotonic()
            self._node.get_logger().warning(f"{_SLOW} ({text})")
        elif record.levelno >= logging.ERROR and "closing handshake" not in text:
            self._node.get_logger().warning(text)


@dataclass(eq=False)
class _Served:
    """One topic: its channel, and its subscription while a client asks for it."""

    topic: InputTopic
    channel: Any
    input: SerializedInput | None = None


def _unsubscribe(one: _Served) -> None:
    if one.input is not None:
        one.input.destroy()
        one.input = None


class BridgeNode(ForetouchNode[BridgeConfig]):
    """The bridge as a lifecycle node; it serves while it is active."""

    def __init__(self, name: str = "bridge", **options: Any) -> None:
        self.url = ""  # where clients connect, while it is active
        self._served: dict[str, _Served] = {}  # by full name
        self._server: Any = None
        self._gate: OriginGate
        self._timer: Any = None
        self._reports = _Reports(self)
        self._lock = threading.Lock()
        super().__init__(name, BridgeConfig, **options)

    def _setup(self) -> None:
        foxglove = foxglove_sdk()
        self._channels_context = foxglove.Context()
        definitions = Definitions()
        others = {"objects": ObjectArray, "markers": MarkerArray, "recorder_status": RecorderStatus}
        topics = sample_topics(self.config, depth=_DEPTH, cloud_depth=_CLOUD_DEPTH, points_depth=_CLOUD_DEPTH)
        topics += [InputTopic(topic, kind, _DEPTH) for topic, kind in others.items()]
        for topic in (*topics, InputTopic("/diagnostics", DiagnosticArray, _DEPTH)):
            name, kind = self.resolve_topic_name(topic.name), topic.type_name
            schema = foxglove.Schema(name=kind, encoding="ros2msg", data=definitions.text(kind).encode())
            channel = foxglove.Channel(name, schema=schema, message_encoding="cdr", context=self._channels_context)
            self._served[name] = _Served(topic, channel)
            self._closing.callback(channel.close)

    def _start(self) -> None:
        foxglove, config = foxglove_sdk(), self.config
        _listen_to_sdk(foxglove).addHandler(self._reports)
        try:
            self._gate = OriginGate(config.address, config.port, config.allow_origin, self._refuse)
        except OSError as err:
            raise ConfigError(f"{config.address}:{config.port}: {err.strerror or err}") from err
        self._server = foxglove.start_server(
            name=f"foretouch {self.get_namespace()}",
            host=self._gate.inner,
            port=0,
            message_backlog_size=config.backlog,
            context=self._channels_context,
        )
        self._gate.open(self._server.port)
        host = f"[{config.address}]" if ":" in config.address else config.address
        self.url = f"ws://{host}:{self._gate.port}"
        self._timer = self.create_timer(0.2, self._follow_clients, callback_group=MutuallyExclusiveCallbackGroup())
        self.get_logger().info(f"serving at {self.url}")

    def _stop(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        if self._server is not None:
            self._gate.close()
            self._server.stop()
            self._server = None
        logging.getLogger("foxglove").removeHandler(self._reports)
        with self._lock:
            for one in self._served.values():
                _unsubscribe(one)
        self.url = ""

    def _teardown(self) -> None:
        self._served.clear()

    def _refuse(self, origin: str) -> None:
        page = shown(origin)
        self.get_logger().warning(f"refused a web page of {page}: --allow-origin {page} (allow_origin) admits it")

    def notes(self) -> dict[str, str]:
        """What clients ask for, and how often the SDK reported that one is slow, for /diagnostics."""
        with self._lock:
            asked = {name: one.input for name, one in self._served.items() if one.input is not None}
        return {
            "url": self.url,
            "topics": " ".join(sorted(asked)),
            "lost_on_the_way": str(sum(one.losses.count for one in asked.values())),
            "slow_clients": str(self._reports.count),
        }

    def warnings(self) -> tuple[str, ...]:
        """Whether a client is slow now: a report of the SDK holds for 30 s."""
        return (_SLOW,) if time.monotonic() - self._reports.last_s <= 30.0 else ()

    def _follow_clients(self) -> None:
        """Subscribe to what clients ask for, and to nothing else."""
        with self._lock:
            for name, one in self._served.items():
                wanted = self._server is not None and one.channel.has_sinks()
                if not wanted:
                    _unsubscribe(one)
                elif one.input is not None:
                    one.input.adapt()
                else:
                    offered = {end.qos_profile.reliability for end in self.get_publishers_info_by_topic(name)}
                    one.input = SerializedInput(
                        self,
                        one.topic,
                        self._forward,
                        self._mismatch,
                        reliable=ReliabilityPolicy.BEST_EFFORT not in offered,
                    )

    def _forward(self, message: SerializedMessage) -> None:
        arrived = self.statistics.receive()
        if (one := self._served.get(message.topic)) is None or self._server is None:
            self.statistics.drop("stopped")
            return
        one.channel.log(message.data, log_time=message.received_ns)
        self.statistics.use(arrived, 0.0)


def foxglove_sdk() -> Any:
    """The package `foxglove`; a `MissingDependencyError` if it is not installed."""
    try:
        import foxglove
    except ImportError as err:
        raise MissingDependencyError("the Foxglove SDK is not installed: pip install 'foretouch[serve]'") from err
    return foxglove


def _listen_to_sdk(foxglove: Any) -> logging.Logger:
    """The logger of the SDK, which reports from then on and prints nothing itself."""
    logger, root = logging.getLogger("foxglove"), logging.getLogger()
    logger.setLevel(logging.INFO)
    logger.propagate = False
    quiet = logging.NullHandler()
    root.addHandler(quiet)  # else the SDK would make Python print the messages of all loggers
    try:
        foxglove.set_log_level("INFO")
    finally:
        root.removeHandler(quiet)
    return logger
