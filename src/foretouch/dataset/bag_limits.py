# SPDX-License-Identifier: Apache-2.0
"""What rosbags is kept from doing with the files of a recording: waiting, running queries of theirs, unpacking without end.

rosbags opens whatever a recording names, and decompresses it before it looks at the size.
"""

import bz2
import importlib
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

from foretouch.checked_files import open_regular, require_schema
from foretouch.config import load_yaml
from foretouch.errors import ConfigError, FileError, shown

_METADATA_BYTES: Final = 2_000_000  # of metadata.yaml; that of a robot with 250 topics has 163 kB
_UNPACKED: Final = 256_000_000  # bytes of one chunk or message; clouds of 1280 x 720 points have 30 MB
_SORTED: Final = 70_000_000  # bytes of one message of a database; clouds of 1920 x 1080 points have 66 MB
_LENGTH_LIMIT: Final = 0  # SQLITE_LIMIT_LENGTH
_FILE_RATIO: Final = 200  # of a whole file that is compressed
_AT_ONCE: Final = 2 * _UNPACKED  # bytes of the chunks of one time
_TABLES: Final = ("messages", "topics", "schema", "metadata", "message_definitions")


def check_files(path: Path, files: list[Path]) -> None:
    """Check the files of a recording before rosbags opens them: those of its `metadata.yaml`, or else `files`.

    A `FileError` names what is no regular file, or no database of plain tables, and metadata that cannot be used.
    """
    if (path / "metadata.yaml").is_file():
        try:
            content = load_yaml(path / "metadata.yaml", _METADATA_BYTES)
        except ConfigError as err:
            raise FileError(path, str(err)) from err
        schema = {"rosbag2_bagfile_information": {"relative_file_paths": [str]}}
        facts = require_schema(path / "metadata.yaml", content, schema)["rosbag2_bagfile_information"]
        files = [path / Path(name).name for name in facts["relative_file_paths"]]
    for file in files:
        open_regular(file).close()
        if file.suffix == ".db3":
            _check_database(path, file)


def _check_database(path: Path, file: Path) -> None:
    """Refuse views, virtual tables and computed columns, which run what the file says, for as long as it says."""
    if set("?#%") & set(str(file)):
        raise FileError(path, "a database needs a path without ?, # and %; rename it")
    try:
        with closing(sqlite3.connect(f"file:{file}?mode=ro&immutable=1", uri=True)) as database:
            database.execute("PRAGMA trusted_schema = OFF")
            query = "SELECT name, type, rootpage FROM sqlite_master WHERE type IN ('table', 'view')"
            for name, kind, page in database.execute(query).fetchall():
                if str(name).lower() not in _TABLES:
                    continue
                columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,)).fetchall()
                if kind != "table" or not page or any(hidden for (hidden,) in columns):
                    rule = f"{shown(name)} is a view or computed, not a plain table"
                    raise FileError(path, rule, field=file.name)
    except (sqlite3.Error, UnicodeDecodeError) as err:
        raise FileError(path, f"truncated or damaged: {err}", field=file.name) from err


def limit_decompression() -> None:
    """Let rosbags unpack no more than a chunk says, and a chunk say no more than a limit; changes rosbags once."""
    bag1, bag2, mcap, lz4 = (
        importlib.import_module(name)
        for name in ("rosbags.rosbag1.reader", "rosbags.rosbag2.reader", "rosbags.rosbag2.storage_mcap", "lz4.frame")
    )
    zstd: Any = bag2.zstd
    if isinstance(zstd, SimpleNamespace):
        return
    unpack_zstd, unpack_lz4 = _limited(zstd.ZstdDecompressor), _limited(lz4.LZ4FrameDecompressor)
    mcap.DECOMPRESSORS.update(lz4=unpack_lz4, zstd=unpack_zstd)
    bag1.decompressors.update(lz4=unpack_lz4, bz2=_limited(bz2.BZ2Decompressor))

    @contextmanager
    def opened(file: Any, mode: str) -> Iterator[Any]:
        left = max(_UNPACKED, _FILE_RATIO * Path(file.name).stat().st_size)

        def read(size: int) -> bytes:
            nonlocal left
            content: bytes = source.read(size)
            if (left := left - len(content)) < 0:
                raise ValueError(f"unpacks to more than {_FILE_RATIO} times its size")
            return content

        with zstd.open(file, mode) as source:
            yield SimpleNamespace(read=read)

    bag2.zstd = SimpleNamespace(decompress=unpack_zstd, open=opened)  # type: ignore[attr-defined]


def _limited(make: Callable[[], Any]) -> Callable[..., bytes]:
    """A function that unpacks the frames in some data to at most the given number of bytes."""

    def unpack(data: bytes, most: int = _UNPACKED) -> bytes:
        if most > _UNPACKED:
            raise ValueError(f"a chunk of {most} bytes, more than {_UNPACKED}")
        parts: list[bytes] = []
        while data:
            frame = make()
            parts.append(frame.decompress(data, most + 1 - sum(map(len, parts))))
            if sum(map(len, parts)) > most:
                raise ValueError(f"unpacks to more than {most} bytes")
            if not frame.eof:
                raise ValueError("compressed data that are cut off")
            data = frame.unused_data or b""
        return b"".join(parts)

    return unpack


def check_chunks(path: Path, reader: Any) -> None:
    """Refuse chunks of one time that unpack to more than a limit: messages are read in order of time, so all at once.

    From a database, which holds messages many times while it sorts, larger messages than a limit are not read.
    """
    found = [getattr(one, "storage", None) for one in reader.readers]
    storages = [storage for one in found for storage in getattr(one, "storages", [one])]
    for database in filter(None, (getattr(storage, "dbconn", None) for storage in storages)):
        database.limit(_LENGTH_LIMIT, _SORTED)
    edges = []
    for chunk in (chunk for storage in storages for chunk in getattr(storage, "chunks", [])):
        start, end = sorted((chunk.message_start_time, chunk.message_end_time))
        edges += [(start, chunk.uncompressed_size), (end, -chunk.uncompressed_size)]
    held = 0
    for _, size in sorted(edges, key=lambda edge: (edge[0], -edge[1])):
        held += size
        if held > _AT_ONCE:
            raise FileError(path, f"holds chunks of one time that unpack to more than {_AT_ONCE} bytes")
