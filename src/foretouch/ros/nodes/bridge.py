# SPDX-License-Identifier: Apache-2.0
"""The live graph for Foxglove and Lichtblick: serves the topics over a WebSocket, as serialised messages with their definitions.

A topic is subscribed to only while a client asks for it. Callbacks of the executor pass the bytes on as they are; threads of
the Foxglove SDK send them. Of what a slow client has not fetched, the SDK drops the oldest messages.
The SDK bounds what waits for a client in messages, not in bytes. So of a large cloud every n-th point is served.

The SDK admits every WebSocket, also of web pages: a page in a browser of this machine can read the topics.
"""

import threading
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image, PointCloud2
from visualization_msgs.msg import MarkerArray

from foretouch.config import setting
from foretouch.dataset.recordings.sample_codec import Definitions
from foretouch.errors import ConfigError, MissingDependencyError
from foretouch.ros.messages.tactile import TactileInput
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.ros.runtime.subscription import InputTopic, SerializedMessage, type_name
from foretouch.ros.sessions.subscriptions import RecordedTopic, sample_topics
from foretouch_msgs.msg import ObjectArray, RecorderStatus

_END_S: Final = 2.0  # for clients to hear of the end


@dataclass(frozen=True, kw_only=True)
class BridgeConfig(NodeConfig, TactileInput, read_only=True):
    """Settings of the bridge."""

    address: str = setting("127.0.0.1", "Address to listen on; 0.0.0.0 for other machines too")
    port: int = setting(8765, "Port to listen on; 0 for a free one", bounds=(0, 65535))
    backlog: int = setting(16, "Messages that may wait for a client; its oldest are dropped", bounds=(1, 100_000))
    cloud_kb: int = setting(250, "Largest cloud served [kB]; of a larger one every n-th point", bounds=(1, 1_000_000))


class BridgeNode(ForetouchNode[BridgeConfig]):
    """The bridge as a lifecycle node; it serves while it is active."""

    default_name, config_class = "bridge", BridgeConfig

    def __init__(self, **options: Any) -> None:
        self.url = ""  # where clients connect, while it is active
        self._served: dict[str, tuple[InputTopic, Any]] = {}  # topics with their channels, by full name
        self._asked: set[str] = set()  # full names of the topics that clients ask for
        self._server: Any = None
        self._thinned = 0  # clouds of which every n-th point was served
        self._lock = threading.Lock()
        super().__init__(**options)

    def _setup(self) -> None:
        foxglove = foxglove_sdk()
        self._channels_context = foxglove.Context()
        definitions = Definitions()
        others = {"objects": ObjectArray, "markers": MarkerArray, "recorder_status": RecorderStatus}
        others |= {"/diagnostics": DiagnosticArray, "grasp_poses": PoseArray, "labels": Image, "overlay": Image}
        topics = sample_topics(self.config, points=True)
        topics += [RecordedTopic(topic, kind) for topic, kind in others.items()]
        for topic in topics:
            name, kind = self.resolve_topic_name(topic.name), type_name(topic.message)
            schema = foxglove.Schema(name=kind, encoding="ros2msg", data=definitions.text(kind).encode())
            channel = foxglove.Channel(name, schema=schema, message_encoding="cdr", context=self._channels_context)
            self._served[name] = topic, channel
            self.closing.callback(channel.close)
        self.closing.callback(self.destroy_timer, self.every(0.2, self._follow_clients))

    def _start(self) -> None:
        foxglove, config = foxglove_sdk(), self.config
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
        self.get_logger().info(f"serving at {self.url}")

    def _stop(self) -> None:
        if self._server is not None:
            server, self._server = self._server, None
            ending = threading.Thread(target=server.stop, name="bridge-end", daemon=True)
            ending.start()  # a client that does not read must not hold up the end of the graph
            ending.join(_END_S)
        with self._lock:
            while self._asked:
                self.unsubscribe(self._served[self._asked.pop()][0].name)
        self.url = ""

    def _teardown(self) -> None:
        self._served.clear()

    def diagnose(self, report: Report) -> None:
        """Report what clients ask for."""
        with self._lock:
            report.values |= {"url": self.url, "topics": " ".join(sorted(self._asked))}
        report.values["clouds_thinned"] = str(self._thinned)

    def _follow_clients(self) -> None:
        """Subscribe to what clients ask for, and to nothing else."""
        with self._lock:
            for name, (topic, channel) in self._served.items():
                wanted = self._server is not None and channel.has_sinks()
                if wanted and name not in self._asked:
                    self._asked.add(name)
                    self.subscribe(topic, self._forward)
                elif name in self._asked and not wanted:
                    self._asked.remove(name)
                    self.unsubscribe(topic.name)

    def _forward(self, message: SerializedMessage) -> None:
        arrived = self.statistics.receive()
        if message.topic not in self._served or self._server is None:
            self.statistics.drop("stopped")
            return
        topic, channel = self._served[message.topic]
        content = bytes(message.data)
        if topic.message is PointCloud2 and len(content) > self.config.cloud_kb * 1000:
            content = thinned(content, self.config.cloud_kb * 1000)
            self._thinned += 1
        channel.log(content, log_time=message.received_ns)
        self.statistics.use(arrived, 0.0)


def thinned(content: bytes, most: int) -> bytes:
    """Take every n-th point of a cloud, with the smallest n for which the points fit.

    Args:
        content: A serialised `PointCloud2`.
        most: Largest size of the points [bytes].

    Returns:
        The serialised cloud, in one row if points were left out.
    """
    cloud = deserialize_message(content, PointCloud2)
    width = cloud.width * cloud.point_step
    every = -(-cloud.height * width // most)
    if every <= 1 or len(cloud.data) != cloud.height * cloud.row_step or cloud.row_step < width:
        return content  # small, or malformed: shown as it is
    rows = np.frombuffer(cloud.data, np.uint8).reshape(cloud.height, cloud.row_step)[:, :width]
    points = rows.reshape(-1, cloud.point_step)[::every]
    cloud.height = 1
    cloud.width = len(points)
    cloud.row_step = points.size
    cloud.data = points.tobytes()
    return bytes(serialize_message(cloud))


def foxglove_sdk() -> Any:
    """Import the package `foxglove`; a `MissingDependencyError` if it is not installed."""
    try:
        import foxglove
    except ImportError as err:
        raise MissingDependencyError("the Foxglove SDK is not installed: pip install 'foretouch[serve]'") from err
    return foxglove
