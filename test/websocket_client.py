# SPDX-License-Identifier: Apache-2.0
"""A client of Foxglove's WebSocket protocol, as small as it can be (RFC 6455, subprotocol `foxglove.sdk.v1`)."""

import base64
import json
import os
import socket
import struct
from typing import Any, Self
from urllib.parse import urlparse

_REQUEST = """\
GET / HTTP/1.1
Host: {host}
Upgrade: websocket
Connection: Upgrade
Sec-WebSocket-Key: {key}
Sec-WebSocket-Version: 13
Sec-WebSocket-Protocol: foxglove.sdk.v1
{origin}
"""


class WebSocketClient:
    """Connects, learns the channels, subscribes, and receives; a context manager. `receive_buffer` is in bytes."""

    def __init__(self, url: str, receive_buffer: int | None = None, timeout_s: float = 20.0, origin: str = "") -> None:
        address = urlparse(url)
        self._socket = socket.socket()
        if receive_buffer is not None:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self._socket.settimeout(timeout_s)
        self._socket.connect((address.hostname, address.port))
        key = base64.b64encode(os.urandom(16)).decode()
        line = f"Origin: {origin}\n" if origin else ""
        request = _REQUEST.format(host=address.netloc, key=key, origin=line)
        self._socket.sendall(request.replace("\n", "\r\n").encode())
        self._file = self._socket.makefile("rb", buffering=1 << 20)
        status = self._file.readline()
        if b" 101 " not in status:
            raise ConnectionError(status.decode())
        while self._file.readline() != b"\r\n":
            pass
        self.channels: dict[str, dict[str, Any]] = {}  # by topic, as the server advertises them
        self._topics: dict[int, str] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._socket.close()

    def learn(self, *topics: str) -> None:
        """Read until all topics have been advertised."""
        while not set(topics) <= self.channels.keys():
            self.receive()

    def subscribe(self, *topics: str) -> None:
        self.learn(*topics)
        wanted = []
        for topic in topics:
            self._topics[len(self._topics)] = topic
            wanted.append({"id": len(self._topics) - 1, "channelId": self.channels[topic]["id"]})
        self._send({"op": "subscribe", "subscriptions": wanted})

    def unsubscribe_all(self) -> None:
        self._send({"op": "unsubscribe", "subscriptionIds": list(self._topics)})

    def receive(self) -> tuple[str, bytes] | None:
        """Topic and content of the next message; None if it is not one of a channel."""
        kind, content = self._frame()
        if kind == 2 and content[0] == 1:
            return self._topics[struct.unpack_from("<I", content, 1)[0]], content[13:]
        if kind == 1 and (message := json.loads(content))["op"] == "advertise":
            self.channels |= {one["topic"]: one for one in message["channels"]}
        return None

    def next_data(self) -> tuple[str, bytes]:
        while (found := self.receive()) is None:
            pass
        return found

    def _send(self, message: dict[str, Any]) -> None:
        content, mask = json.dumps(message).encode(), os.urandom(4)
        size = bytes([0x80 | len(content)]) if len(content) < 126 else b"\xfe" + struct.pack(">H", len(content))
        masked = bytes(byte ^ mask[k % 4] for k, byte in enumerate(content))
        self._socket.sendall(b"\x81" + size + mask + masked)

    def _frame(self) -> tuple[int, bytes]:
        content, kind = b"", 0
        while True:
            first, second = self._exactly(2)
            size = second & 0x7F
            if size >= 126:
                (size,) = struct.unpack(">H" if size == 126 else ">Q", self._exactly(2 if size == 126 else 8))
            content += self._exactly(size)
            kind = first & 0x0F or kind
            if first & 0x80:
                return kind, content

    def _exactly(self, size: int) -> bytes:
        found = self._file.read(size)
        if len(found) != size:
            raise ConnectionError("the server has closed the connection")
        return found
