# SPDX-License-Identifier: Apache-2.0
"""A program on a terminal of its own, as a shell starts it: keys are typed, the screen is read."""

import codecs
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
import time
from typing import Any, Self

ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Terminal:
    """A process in the foreground of a pseudo-terminal of 24 lines; a context manager."""

    def __init__(self, command: list[str], environment: dict[str, str], width: int = 80) -> None:
        self.master, self.slave = pty.openpty()
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, width, 0, 0))
        self.before = termios.tcgetattr(self.slave)
        self.written = ""
        self._decode = codecs.getincrementaldecoder("utf-8")("replace").decode
        ends: dict[str, Any] = {"stdin": self.slave, "stdout": self.slave, "stderr": self.slave}
        kept = {name: text for name, text in environment.items() if name not in {"COLUMNS", "LINES"}}
        command = ["setsid", "--ctty", *command]
        self.process = subprocess.Popen(command, env={**kept, "TERM": "xterm-256color"}, **ends)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait(10.0)
        os.close(self.slave)
        os.close(self.master)

    def attributes(self) -> list[Any]:
        """How the terminal is set now."""
        return termios.tcgetattr(self.slave)

    def type(self, text: str) -> None:
        """Press keys; what was written before is forgotten."""
        self._read(0.0)
        self.written = ""
        os.write(self.master, text.encode())

    def until(self, wanted: str, timeout_s: float = 45.0) -> float:
        """Read until a text is written, and return how long that took [s]."""
        began = time.monotonic()
        while wanted not in self.text():
            assert time.monotonic() - began < timeout_s, f"{wanted!r} is not in {self.text()[-4000:]}"
            self._read(0.01)
        return time.monotonic() - began

    def text(self) -> str:
        """All that was written since the last keys, without escape sequences."""
        return ESCAPE.sub("", self.written)

    def frame(self) -> list[str]:
        """The lines of the next screen that is complete."""
        self.type("")
        while self.written.count("\x1b[H") < 3:
            self._read(0.05)
        return ESCAPE.sub("", self.written.split("\x1b[H")[-2]).splitlines()

    def end(self, timeout_s: float = 60.0) -> int:
        """Read until the process ends, and return its exit status."""
        end = time.monotonic() + timeout_s
        while self.process.poll() is None and time.monotonic() < end:
            self._read(0.05)
        self._read(0.2)
        return self.process.wait(0.0 if self.process.poll() is None else None)

    def _read(self, timeout_s: float) -> None:
        while select.select([self.master], [], [], timeout_s)[0]:
            self.written += self._decode(os.read(self.master, 65536))
            timeout_s = 0.0
