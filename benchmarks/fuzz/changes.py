# SPDX-License-Identifier: Apache-2.0
"""What is changed: bytes of a file, values of a document or message, and files or folders in the place of others."""

import array
import hashlib
import io
import json
import os
import re
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import yaml
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from safetensors.numpy import load, save

NUMBERS = (
    *(b"0", b"-1", b"1", b"2147483647", b"4294967296", b"1e10", b"nan", b"inf", b"1e400", b"9" * 4400, b"", b"true"),
)
WORDS = (b"null", b"[]", b"{}", b"*a", b"&a", b"!!int x", b"2026-13-45", b"\0", b"\xff", b"[" * 300, b'"\\ud800"')
TEXTS = ("", "../..", "a\x1b[2J\n", "é\U0001f4a5" * 500, "x", "nan", "-1", "{}", "%s%n", "7", "a b", " ", "1" * 400)
DOUBLES = (
    0.0, -0.0, 1.0, -1.0, float("nan"), float("inf"), float("-inf"), 5e-324, 1e-310, 1e-30, 1e20, 1e38, 1e160, 1.7e308,
    -1.7e308,
)  # fmt: skip
VALUES = (
    *(None, True, 0, -1, 2**63, 10**400, 0.5, 1e308, float("inf"), float("nan"), *TEXTS[:5]),
    *([], [[]], ["x"], {}, {"": None}, [0] * 1000),
)
_FLOAT_LIMIT = float(np.finfo(np.float32).max)
_LIST = re.compile(r"^(?:sequence<(?P<item>[^,>]+)(?:, (?P<limit>\d+))?>|(?P<fixed>.+)\[(?P<size>\d+)\])$")
_OTHER_DIGITS = str.maketrans("012345678", "123456789")


def pick(values: Any, rng: np.random.Generator) -> Any:
    """One of some values."""
    return values[int(rng.integers(0, len(values)))]


def _times(rng: np.random.Generator) -> int:
    return int(rng.integers(1, 5)) if rng.random() < 0.5 else 1


# --- bytes -------------------------------------------------------------------------------------------------------


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes of bytes."""
    data = bytearray(content)
    for _ in range(_times(rng)):
        data = _mutated_once(data, rng)
    return bytes(data)


def _mutated_once(data: bytearray, rng: np.random.Generator) -> bytearray:
    size = len(data)
    at = int(rng.integers(0, size + 1))
    if rng.random() < 0.3:
        at = min(at, int(rng.integers(0, 512)))  # headers decide most
    length = int(rng.integers(1, 1 + min(64, max(size, 1))))
    way = int(rng.integers(0, 9))
    if way == 0 and size:  # a flipped bit
        data[min(at, size - 1)] ^= 1 << int(rng.integers(0, 8))
    elif way == 1:  # another byte
        data[at : at + 1] = rng.bytes(1)
    elif way == 2:  # an integer of 1 to 8 bytes
        width = int(rng.choice([1, 2, 4, 8]))
        at -= at % width if rng.random() < 0.7 else 0
        values = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1, int(rng.integers(0, 2**32)))
        data[at : at + width] = (pick(values, rng) % 256**width).to_bytes(width, "little")[: max(size - at, 0)]
    elif way == 3:  # truncated
        del data[at:]
    elif way == 4:  # duplicated
        data[at:at] = data[at : at + length * 16]
    elif way == 5:  # inserted
        data[at:at] = rng.bytes(length)
    elif way == 6:  # removed
        del data[at : at + length]
    else:  # another number or word in a text
        found = list(re.finditer(rb"-?\d+(\.\d+)?" if way == 7 else rb"[A-Za-z_]+", bytes(data[:20_000])))
        if found:
            match = pick(found, rng)
            data[match.start() : match.end()] = pick(NUMBERS if way == 7 else NUMBERS + WORDS, rng)
    return data


# --- files whose format stays intact --------------------------------------------------------------------------------


def retyped(value: Any, rng: np.random.Generator) -> Any:
    """A document with another value in one place."""
    inner = list(value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ())
    if not inner or rng.random() < 0.2:
        return pick(VALUES, rng)
    key, one = pick(inner, rng)
    changed = value.copy()
    changed[key] = retyped(one, rng)
    return changed


def retype(file: Path, rng: np.random.Generator) -> None:
    """Change a type or value inside of a file; its own hashes are computed again."""
    ways: dict[str, Callable[[Path, np.random.Generator], object]] = {
        ".json": lambda path, rng: path.write_text(json.dumps(retyped(json.loads(path.read_text()), rng))),
        ".yaml": lambda path, rng: path.write_text(yaml.safe_dump(retyped(yaml.safe_load(path.read_text()), rng))),
        ".jsonl": _retype_lines,
        ".safetensors": _retype_tensors,
        ".npz": _bomb,
        ".arrow": _retype_arrow,
        ".mcap": _retype_mcap,
        ".ply": _retype_words,
        ".csv": _retype_words,
    }
    reverse = lambda path, _: path.write_bytes(path.read_bytes()[::-1])  # noqa: E731
    ways.get(file.suffix, reverse)(file, rng)


def _retype_lines(file: Path, rng: np.random.Generator) -> None:
    """A line of a chain of hashes."""
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    number = int(rng.integers(len(lines)))
    lines[number], digest, text = retyped(lines[number], rng), "", ""
    for line in lines:
        body = {key: one for key, one in line.items() if key != "sha256"} if isinstance(line, dict) else line
        digest = hashlib.sha256((digest + json.dumps(body, sort_keys=True)).encode()).hexdigest()
        text += json.dumps({**body, "sha256": digest} if isinstance(body, dict) else body) + "\n"
    file.write_text(text)


def _retype_tensors(file: Path, rng: np.random.Generator) -> None:
    tensors = load(file.read_bytes())
    name = pick(list(tensors), rng)
    old = tensors[name]
    changed = (
        old[..., None], old.astype(np.int64), np.full(old.shape, -1), np.float64(np.inf), np.full(old.shape, 2**62),
        old[:0] if old.ndim else np.zeros(0),
    )  # fmt: skip
    tensors[name] = np.asarray(pick(changed, rng))
    tensors.pop("sha256", None)
    seal = np.frombuffer(hashlib.sha256(save(tensors)).digest(), np.uint8)
    file.write_bytes(save({**tensors, "sha256": seal} if file.parent.name == "history" else tensors))


def _bomb(file: Path, rng: np.random.Generator) -> None:
    """Up to 72 MB of zeros."""
    content = io.BytesIO()
    np.save(content, np.zeros((int(3e6 ** rng.random()), 3)))
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xyz.npy", content.getvalue())


def _retype_words(file: Path, rng: np.random.Generator) -> None:
    between = " " if file.suffix == ".ply" else ","
    words = file.read_text().split(between)
    words[int(rng.integers(len(words)))] = str(pick(VALUES, rng))
    file.write_text(between.join(words))


def _retype_arrow(file: Path, rng: np.random.Generator) -> None:
    """Nulls, values or a type in place of others in a column; other columns or rows; a compressed file."""
    table = pa.ipc.open_file(pa.py_buffer(file.read_bytes())).read_all()
    number, value = int(rng.integers(table.num_columns)), pick(VALUES, rng)
    field, rows = table.field(number), table.column(number).to_pylist()
    inner = [value] * len(rows[0]) if isinstance(rows[0], list) else value
    ways: tuple[Callable[[], Any], ...] = (
        lambda: table.set_column(number, field, pa.nulls(len(rows), field.type)),
        lambda: table.set_column(number, field, pa.array([None, *rows[1:]], field.type)),
        lambda: table.set_column(number, field, pa.array([inner, *rows[1:]], field.type)),
        lambda: table.set_column(number, field, pa.array([rows[0][:-1], *rows[1:]], field.type)),
        lambda: table.set_column(number, field.name, pa.array([value] * len(rows))),
        lambda: table.remove_column(number),
        lambda: table.append_column(field, table.column(number)),
        lambda: pa.concat_tables([table.slice(1), table.slice(0, 1)]),
        lambda: pa.concat_tables([table, table]),
        lambda: table.slice(0, 0),
        lambda: table,
    )
    changed = pick(ways, rng)()
    packing = pick((None, "zstd", "lz4"), rng) if changed is table else None
    with pa.ipc.new_file(str(file), changed.schema, options=pa.ipc.IpcWriteOptions(compression=packing)) as writer:
        writer.write_table(changed)


def _retype_mcap(file: Path, rng: np.random.Generator) -> None:
    """Other data, times, names and types in one record, or a message that unpacks to much more."""
    found = StreamReader(io.BytesIO(file.read_bytes())).records
    records: list[Any] = [one for one in found if isinstance(one, Schema | Channel | Message | Metadata)]
    one, text, other = pick(records, rng), pick(TEXTS[:4], rng), rng.random() < 0.5
    if isinstance(one, Message) and other:
        one.log_time = one.publish_time = pick((0, 1, 2**63, 2**64 - 1), rng)
    elif isinstance(one, Message):
        messages = [message for message in records if isinstance(message, Message)]
        one.data = pick((b"", bytes(int(6e7 ** rng.random())), rng.bytes(60), pick(messages, rng).data), rng)
    elif isinstance(one, Metadata) and other:
        name = pick(list(one.metadata), rng)
        with suppress(ValueError):
            one.metadata[name] = json.dumps(retyped(json.loads(one.metadata[name]), rng))
    elif isinstance(one, Channel):
        one.topic, one.metadata = (text, one.metadata) if other else (one.topic, {"offered_qos_profiles": "[["})
    elif isinstance(one, Schema) and other:
        one.data = rng.bytes(20)
    else:
        one.name = text
    _write_mcap(file, records, pick((CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD), rng))


def _write_mcap(file: Path, records: list[Any], packing: CompressionType) -> None:
    writer = Writer(str(file), compression=packing)
    writer.start("ros2")
    schemas, channels = {0: 0}, {}
    for one in records:
        if isinstance(one, Schema) and one.id not in schemas:
            schemas[one.id] = writer.register_schema(one.name, one.encoding, one.data)
        elif isinstance(one, Channel) and one.id not in channels:
            schema, encoding = schemas[one.schema_id], one.message_encoding
            channels[one.id] = writer.register_channel(one.topic, encoding, schema, one.metadata)
        elif isinstance(one, Message):
            writer.add_message(channels[one.channel_id], one.log_time, one.data, one.publish_time, one.sequence)
        elif isinstance(one, Metadata):
            writer.add_metadata(one.name, one.metadata)
    writer.finish()


def replaced(file: Path, other: bytes, victim: Path, rng: np.random.Generator) -> None:
    """Put something else in the place of a file, such as the content of another, or a link to `victim`."""
    content = file.read_bytes()
    file.unlink()
    ways: tuple[Callable[[], object], ...] = (
        lambda: None,
        lambda: file.symlink_to(victim),
        lambda: file.symlink_to("absent"),
        lambda: file.symlink_to(file.name),
        lambda: file.symlink_to("/dev/zero"),
        lambda: os.link(victim, file),
        lambda: os.mkfifo(file),
        file.mkdir,
        lambda: file.write_bytes(b""),
        lambda: file.write_bytes(bytes(len(content))),
        lambda: file.write_bytes(other),
        lambda: (file.write_bytes(content), os.truncate(file, 100_000_000)),
        lambda: (file.write_bytes(content), file.with_name(file.name.translate(_OTHER_DIGITS)).write_bytes(content)),
    )
    pick(ways, rng)()


def replaced_folder(folder: Path, rng: np.random.Generator) -> None:
    """Put something else in the place of a folder."""
    moved = folder.with_name("moved")
    folder.rename(moved)
    ways: tuple[Callable[[], object], ...] = (
        lambda: None,
        lambda: folder.symlink_to(moved.name),
        lambda: folder.symlink_to(folder.name),
        lambda: folder.write_text("x"),
        lambda: os.mkfifo(folder),
        folder.mkdir,
    )
    pick(ways, rng)()


# --- messages: values of the declared types that no sensor, planner or operator sends ------------------------------


def change(message: Any, rng: np.random.Generator) -> Any:
    """One to four absurd values in a message; it is changed and returned."""
    for _ in range(_times(rng)):
        _change_once(message, rng)
    return message


def value_of(kind: str, rng: np.random.Generator) -> Any:
    """An absurd value of a basic type."""
    if kind in ("double", "float64"):
        return pick(DOUBLES, rng) if rng.random() < 0.8 else float(rng.normal())
    if kind in ("float", "float32"):
        return _float32(rng) if rng.random() < 0.8 else float(rng.normal())
    if kind == "boolean":
        return bool(rng.random() < 0.5)
    if kind == "octet":
        return rng.bytes(1)
    if kind.startswith(("string", "wstring")):
        return pick(TEXTS, rng)
    bits = int(re.sub(r"\D", "", kind) or 64)
    low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return pick((0, 1, 2, low, high, high - 1, high // 2, min(high, int(rng.integers(0, 100)))), rng)


def _float32(rng: np.random.Generator) -> float:
    return float(np.float32(np.clip(pick(DOUBLES, rng), -_FLOAT_LIMIT, _FLOAT_LIMIT)))


def _fields(message: Any) -> dict[str, str]:
    """Types of the fields of a message by name; those of a plain object follow from its values."""
    if hasattr(message, "get_fields_and_field_types"):
        return dict(message.get_fields_and_field_types())
    return {name: _type_of(value) for name, value in vars(message).items()}


def _type_of(value: Any) -> str:
    if isinstance(value, list):
        return f"sequence<{_type_of(value[0]) if value else 'double'}>"
    return {bool: "boolean", int: "int64", float: "double", str: "string"}.get(type(value), "object/object")


def _change_once(message: Any, rng: np.random.Generator) -> None:
    name, kind = pick(list(_fields(message).items()), rng)
    value, found = getattr(message, name), _LIST.match(kind)
    if found is None and "/" in kind:
        _change_once(value, rng)
    elif found is None:
        setattr(message, name, value_of(kind, rng))
    elif isinstance(value, array.array) and value.typecode == "B" and not found["size"]:
        setattr(message, name, _changed_bytes(value, rng))
    else:
        way = 8 if found["size"] else int(rng.integers(0, 8))
        if way == 0:
            value = value[:0]
        elif way == 1:
            value = value[: int(rng.integers(0, len(value) + 1))]
        elif way == 2:
            value = (value * int(rng.integers(2, 40)))[: int(found["limit"] or 200)]
        else:
            _change_element(value, found["item"] or found["fixed"], rng)
        setattr(message, name, value)


def _change_element(values: Any, item: str, rng: np.random.Generator) -> None:
    """Change one element in place, or all of them."""
    if not len(values):
        return
    if "/" in item:
        _change_once(pick(values, rng), rng)
        return
    every, value = rng.random() < 0.2, value_of(item, rng)
    for k in range(len(values)) if every else [int(rng.integers(0, len(values)))]:
        values[k] = value


def _changed_bytes(data: Any, rng: np.random.Generator) -> Any:
    """Other bytes: mostly an absurd float at a multiple of four, else changes as of a file."""
    content = bytearray(data.tobytes())
    size = len(content)
    if size and rng.random() < 0.7:
        for _ in range(int(rng.integers(1, 20)) if rng.random() < 0.5 else 1):
            at = int(rng.integers(0, size // 4 + 1)) * 4
            content[at : at + 4] = np.float32(_float32(rng)).tobytes()[: max(size - at, 0)]
    else:
        content = bytearray(mutated(bytes(content), rng))
    return array.array("B", bytes(content))
