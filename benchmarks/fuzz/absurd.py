# SPDX-License-Identifier: Apache-2.0
"""Well-formed but absurd messages: values of the declared types that no sensor, planner or operator sends."""

import array
import re
from typing import Any

import numpy as np

from benchmarks.fuzz.files import mutated

DOUBLES = (
    0.0, -0.0, 1.0, -1.0, float("nan"), float("inf"), float("-inf"), 5e-324, 1e-310, 1e-30, 1e20, 1e38, 1e160, 1.7e308,
    -1.7e308,
)  # fmt: skip
_FLOAT_LIMIT = float(np.finfo(np.float32).max)
STRINGS = ("", "a" * 5000, "\n", "../..", "é\U0001f4a5", "nan", "0", "-1", "{}", "%s%n", "7", "a b", " ", "1" * 400)
_LIST = re.compile(r"^(?:sequence<(?P<item>[^,>]+)(?:, (?P<limit>\d+))?>|(?P<fixed>.+)\[(?P<size>\d+)\])$")
_SHARE_OF_FLOATS = 0.7  # of the changes of a byte array that put a number into it


def change(message: Any, rng: np.random.Generator) -> Any:
    """One to four changes of a message; it is changed and returned."""
    for _ in range(int(rng.integers(1, 5)) if rng.random() < 0.5 else 1):
        _change_once(message, rng)
    return message


def fields_of(message: Any) -> dict[str, str]:
    """Types of the fields of a message by name; those of a plain object follow from its values."""
    if hasattr(message, "get_fields_and_field_types"):
        return dict(message.get_fields_and_field_types())
    return {name: _type_of(value) for name, value in vars(message).items()}


def value_of(kind: str, rng: np.random.Generator) -> Any:
    """An absurd value of a basic type."""
    if kind in ("double", "float64"):
        return pick(DOUBLES, rng) if rng.random() < 0.8 else float(rng.normal())
    if kind in ("float", "float32"):
        value = float(np.float32(np.clip(pick(DOUBLES, rng), -_FLOAT_LIMIT, _FLOAT_LIMIT)))
        return float(rng.normal()) if rng.random() < 0.2 else value
    if kind == "boolean":
        return bool(rng.random() < 0.5)
    if kind == "octet":
        return bytes([int(rng.integers(0, 256))])
    if kind.startswith(("string", "wstring")):
        return pick(STRINGS, rng)
    bits = int(re.sub(r"\D", "", kind) or 64)
    low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    values = (0, 1, 2, low, high, high - 1, high // 2, min(high, int(rng.integers(0, 100))))
    return int(pick(values, rng))


def pick(values: Any, rng: np.random.Generator) -> Any:
    """One of some values."""
    return values[int(rng.integers(0, len(values)))]


def _type_of(value: Any) -> str:
    if isinstance(value, list):
        return f"sequence<{_type_of(value[0]) if value else 'double'}>"
    basic = {bool: "boolean", int: "int64", float: "double", str: "string"}
    return basic.get(type(value), "object/object")


def _change_once(message: Any, rng: np.random.Generator) -> None:
    fields = fields_of(message)
    name = pick(list(fields), rng)
    kind, value = fields[name], getattr(message, name)
    found = _LIST.match(kind)
    if found is None:
        if "/" in kind:
            _change_once(value, rng)
        else:
            setattr(message, name, value_of(kind, rng))
        return
    item = found["item"] or found["fixed"]
    size = found["size"] and int(found["size"])
    if size is not None:
        _change_element(value, item, rng)
        setattr(message, name, value)
    elif isinstance(value, array.array) and value.typecode == "B":
        setattr(message, name, _changed_bytes(value, rng))
    else:
        limit = int(found["limit"]) if found["limit"] else 200
        setattr(message, name, _changed_list(value, item, limit, rng))


def _change_element(values: Any, item: str, rng: np.random.Generator) -> None:
    """Change one element in place, or all of them."""
    if not len(values):
        return
    if "/" in item:
        _change_once(values[int(rng.integers(0, len(values)))], rng)
        return
    every = rng.random() < 0.2
    value = value_of(item, rng)
    for k in range(len(values)) if every else [int(rng.integers(0, len(values)))]:
        values[k] = value


def _changed_list(values: Any, item: str, limit: int, rng: np.random.Generator) -> Any:
    way = int(rng.integers(0, 8))
    if way == 0:
        return values[:0]
    if way == 1:
        return values[: int(rng.integers(0, len(values) + 1))]
    if way == 2:
        return (values * int(rng.integers(2, 40)))[:limit]
    _change_element(values, item, rng)
    return values


def _changed_bytes(data: Any, rng: np.random.Generator) -> Any:
    """Other bytes: an absurd float at a multiple of four, or changes as of a file."""
    content = bytearray(data.tobytes())
    size = len(content)
    if size and rng.random() < _SHARE_OF_FLOATS:
        for _ in range(int(rng.integers(1, 20)) if rng.random() < 0.5 else 1):
            at = int(rng.integers(0, size // 4 + 1)) * 4
            value = np.float32(np.clip(pick(DOUBLES, rng), -_FLOAT_LIMIT, _FLOAT_LIMIT))
            content[at : at + 4] = value.tobytes()[: max(size - at, 0)]
    else:
        content = bytearray(mutated(bytes(content), rng))
    result = array.array("B")
    result.frombytes(bytes(content))
    return result
