# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C, SIGTERM and the end of a terminal as `KeyboardInterrupt`, but not in the middle of an import or a clean-up.

An exception from within an import leaves modules half made, and libraries written in C turn it into other errors or lose
it. The same holds for nodes and files that are half made or half closed. There the signal waits.
"""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_AGAIN_S: Final = 0.02  # until a signal that waits is tried once more

_held = 0  # blocks of `uninterrupted` that are open
_waiting: list[int] = []  # signals that came meanwhile


def raise_interrupts() -> None:
    """Let the signals raise `KeyboardInterrupt(number)` in the main thread; those that the parent ignores stay ignored."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _on_signal)
    signal.signal(signal.SIGALRM, _on_timer)


def end_at_once() -> None:
    """Let the signals end the process: there is nothing left to clean up."""
    if signal.getsignal(signal.SIGALRM) is _on_timer:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


def signal_number(err: KeyboardInterrupt) -> int:
    """Return the number of the signal behind the exception; 128 more is the exit status that shells give it."""
    return int(err.args[0]) if err.args else int(signal.SIGINT)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let a signal that comes within the block take effect after it; for the main thread."""
    global _held  # noqa: PLW0603  a process has one main thread
    _held += 1
    try:
        yield
    finally:
        _held -= 1
    if _waiting and not _held:
        _raise_first()


def _raise_first() -> None:
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    number = _waiting[0]
    _waiting.clear()
    raise KeyboardInterrupt(number)


def _on_signal(number: int, frame: FrameType | None) -> None:
    if not (_held or _imports(frame)):
        raise KeyboardInterrupt(number)
    _waiting.append(number)
    if len(_waiting) >= 3:  # the third signal while one waits ends the process at once
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)


def _on_timer(_: int, frame: FrameType | None) -> None:
    if _held or _imports(frame):
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
    elif _waiting:
        _raise_first()


def _imports(frame: FrameType | None) -> bool:
    """Return whether a frame is part of an import."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
