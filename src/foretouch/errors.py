# SPDX-License-Identifier: Apache-2.0
"""The exceptions of foretouch; `ForetouchError` is their base class.

A message is one line with the file or message, the field and the rule that it breaks, so that
the command line can print it unchanged.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

_SHOWN: Final = 200  # characters of a name or value in a message
_PATH: Final = 400  # characters of a path in a message
_RULE: Final = 800  # characters of a rule, which may list what is known
_REPR: Final = 70  # characters of a message where it is printed as a value
_LINE: Final = 2000  # characters of a message

_P = ParamSpec("_P")
_R = TypeVar("_R")


def shown(value: Any, limit: int = _SHOWN) -> str:
    """Return a value for a message: one line without control characters, shortened in the middle.

    Args:
        value: A text or path is printed as it is, other values as `repr` does.
        limit: Characters that are printed.
    """
    try:
        text = str(value) if isinstance(value, str | Path) else repr(value)
    except (ValueError, RecursionError) as err:  # a whole number of more than 4300 digits
        text = f"a {type(value).__name__} that cannot be printed: {err}"
    if len(text) > limit:
        text = f"{text[: limit // 2]}…{text[-limit // 2 :]}"
    return escaped(text)


def escaped(text: str, keep: str = "") -> str:
    """Return a text whose characters that are not printable, but for some to keep, are written as Python escapes them."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text)


def quoted(value: Any) -> str:
    """Return a value for a message as Python writes it, with quotes around texts; shortened like `shown`."""
    return repr(value) if isinstance(value, str) and len(value) < _SHOWN else shown(value)


def nearest(name: Any, known: Iterable[Any], cutoff: float = 0.5) -> str:
    """`; did you mean …?` with the known name that is most like an unknown one; "" if none is like it by the cutoff of `difflib`."""
    names = list(map(str, known))
    similar = [candidate for candidate in names if candidate.endswith(f".{name}")] or difflib.get_close_matches(
        str(name), names, 1, cutoff=cutoff
    )
    return f"; did you mean {similar[0]}?" if similar else ""


def none_of(name: Any, known: Iterable[Any]) -> str:
    """Return the rule that a name is one of some known ones, for a message, with the nearest of them."""
    known = list(known)
    return f"{quoted(name)} is not one of {', '.join(map(str, known))}{nearest(name, known)}"


def described(err: BaseException) -> str:
    """Return the type and text of an exception in one line."""
    return f"{type(err).__name__}: {' '.join(str(err).split())}"


def raised_at(err: BaseException) -> str:
    """Return where an exception was raised, such as " (mine.py:7)"; "" if it was not."""
    last = err.__traceback__
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    return "" if last is None else f" ({Path(last.tb_frame.f_code.co_filename).name}:{last.tb_lineno})"


class ForetouchError(Exception):
    """A known failure, described in one line.

    Args:
        message: The line. Names in it may come from files or messages, so it is shortened and escaped as `shown` does.
    """

    def __init__(self, message: str = "") -> None:
        text = str(message)
        super().__init__(text if len(text) <= _LINE and text.isprintable() else shown(text, _LINE))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({shown(str(self), _REPR)!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Let an error with any arguments be copied and leave a worker process, with its attributes."""
        return _without_init, (type(self), self.args), vars(self)


def require_type(value: Any, kind: Any, field: str, rule: str, fault: type[ForetouchError]) -> None:
    """Refuse an argument of another type: `field: value or its type is rule`."""
    if not isinstance(value, kind):
        name = shown(value, 60) if isinstance(value, str | int | float | None) else type(value).__name__
        raise fault(f"{field}: {name} is {rule}")


def _without_init(kind: type[ForetouchError], args: tuple[Any, ...]) -> ForetouchError:
    """Make an error of what it was made of, without its `__init__`, which takes other arguments."""
    return kind.__new__(kind, *args)


class CallError(ForetouchError, TypeError):
    """A call with an argument too many, too few or of an unknown name."""


class UnknownAttributeError(ForetouchError, AttributeError):
    """An attribute that an object does not have."""


class NoSuchRowError(ForetouchError, IndexError):
    """A row of columns, or an element, that is not there."""


def checked(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Let a function refuse a call with other arguments than its own by a `CallError`, which shows how it is called."""

    @wraps(function)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        try:
            return function(*args, **kwargs)
        except TypeError:
            _check_call(function, args, kwargs)
            raise

    return call


def _check_call(function: Callable[..., Any], args: Sequence[Any], given: Mapping[str, Any]) -> None:
    """Refuse arguments that a function does not take."""
    import inspect  # takes as long to import as all of foretouch

    signature, name = inspect.signature(function), function.__qualname__.removesuffix(".__init__")
    try:
        signature.bind(*args, **given)
    except TypeError as err:
        own = [info for info in signature.parameters.values() if info.name not in ("self", "cls")]
        known = [str(info.replace(annotation=info.empty, default=info.empty)) for info in own]
        known = [text if info.default is info.empty else f"{text}=…" for text, info in zip(known, own, strict=True)]
        names = [info.name for info in own]
        similar = "".join(nearest(key, names) for key in given if key not in names)
        raise CallError(f"{name}: {err}{similar}; the call is {name}({', '.join(known)})") from None


class ConfigError(ForetouchError):
    """A setting that is unknown, of the wrong type or out of its bounds."""


class CloudError(ForetouchError):
    """A cloud whose shape, layout or values cannot be used."""


class LimitError(CloudError):
    """An object or a table where the camera cannot see it, or of a size that a hand cannot hold."""


class FrameError(LimitError):
    """An object in another frame than the optical one of its camera."""


class CalibrationError(CloudError):
    """A depth image whose camera is not known.

    Args:
        message: One line.
        reason: A short word under which such images are counted.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class ContactError(ForetouchError):
    """A contact that cannot be solved: no surface, a fully compressed layer, no convergence."""


class ConvergenceError(ContactError):
    """A contact whose solver did not converge."""


class GraspError(ForetouchError):
    """A grasp that cannot be used: not finite, or of zero width."""


class TactileError(ForetouchError):
    """A tactile reading that a working BioTac SP cannot produce."""


class ModelError(ForetouchError):
    """A model that is damaged, or of another architecture or modality."""


class CameraError(ForetouchError):
    """A camera that is absent, unplugged or stalled."""


class DatasetError(ForetouchError):
    """A dataset or recording that cannot be read or written."""


class VersionError(DatasetError):
    """An intact file of a format version that this version of foretouch does not read."""


class SimulationError(ForetouchError):
    """A scene or a sample that cannot be simulated.

    Args:
        message: One line.
        reason: A short word under which such failures are counted.
    """

    def __init__(self, message: str, reason: str = "simulation") -> None:
        super().__init__(message)
        self.reason = reason


class MissingDependencyError(ForetouchError):
    """A package or library that is not installed; the message contains the command that installs it."""


class FileError(ForetouchError):
    """A file that breaks a rule.

    Args:
        path: The file.
        rule: The rule that it breaks.
        field: The part of the file that breaks it, or None for the whole file.
    """

    def __init__(self, path: str | Path, rule: str, *, field: str | None = None) -> None:
        self.path = Path(path) if isinstance(path, str | os.PathLike) else Path(shown(path))
        self.rule = rule
        self.field = field
        parts = [shown(path, _PATH), *([shown(field)] if field else []), shown(rule, _RULE)]
        super().__init__(": ".join(parts))
