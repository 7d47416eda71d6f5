# SPDX-License-Identifier: Apache-2.0
"""The live graph for Foxglove and Lichtblick: serves the topics over a WebSocket, as serialised messages with their definitions.

A topic is subscribed to only while a client asks for it. Callbacks of the executor pass the bytes on as they are; threads of
the Foxglove SDK send them. Of what a slow client has not fetched, the SDK drops the oldest messages. It reports that
once in half a minute and without numbers; /diagnostics counts these reports.
"""

import logging
import threading
import time
from dataclasses import dataclass, field
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from foretouch.config import setting
from foretouch.dataset.recording.definitions import Definitions
from foretouch.errors import ConfigError, MissingDependencyError
from foretouch.ros.messages.tactile import tactile_class
from foretouch.ros.recorder.message_queue import Arrival
from foretouch.ros.recorder.subscriptions import InputTopic, RecorderInput
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.tactile.messages import TactileConfig
from foretouch.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC, TACTILE_TOPIC
from foretouch_msgs.msg import ExecutedGrasp, GraspArray, ObjectArray, RecorderStatus, TablePlane, TouchPredictionArray

_TICK_S: Final = 0.2  # between two looks at what the clients ask for
_DEPTH: Final = 100
_CLOUD_DEPTH: Final = 10
_SLOW_S: Final = 30.0  # a report of the SDK holds so long
_FULL: Final = "full"  # in the report that the messages for a client do not fit


@dataclass(frozen=True, kw_only=True)
class BridgeConfig(NodeConfig):
    """Settings of the bridge."""

    address: str = setting("127.0.0.1", "Address to listen on; 0.0.0.0 for other machines too", read_only=True)
    port: int = setting(8765, "Port to listen on; 0 for a free one", minimum=0, maximum=65535, read_only=True)
    backlog: int = setting(
        256, "Messages that may wait for a client; its oldest are dropped", minimum=1, maximum=100_000, read_only=True
    )
    tactile_topic: str = setting(TACTILE_TOPIC, "Topic of the tactile messages", read_only=True)
    tactile: TactileConfig = field(default_factory=TactileConfig)


class _Reports(logging.Handler):
    """Counts the SDK's reports of slow clients, and logs its errors."""

    def __init__(self, node: "BridgeNode") -> None:
        super().__init__()
        self._node = node
        self.count = 0
        self.last_s: float | None = None

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if record.name.endswith("send_lossy") and _FULL in text:
            self.count += 1
            self.last_s = time.monotonic()
            self._node.get_logger().warning(f"a client reads too slowly: its oldest messages are dropped ({text})")
        elif record.levelno >= logging.ERROR and "closing handshake" not in text:
            self._node.get_logger().warning(text)


class _Served:
    """One topic: its channel, and its subscription while a client asks for it."""

    def __init__(self, topic: InputTopic, name: str, channel: Any) -> None:
        self.topic = topic
        self.name = name  # in full
        self.channel = channel
        self.input: RecorderInput | None = None


class BridgeNode(ForetouchNode[BridgeConfig]):
    """The bridge as a lifecycle node; it serves while it is active.

    Attributes:
        url: Where clients connect, while it is active; else "".
    """

    def __init__(self, name: str = "bridge", **options: Any) -> None:
        self.url = ""
        self._served: dict[str, _Served] = {}
        self._server: Any = None
        self._timer: Any = None
        self._reports: _Reports | None = None
        self._lock = threading.Lock()
        super().__init__(name, BridgeConfig, **options)

    # Hooks of the base class.

    def setup(self) -> None:
        """Find the definitions of all messages."""
        foxglove = foxglove_sdk()
        self._channels_context = foxglove.Context()
        definitions = Definitions()
        for topic in self._topics():
            name = self.resolve_topic_name(topic.name)
            schema = foxglove.Schema(
                name=topic.type_name, encoding="ros2msg", data=definitions.text(topic.type_name).encode()
            )
            channel = foxglove.Channel(name, schema=schema, message_encoding="cdr", context=self._channels_context)
            self._served[name] = _Served(topic, name, channel)

    def start(self) -> None:
        """Listen."""
        foxglove, config = foxglove_sdk(), self.config
        self._reports = _Reports(self)
        _listen_to_sdk(foxglove).addHandler(self._reports)
        try:
            self._server = foxglove.start_server(
                name=f"foretouch {self.get_namespace()}",
                host=config.address,
                port=config.port,
                message_backlog_size=config.backlog,
                context=self._channels_context,
            )
        except RuntimeError as err:
            raise ConfigError(f"{config.address}:{config.port}: {err}") from err
        host = f"[{config.address}]" if ":" in config.address else config.address
        self.url = f"ws://{host}:{self._server.port}"
        self._timer = self.create_timer(_TICK_S, self._follow_clients, callback_group=MutuallyExclusiveCallbackGroup())
        self.get_logger().info(f"serving at {self.url}")

    def stop(self) -> None:
        """Close all connections."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        if self._server is not None:
            self._server.stop()
            self._server = None
        if self._reports is not None:
            logging.getLogger("foxglove").removeHandler(self._reports)
        with self._lock:
            for one in self._served.values():
                self._unsubscribe(one)
        self.url = ""

    def teardown(self) -> None:
        """Forget the channels."""
        for one in self._served.values():
            one.channel.close()
        self._served.clear()

    def notes(self) -> dict[str, str]:
        """What clients ask for, and how often the SDK reported that one is slow, for /diagnostics."""
        with self._lock:
            asked = sorted(one.name for one in self._served.values() if one.input is not None)
            lost = sum(one.input.lost for one in self._served.values() if one.input is not None)
        slow = 0 if self._reports is None else self._reports.count
        return {"url": self.url, "topics": " ".join(asked), "lost_on_the_way": str(lost), "slow_clients": str(slow)}

    def warnings(self) -> tuple[str, ...]:
        """Whether a client is slow now."""
        last_s = None if self._reports is None else self._reports.last_s
        if last_s is None or time.monotonic() - last_s > _SLOW_S:
            return ()
        return ("a client reads too slowly: its oldest messages are dropped",)

    # Topics.

    def _topics(self) -> list[InputTopic]:
        return [
            InputTopic("points", PointCloud2, _CLOUD_DEPTH),
            InputTopic(CLOUD_TOPIC, PointCloud2, _CLOUD_DEPTH),
            InputTopic("objects", ObjectArray, _DEPTH),
            InputTopic("table", TablePlane, _DEPTH),
            InputTopic(GRASPS_TOPIC, GraspArray, _DEPTH),
            InputTopic("touch", TouchPredictionArray, _DEPTH),
            InputTopic(EXECUTED_TOPIC, ExecutedGrasp, _DEPTH),
            InputTopic("markers", MarkerArray, _DEPTH),
            InputTopic("recorder_status", RecorderStatus, _DEPTH),
            InputTopic(self.config.tactile_topic, tactile_class(self.config.tactile.type), _DEPTH),
            InputTopic("/diagnostics", DiagnosticArray, _DEPTH),
        ]

    def _follow_clients(self) -> None:
        """Subscribe to what clients ask for, and to nothing else."""
        with self._lock:
            for one in self._served.values():
                wanted = self._server is not None and one.channel.has_sinks()
                if wanted and one.input is None:
                    offered = {end.qos_profile.reliability for end in self.get_publishers_info_by_topic(one.name)}
                    reliable = ReliabilityPolicy.BEST_EFFORT not in offered
                    one.input = RecorderInput(self, one.topic, self._forward, self._mismatch, reliable=reliable)
                elif wanted and one.input is not None:
                    one.input.adapt()
                elif not wanted:
                    self._unsubscribe(one)

    @staticmethod
    def _unsubscribe(one: _Served) -> None:
        if one.input is not None:
            one.input.destroy()
            one.input = None

    def _forward(self, arrival: Arrival) -> None:
        arrived = self.statistics.receive()
        one = self._served.get(arrival.topic)
        if one is None or self._server is None:
            self.statistics.drop("stopped")
            return
        one.channel.log(arrival.data, log_time=arrival.received_ns)
        self.statistics.use(arrived, 0.0)


def foxglove_sdk() -> Any:
    """The package `foxglove`.

    Raises:
        MissingDependencyError: If it is not installed.
    """
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
