# SPDX-License-Identifier: Apache-2.0
"""Field paths: where a number, or a series of numbers, stands in a message.

header.stamp                    a field of a field
tactiles[4].electrodes          an element of a list, counted from 0, from its end if negative
sensors[sensor_pos=1]           the first element in which a field has this value
taxels[].x                      a field of every element: a series
values[1:25], values[0::3]      a part of a list, as Python slices it: a series
"""

import re
from typing import Any, Final, TypeAlias

from foretouch.errors import ConfigError, TactileError, none_of, quoted, shown

_NAME: Final = r"[A-Za-z]\w*"
_STEP: Final = re.compile(rf"\.({_NAME})|\[(-?\d+)\]|\[(|\d*:\d*(?::[1-9]\d*)?)\]|\[({_NAME})=([^\[\]]+)\]", re.ASCII)

_Step: TypeAlias = str | int | slice | tuple[str, str]


class FieldPath:
    """A field path, which `get` follows in messages of rclpy and of rosbags alike.

    Args:
        text: The path; the empty one leads to the message itself.
        setting: Name of the setting that holds it, for the message.

    Raises:
        ConfigError: If it is none.
    """

    def __init__(self, text: str, setting: str = "field") -> None:
        self.text = text
        rest = f".{text}" if text and text[0] != "[" else text
        steps = list(_STEP.finditer(rest))
        if "".join(step[0] for step in steps) != rest:
            raise ConfigError(f"{setting}: {quoted(text)} is not a field path such as header.stamp or taxels[].x")
        self.steps = [_step(step) for step in steps]  # of a field, an element, a part, and a name with its value

    def get(self, message: Any) -> Any:
        """Return what stands there, a list for a series; a `TactileError` names what the message lacks."""
        return self._follow(message, 0)

    def _follow(self, value: Any, first: int) -> Any:
        for number, step in enumerate(self.steps[first:], first + 1):
            if isinstance(step, slice):
                items = self._listed(value)[step]
                return items if number == len(self.steps) else [self._follow(item, number) for item in items]
            value = self._take(value, step)
        return value

    def _take(self, value: Any, step: str | int | tuple[str, str]) -> Any:
        if isinstance(step, str):
            if hasattr(value, step):
                return getattr(value, step)
            fields = [field for field in dir(value) if field[0].islower() and not callable(getattr(value, field))]
            raise self._error(f"{type(value).__name__}: field {none_of(step, fields)}")
        items = self._listed(value)
        if isinstance(step, int):
            if not -len(items) <= step < len(items):
                raise self._error(f"there is no element {step} among {len(items)}")
            return items[step]
        name, wanted = step
        known = [str(self._take(item, name)) for item in items]
        if wanted not in known:
            raise self._error(f"no element has {name}={wanted}; known: {', '.join(known) or 'none'}")
        return items[known.index(wanted)]

    def _listed(self, value: Any) -> Any:
        if isinstance(value, str) or not hasattr(value, "__getitem__"):
            raise self._error(f"{type(value).__name__} is not a list")
        return value

    def _error(self, rule: str) -> TactileError:
        return TactileError(f"{shown(self.text)}: {rule}")


def _step(match: re.Match[str]) -> _Step:
    name, index, part, key, wanted = match.groups()
    if part is not None:  # `[]` or `[A:B]`
        return slice(*(int(word) if word else None for word in (part or ":").split(":")))
    return name or (int(index) if index else (key, wanted))
