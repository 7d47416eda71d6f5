# SPDX-License-Identifier: Apache-2.0
"""Admits the clients of a WebSocket server by their origin, which the server itself does not look at.

Every web page that a browser shows may open a WebSocket to this machine, and names its own address as `Origin`. Programs
that are no browser name none. The server listens on an address of this machine's loopback network that is drawn at random,
so that no page can search for it; here, bytes of the clients that are admitted are passed on in both directions.
"""

import secrets
import socket
import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Final

_HEAD_BYTES: Final = 16_384
_HEAD_S: Final = 5.0  # time in which a client must have sent its request
_BLOCK: Final = 1 << 20


class OriginGate:
    """Listens for clients of a server on a port, 0 for a free one; an `OSError` if the address cannot be listened on.

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
