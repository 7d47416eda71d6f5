# SPDX-License-Identifier: Apache-2.0
"""The live graph for Foxglove and Lichtblick: serves the topics over a WebSocket, as serialised messages with their definitions.

A topic is subscribed to only while a client asks for it. Callbacks of the executor pass the bytes on as they are; threads of
the Foxglove SDK send them. Of what a slow client has not fetched, the SDK drops the oldest messages. It reports that
once in half a minute and without numbers; /diagnostics counts these reports.
"""

import logging
import secrets
import socket
import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress
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
from foretouch_msgs.msg import ObjectArray, RecorderStatus

_DEPTH: Final = 100
_CLOUD_DEPTH: Final = 10
_SLOW: Final = "a client reads too slowly: its oldest messages are dropped"
_HEAD_BYTES: Final = 16_384
_HEAD_S: Final = 5.0  # time in which a client must have sent its request
_BLOCK: Final = 1 << 20


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


class BridgeNode(ForetouchNode[BridgeConfig]):
    """The bridge as a lifecycle node; it serves while it is active."""

    def __init__(self, name: str = "bridge", **options: Any) -> None:
        self.url = ""  # where clients connect, while it is active
        self._served: dict[str, tuple[InputTopic, Any]] = {}  # topics with their channels, by full name
        self._asked: dict[str, SerializedInput] = {}  # while a client asks for the topic
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
            self._served[name] = topic, channel
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
            for one in self._asked.values():
                one.destroy()
            self._asked.clear()
        self.url = ""

    def _teardown(self) -> None:
        self._served.clear()

    def _refuse(self, origin: str) -> None:
        page = shown(origin)
        self.get_logger().warning(f"refused a web page of {page}: --allow-origin {page} (allow_origin) admits it")

    def notes(self) -> dict[str, str]:
        """What clients ask for, and how often the SDK reported that one is slow, for /diagnostics."""
        with self._lock:
            asked = dict(self._asked)
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
            for name, (topic, channel) in self._served.items():
                if self._server is None or not channel.has_sinks():
                    if name in self._asked:
                        self._asked.pop(name).destroy()
                elif name in self._asked:
                    self._asked[name].adapt()
                else:
                    offered = {end.qos_profile.reliability for end in self.get_publishers_info_by_topic(name)}
                    reliable = ReliabilityPolicy.BEST_EFFORT not in offered
                    self._asked[name] = SerializedInput(self, topic, self._forward, self._mismatch, reliable=reliable)

    def _forward(self, message: SerializedMessage) -> None:
        arrived = self.statistics.receive()
        if (one := self._served.get(message.topic)) is None or self._server is None:
            self.statistics.drop("stopped")
            return
        one[1].log(message.data, log_time=message.received_ns)
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


class OriginGate:
    """Listens for clients of a server on a port, 0 for a free one; an `OSError` if the address cannot be listened on.

    Every web page that a browser shows may open a WebSocket to this machine, and names its own address as `Origin`, which the server
    does not look at. Programs that are no browser name none. The server listens on an address of this machine's loopback network
    that is drawn at random, so that no page can search for it; here, bytes of the clients that are admitted are passed on in both
    directions.

    Web pages of `allowed` origins may connect, such as `https://app.foxglove.dev`; `refused` is called with those of others.

    Attributes:
        port: The one that it listens on.
        inner: Host that the server must listen on; `open` is then called with its port.
    """

    def __init__(self, address: str, port: int, allowed: Collection[str], refused: Callable[[str], object]) -> None:
        family, _, _, _, where = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM)[0]
        self._listener = socket.create_server(where[:2], family=family)
        self.port = int(self._listener.getsockname()[1])
        self.inner = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
        self._allowed = {one.rstrip("/").lower() for one in allowed}
        self._refused = refused

    def open(self, port: int) -> None:
        """Admit clients from now on; the server listens on this port of `inner`."""
        self._server = (self.inner, port)
        threading.Thread(target=self._accept, name="origins", daemon=True).start()

    def close(self) -> None:
        """Admit nobody any more; clients that are connected stay so until the server ends."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # wakes `accept`
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):  # closed
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(client,), name="client", daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with suppress(OSError), client:
            head = _read_head(client)
            origins = [line[7:].strip() for line in head.split("\r\n") if line.lower().startswith("origin:")]
            if any(origin.lower() not in self._allowed for origin in origins):
                client.sendall(b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: 0\r\n\r\n")
                self._refused(origins[0])
                return
            with socket.create_connection(self._server) as server:
                server.sendall(head.encode("latin-1"))
                client.settimeout(None)
                threading.Thread(target=_pass_on, args=(client, server), name="client", daemon=True).start()
                _pass_on(server, client)


def _read_head(client: socket.socket) -> str:
    """What a client asks for, up to the empty line; an OSError if it is too long or comes too late."""
    head, until = b"", time.monotonic() + _HEAD_S
    while b"\r\n\r\n" not in head:
        client.settimeout(max(0.01, until - time.monotonic()))
        part = client.recv(_HEAD_BYTES)
        head += part
        if not part or len(head) > _HEAD_BYTES or time.monotonic() > until:
            raise OSError("no request")
    return head.decode("latin-1")


def _pass_on(source: socket.socket, sink: socket.socket) -> None:
    """Pass bytes on until one of both ends, and end both."""
    block = memoryview(bytearray(_BLOCK))
    with suppress(OSError):
        while size := source.recv_into(block):
            sink.sendall(block[:size])
    for end in (source, sink):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
