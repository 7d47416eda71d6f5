# SPDX-License-Identifier: Apache-2.0
"""What is changed in a valid file or message. Hypothesis draws the changes, and shrinks those that fail."""

import array
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

Draw = Callable[[st.SearchStrategy[Any]], Any]

NUMBERS = (*b"0 -1 1 2147483647 4294967296 1e10 nan inf 1e400 true".split(), b"9" * 4400, b"")
WORDS = (b"null", b"[]", b"{}", b"*a", b"&a", b"!!int x", b"2026-13-45", b"\0", b"\xff", b"[" * 300, b'"\\ud800"')
TEXTS = ("", "../..", "a\x1b[2J\n", "é\U0001f4a5" * 500, "nan", "-1", "%s%n", "1" * 400)
VALUES = (
    *(None, True, 0, -1, 2**63, 10**400, 0.5, 1e308, float("inf"), float("nan"), *TEXTS[:5]),
    *([], [[]], ["x"], {}, {"": None}, [0] * 1000),
)
_LIST = re.compile(r"^(?:sequence<(?P<item>[^,>]+)(?:, (?P<limit>\d+))?>|(?P<fixed>.+)\[(?P<size>\d+)\])$")


def damaged(draw: Draw, content: bytes) -> bytes:
    """One to four changes of bytes: at rest, as a careless editor would, or in the numbers and words of a text."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at, length = draw(st.integers(0, len(data))), draw(st.integers(1, 64))
        way = draw(st.sampled_from(("bit", "bytes", "cut", "copy", "insert", "remove", "number", "word")))
        if way == "bit" and at < len(data):
            data[at] ^= 1 << draw(st.integers(0, 7))
        elif way == "bytes":  # an integer of up to eight bytes, often at its bounds
            new = draw(
                st.sampled_from((bytes(8), b"\xff" * 8, b"\xff\xff\xff\x7f")) | st.binary(min_size=1, max_size=8)
            )
            data[at : at + len(new)] = new[: len(data) - at]
        elif way == "cut":
            del data[at:]
        elif way == "copy":
            data[at:at] = data[at : at + 16 * length]
        elif way == "insert":
            data[at:at] = draw(st.binary(min_size=1, max_size=64))
        elif way == "remove":
            del data[at : at + length]
        elif found := list(re.finditer(rb"-?\d+(\.\d+)?" if way == "number" else rb"[A-Za-z_]+", bytes(data[:20_000]))):
            match = draw(st.sampled_from(found))
            data[match.start() : match.end()] = draw(st.sampled_from(NUMBERS if way == "number" else NUMBERS + WORDS))
    return bytes(data)


def retyped(draw: Draw, value: Any) -> Any:
    """A document with another value in one place."""
    inner = list(value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ())
    if not inner or draw(st.integers(0, 4)) == 0:
        return draw(st.sampled_from(VALUES))
    key, one = draw(st.sampled_from(inner))
    changed = value.copy()
    changed[key] = retyped(draw, one)
    return changed


def replaced(draw: Draw, path: Path, other: bytes, victim: Path) -> None:
    """Something else in the place of a file or folder, such as another file's content, or a link to `victim`."""
    moved = path.with_name("moved")
    path.rename(moved)
    ways: dict[str, Callable[[], object]] = {
        "nothing": lambda: None,
        "a link to another file": lambda: path.symlink_to(victim),
        "a link to nothing": lambda: path.symlink_to("absent"),
        "a link to what was there": lambda: path.symlink_to(moved.name),
        "a link to itself": lambda: path.symlink_to(path.name),
        "a device": lambda: path.symlink_to("/dev/zero"),
        "a second name": lambda: os.link(victim, path),
        "a FIFO": lambda: os.mkfifo(path),
        "a folder": path.mkdir,
        "another file": lambda: path.write_bytes(other),
        "zeros": lambda: path.write_bytes(bytes(len(other))),
        "a sparse file": lambda: (path.write_bytes(other), os.truncate(path, 100_000_000)),
    }
    ways[draw(st.sampled_from(sorted(ways)))]()


def absurd(draw: Draw, message: Any) -> Any:
    """One to four values in a message that no sensor, planner or operator sends; it is changed and returned."""
    for _ in range(draw(st.integers(1, 4))):
        _change(draw, message)
    return message


def values_of(kind: str) -> st.SearchStrategy[Any]:
    """Values of a basic type of messages: its bounds, NaN, infinities and the least numbers among them."""
    if kind in ("double", "float64", "float", "float32"):
        return st.floats(width=64 if kind in ("double", "float64") else 32)
    if kind == "boolean":
        return st.booleans()
    if kind == "octet":
        return st.binary(min_size=1, max_size=1)
    if kind.startswith(("string", "wstring")):
        return st.sampled_from(TEXTS) | st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))
    bits = int(re.sub(r"\D", "", kind) or 64)
    low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return st.sampled_from((low, high)) | st.integers(low, high)


def _change(draw: Draw, message: Any) -> None:
    name, kind = draw(st.sampled_from(list(message.get_fields_and_field_types().items())))
    value, found = getattr(message, name), _LIST.match(kind)
    if found is None and "/" in kind:
        _change(draw, value)
    elif found is None:
        setattr(message, name, draw(values_of(kind)))
    elif isinstance(value, array.array) and value.typecode == "B" and not found["size"]:
        setattr(message, name, array.array("B", _other_floats(draw, value.tobytes())))
    else:
        way = "element" if found["size"] else draw(st.sampled_from(("element", "all", "fewer", "more")))
        if way == "fewer":
            value = value[: draw(st.integers(0, len(value)))]
        elif way == "more":
            value = (value * draw(st.integers(2, 40)))[: int(found["limit"] or 200)]
        elif len(value):
            _change_elements(draw, value, found["item"] or found["fixed"], every=way == "all")
        setattr(message, name, value)


def _change_elements(draw: Draw, values: Any, item: str, *, every: bool) -> None:
    at = draw(st.integers(0, len(values) - 1))
    if "/" in item:
        _change(draw, values[at])
        return
    new = draw(values_of(item))
    for k in range(len(values)) if every else [at]:
        values[k] = new


def _other_floats(draw: Draw, data: bytes) -> bytes:
    """The bytes of a cloud: mostly other floats at multiples of four, else damaged."""
    if not data or draw(st.integers(0, 3)) == 0:
        return damaged(draw, data)
    content = bytearray(data)
    for _ in range(draw(st.integers(1, 20))):
        at = 4 * draw(st.integers(0, (len(content) - 1) // 4))
        content[at : at + 4] = np.float32(draw(st.floats(width=32))).tobytes()[: len(content) - at]
    return bytes(content)
