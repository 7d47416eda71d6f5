# SPDX-License-Identifier: Apache-2.0
"""Open the files of recordings, and unpack what is compressed in them, within limits of memory, disk and work.

A file of a few kilobytes can unpack to gigabytes, and a SQLite file can hold a view, or pages that refer to each other,
of which a query returns rows without end. Everything is bounded by the size of the file.
"""

from __future__ import annotations

import bz2
import os
import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, NoReturn

from foretouch.base.files import open_own, open_regular
from foretouch.dataset.recordings.mcap import Damage, McapReader
from foretouch.errors import FileError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

PACKED: Final = ".zstd"
"""End of the names of files that were compressed as a whole."""

_ZSTD: Final = bytes.fromhex("28b52ffd")  # with which no CDR begins
_BEGINNINGS: Final = {".bag": ("ROS 1 bag", b"#ROSBAG V"), ".db3": ("SQLite file", b"SQLite format 3")}
_RATIO: Final = 100  # of a file that is compressed as a whole; images of depth reach 20
_LEAST: Final = 32_000_000  # bytes that any file may unpack to
_MESSAGE: Final = 200_000_000  # bytes of a message or chunk: an image of 4096x4096 points has as many
_STEPS, _STEPS_A_BYTE = 1_000_000, 20  # of SQLite's machine; a row takes six, and has more bytes
_BETWEEN: Final = 10_000  # such steps between two counts


class McapStorage:
    """An MCAP file behind the interface of the readers of `rosbags`."""

    def __init__(self, path: Path, shown: Path) -> None:
        from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
        from rosbags.rosbag2.metadata import parse_qos

        self.fault: FileError | None = None
        self._shown = shown
        self._file = McapReader(path)
        counts = self._file.count_messages()
        self.connections: list[Connection] = []
        formats = {"ros2msg": MessageDefinitionFormat.MSG, "ros1msg": MessageDefinitionFormat.MSG}
        formats |= dict.fromkeys(("ros2idl", "omgidl"), MessageDefinitionFormat.IDL)
        for number, channel in sorted(self._file.channels.items()):
            schema = self._file.schemas.get(channel.schema_id)
            form = formats.get(schema.encoding if schema else "", MessageDefinitionFormat.NONE)
            text = schema.data.decode("utf-8", "replace") if schema else ""
            qos: list[Any] = []
            with suppress(Exception):  # is advice, and others write texts of their own
                qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
            ext = ConnectionExtRosbag2(channel.message_encoding or "cdr", qos)
            definition = MessageDefinition(form, text)
            kind = schema.name if schema else ""
            self.connections.append(Connection(number, channel.topic, kind, definition, "", counts[number], ext, self))

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Iterate over the messages of some connections with their times [ns], in order; damage then is the `fault`."""
        by_number = {connection.id: connection for connection in connections}
        faults: list[Damage] = []
        for item in self._file.in_time({connection.topic for connection in connections}):
            if isinstance(item, Damage):
                faults.append(item)
            elif item[0].channel in by_number:
                yield by_number[item[0].channel], item[0].log_time_ns, item[1]
        if faults:
            first = faults[0].error(self._shown)
            cure = f"what is intact was read; `foretouch dataset repair {self._shown}` makes a complete file of it"
            cure = cure if any(connection.msgcount for connection in self.connections) else "no message can be read"
            self.fault = FileError(self._shown, f"{first.rule}: {cure}", field=first.field)


def _check_sqlite(file: Path, shown: Path) -> None:
    """Refuse a SQLite file that holds what no recorder writes, or whose pages refer to each other, so that rows never end.

    Args:
        file: The file.
        shown: Its name for messages.

    Raises:
        FileError: If it does, or its messages have more bytes than the file.
        sqlite3.Error: If it is damaged.
    """
    size = file.stat().st_size
    steps = iter(range(0, _STEPS + _STEPS_A_BYTE * size, _BETWEEN))
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
        database.set_progress_handler(lambda: next(steps, None) is None, _BETWEEN)
        entries = database.execute("SELECT type, name, tbl_name, sql FROM sqlite_master").fetchall()
        try:
            _scan(database, entries, size, shown)
        except sqlite3.OperationalError as err:
            if next(steps, None) is None:
                raise FileError(
                    shown, f"has more rows than its {size} bytes can hold: its pages refer to each other"
                ) from err
            raise


def _scan(database: sqlite3.Connection, entries: list[tuple[str, str, str, str]], size: int, shown: Path) -> None:
    """Read all rows of the tables and indexes of a database of some bytes, as `_check_sqlite`."""
    for kind, name, table, made in entries:
        if kind not in {"table", "index"} or str(made).lower().startswith("create virtual"):
            raise FileError(shown, f"is a {kind} that no recorder writes", field=name)
        scan = "NOT INDEXED" if kind == "table" else f"INDEXED BY {_as_name(name)}"
        # Not count(*), which is one step, however many rows there are.
        database.execute(f"SELECT sum(1) FROM {_as_name(table)} {scan}").fetchall()  # noqa: S608  names are quoted
    if any(name == "messages" for _, name, *_ in entries):
        (total,) = database.execute("SELECT sum(length(data)) FROM messages NOT INDEXED").fetchone()
        if (total or 0) > size:
            raise FileError(shown, f"{total} bytes of messages are more than the {size} of the file")


def _as_name(text: str) -> str:
    """Return a name for a query."""
    return '"' + text.replace('"', '""') + '"'


def open_storage(file: Path, stack: ExitStack) -> Any:
    """Return a reader of one file, with `connections` and `messages`; it is closed with the stack.

    Raises:
        FileError: If it is damaged, was not closed, or unpacks to more than its size allows.
    """
    from rosbags.rosbag2 import Reader as Ros2Reader

    opened = file
    if file.suffix == PACKED:
        opened = _unpacked(file, Path(stack.enter_context(TemporaryDirectory())))
    if opened.suffix == ".mcap":
        return McapStorage(opened, file)
    journal = opened.with_name(f"{opened.name}-wal")
    if journal.is_file() and journal.stat().st_size:
        cure = (
            f"was not closed, and holds messages in {journal.name}: `sqlite3 {file} 'PRAGMA wal_checkpoint(TRUNCATE)'`"
        )
        raise FileError(file, cure)
    _require_beginning(opened, file)
    with known_failures(file):
        if opened.suffix == ".bag":
            return _open_ros1(opened, stack)
        _check_sqlite(opened, file)
        return stack.enter_context(Ros2Reader(opened))


def _require_beginning(opened: Path, file: Path) -> None:
    """Refuse what does not begin as a recording of its suffix; `file` is its name for the message."""
    kind, beginning = _BEGINNINGS[opened.suffix]
    with open_regular(opened) as content:
        if content.read(len(beginning)) != beginning:
            raise FileError(file, f"is no {kind}: it does not begin as one")


def _open_ros1(file: Path, stack: ExitStack) -> Any:
    """Return a reader of a ROS 1 bag whose chunks are unpacked within a limit."""
    import lz4.frame
    from rosbags.rosbag1 import Reader

    makers: Mapping[Any, Callable[[], Any]] = {
        bz2.decompress: bz2.BZ2Decompressor,
        lz4.frame.decompress: lz4.frame.LZ4FrameDecompressor,
    }

    def bounded(make: Callable[[], Any]) -> Callable[[bytes], bytes]:
        def unpack(packed: bytes) -> bytes:
            content: bytes = make().decompress(packed, max_length=_MESSAGE + 1)
            return content if len(content) <= _MESSAGE else _refuse(file, "a chunk", len(packed), _MESSAGE)

        return unpack

    reader = stack.enter_context(Reader(file))
    for place, chunk in reader.chunks.items():
        if chunk.decompressor in makers:
            reader.chunks[place] = chunk._replace(decompressor=bounded(makers[chunk.decompressor]))
    return reader


def _unpacked(file: Path, folder: Path) -> Path:
    """Return a file that was compressed as a whole, unpacked into a folder."""
    import zstandard

    unpacked, written = folder / file.stem, 0
    with known_failures(file), open_regular(file) as packed, os.fdopen(open_own(unpacked, os.O_WRONLY), "wb") as out:
        size = os.fstat(packed.fileno()).st_size
        limit = max(_LEAST, _RATIO * size)
        for block in zstandard.ZstdDecompressor().read_to_iter(packed):
            written += len(block)
            if written > limit:
                _refuse(file, "the file", size, limit)
            out.write(block)
    return unpacked


def plain(data: bytes, file: Path) -> bytes:
    """Return a message of a file, which may have been compressed by itself."""
    if not data.startswith(_ZSTD):
        return data
    import zstandard

    content = zstandard.ZstdDecompressor().stream_reader(data).read(_MESSAGE + 1)
    return content if len(content) <= _MESSAGE else _refuse(file, "a message", len(data), _MESSAGE)


def _refuse(file: Path, what: str, size: int, limit: int) -> NoReturn:
    raise FileError(file, f"{what} of {size} bytes unpacks to more than {limit}")


@contextmanager
def known_failures(path: Path, position: str | None = None) -> Iterator[None]:
    """Turn the parsers' exceptions into one line; damaged bytes make them raise exceptions of any library and of Python."""
    try:
        yield
    except FileError:
        raise
    except OSError as err:
        raise FileError(path, err.strerror or str(err), field=position) from err
    except Exception as err:
        cause = " ".join(str(err).split())
        if not type(err).__module__.startswith("rosbags"):
            cause = f"{type(err).__name__}: {cause}" if cause else type(err).__name__
        raise FileError(path, f"truncated or damaged: {cause}", field=position) from err
