# SPDX-License-Identifier: Apache-2.0
"""Keys of a terminal, also over SSH, and what they do to a recording."""

import codecs
import os
import re
import select
import sys
import termios
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Self

from rich.text import Text

from foretouch.base.interrupts import uninterrupted
from foretouch.errors import ForetouchError
from foretouch.ros.sessions.operator import Action, Reply

_SEQUENCE: Final = re.compile(r"\x1b(\[[0-9;?]*[ -/]*[@-~]|O.)")  # such as of an arrow key
_CONTROL_CHARACTERS: Final = 6  # place in the attributes of a terminal

_KEYS: Final[dict[str, tuple[Action, str]]] = {
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
    """Return whether keys can be read: a terminal whose program in the foreground is this one."""
    try:
        return sys.stdout.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False


class Keyboard:
    """Keys of the terminal, one by one and not shown, while the context is open; Ctrl-Z is ignored meanwhile."""

    def __init__(self) -> None:
        self._fd = sys.stdin.fileno()
        self._decode = codecs.getincrementaldecoder("utf-8")("ignore").decode

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd, termios.TCSANOW)
        attributes = termios.tcgetattr(self._fd)
        attributes[_CONTROL_CHARACTERS][termios.VSUSP] = b"\0"
        termios.tcsetattr(self._fd, termios.TCSANOW, attributes)
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(termios.error):  # it was closed
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    def read(self, timeout_s: float) -> str:
        """Return what was typed, after this time at the latest."""
        if not select.select([self._fd], [], [], timeout_s)[0]:
            return ""
        with suppress(OSError):
            if content := os.read(self._fd, 1024):
                return _SEQUENCE.sub("", self._decode(content))
        time.sleep(timeout_s)  # the terminal was closed
        return ""


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
        """Return the answer to the last key, or to an action that has waited if that is later, and the keys."""
        if self._typing is not None:
            action, text = self._typing
            return [Text(f"{_KEYS[action[0]][1]}: {text}▏", "bold"), Text("Enter: done  Esc: cancel", "dim")]
        reply = self._reply if latest is None or latest.at_s < self._reply.at_s else latest
        names = [*(action for action, _ in _KEYS.values()), "quit"]
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
        elif character in _KEYS:
            action, question = _KEYS[character]
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
