# SPDX-License-Identifier: Apache-2.0
"""Keys of a terminal, also over SSH, and what they do to a recording.

The terminal is as before at the end, at Ctrl-Z, and after a crash or `kill -9`: a shell that outlives this process sets it.
"""

import codecs
import os
import re
import select
import signal
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import Any, Final, Self

from rich.text import Text

from foretouch.errors import ForetouchError
from foretouch.interrupts import uninterrupted
from foretouch.ros.recorder.operator import Action, Reply

_SEQUENCE: Final = re.compile(r"\x1b(\[[0-9;?]*[ -/]*[@-~]|O.)")  # such as of an arrow key
_ENTER_SCREEN, _LEAVE_SCREEN = b"\x1b[?1049h\x1b[?25l", b"\x1b[?1049l\x1b[?25h"
# It waits for a line or, where this process is killed, for the end of its input.
_GUARD: Final = r"""read -r _ || { stty "$0" <&1; printf '\033[?1049l\033[?25h'; }"""

KEYS: Final[dict[str, tuple[Action, str]]] = {
    "o": ("object", "name of the next object (Enter: the next of the list)"),
    "s": ("success", ""),
    "f": ("failure", ""),
    "d": ("drop", ""),
    "r": ("relabel", "object of the last grasp (Enter: the one on the table)"),
    "n": ("note", "note"),
    "p": ("pause", ""),
    "u": ("undo", ""),
}
"""Action of each key, and what it asks for; `q` quits."""


def has_keyboard() -> bool:
    """Whether keys can be read: a terminal whose program in the foreground is this one."""
    try:
        return sys.stdout.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False


class Keyboard:
    """Keys of the terminal, one by one and not shown, while the context is open."""

    def __init__(self) -> None:
        self._fd = sys.stdin.fileno()
        self._decode = codecs.getincrementaldecoder("utf-8")("ignore").decode
        self._is_on = self._was_suspended = False

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._fd)
        self._handlers: dict[int, Any] = {signal.SIGTTOU: signal.signal(signal.SIGTTOU, signal.SIG_IGN)}
        self._handlers[signal.SIGTSTP] = signal.signal(signal.SIGTSTP, self._suspend)
        saved = subprocess.check_output(["stty", "-g"], stdin=self._fd, text=True).strip()  # noqa: S607
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": self._fd, "start_new_session": True}
        self._guard = subprocess.Popen(["sh", "-c", _GUARD, saved], **pipes)  # noqa: S603, S607
        self._is_on = has_keyboard()
        if self._is_on:
            tty.setcbreak(self._fd, termios.TCSANOW)
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._guard.communicate(b"\n")

    def read(self, timeout_s: float) -> str | None:
        """What was typed, after this time at the latest; None while another program is in the foreground."""
        if not has_keyboard():
            self._is_on = False
            time.sleep(timeout_s)
            return None
        if not self._is_on:
            tty.setcbreak(self._fd, termios.TCSANOW)
            self._is_on = True
            if self._was_suspended:
                os.write(self._fd, _ENTER_SCREEN)
        ready = select.select([self._fd], [], [], timeout_s)[0]
        if not self._is_on:  # it was suspended meanwhile
            return None
        with suppress(OSError):  # it was closed
            return _SEQUENCE.sub("", self._decode(os.read(self._fd, 1024))) if ready else ""
        return None

    def _restore(self) -> None:
        if self._is_on:
            self._is_on = False
            with suppress(termios.error):  # it was closed
                termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    def _suspend(self, _: int, __: FrameType | None) -> None:
        """Give the terminal back at Ctrl-Z; `read` takes it again once this process is in the foreground."""
        self._restore()
        os.write(self._fd, _LEAVE_SCREEN)
        self._was_suspended = True
        os.kill(os.getpid(), signal.SIGSTOP)


class RecordingKeys:
    """What the keys do: single letters act at once, those that need a text open a line to type it in.

    Args:
        act: Does an action with a text.

    Attributes:
        quitted: Whether the session is to end.
    """

    def __init__(self, act: Callable[[Action, str], str]) -> None:
        self.quitted = False
        self._act = act
        self._reply = Reply("", True, 0.0)
        self._typing: tuple[Action, str] | None = None  # the action, and what was typed so far
        self._asked = False  # whether to quit

    def press(self, typed: str) -> None:
        """Act on what was typed, character by character."""
        for character in typed:
            with uninterrupted():
                self._press(character)

    def lines(self, latest: Reply | None) -> list[Text]:
        """The answer to the last key, or to an action that has waited if that is later, and the keys."""
        if self._typing is not None:
            action, text = self._typing
            return [Text(f"{KEYS[action[0]][1]}: {text}▏", "bold"), Text("Enter: done  Esc: cancel", "dim")]
        reply = self._reply if latest is None or latest.at_s < self._reply.at_s else latest
        names = [*(action for action, _ in KEYS.values()), "quit"]
        keys = Text(" ").join(Text.assemble((f"[{name[0]}]", "bold"), name[1:]) for name in names)
        return [Text(reply.text or "no key was pressed yet", "bold green" if reply.done else "bold red"), keys]

    def _press(self, character: str) -> None:
        if self._typing is not None:
            self._type(character, *self._typing)
            return
        asked, self._asked = self._asked, character == "q"
        if character == "q":
            self.quitted = asked
            self._reply = Reply("press q again to end the recording, or any other key", True, time.monotonic())
        elif character in KEYS:
            action, question = KEYS[character]
            if question:
                self._typing = action, ""
            else:
                self._do(action, "")
        elif asked:
            self._reply = Reply("recording goes on", True, time.monotonic())

    def _type(self, character: str, action: Action, text: str) -> None:
        if character in "\r\n":
            self._typing = None
            self._do(action, text.strip())
        elif character == "\x1b":
            self._typing = None
        elif character in "\x7f\b":
            self._typing = action, text[:-1]
        elif character.isprintable():
            self._typing = action, text + character

    def _do(self, action: Action, text: str) -> None:
        try:
            text, done = self._act(action, text), True
        except ForetouchError as err:
            text, done = f"not done: {err}", False
        self._reply = Reply(text, done, time.monotonic())
