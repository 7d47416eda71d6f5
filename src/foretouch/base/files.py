# SPDX-License-Identifier: Apache-2.0
"""Reads of files that nobody vouches for, and writes beside them.

What is read is a regular file of a bounded size, and JSON of a bounded depth: a FIFO would block its reader for ever, a
device has no end, and a text of a few kilobytes can nest deeper than any parser returns from. What is written under a
name that the package chose, in a folder that may come from elsewhere, goes through no link. Every reader and writer of
the package opens files here.
"""

import fcntl
import hashlib
import json
import math
import os
import re
import secrets
import stat
import weakref
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BufferedReader, FileIO
from itertools import count
from pathlib import Path
from typing import Any, Final

from foretouch.errors import FileError, quoted, shown

TEXT_LIMIT: Final = 64_000_000
"""Largest size of a JSON file [bytes]: the manifest of the largest store has a thousandth of it."""

LOCK: Final = ".lock"
"""Name of the file by which a folder is locked."""

PART: Final = ".part"
"""At the end of the names of what is being written."""

PICTURE_SUFFIXES: Final = (".png", ".pdf", ".svg", ".jpg")

_DEPTH: Final = 64  # levels of lists and objects; no file of the package has more than 8
_DIGITS: Final = 40  # of a whole number with its sign; states of random generators have 128 bits
_KINDS: Final = ((stat.S_ISDIR, "folder"), (stat.S_ISFIFO, "FIFO"), (stat.S_ISSOCK, "socket"))
_AHEAD: Final = 16_384  # bytes that are read at once where less is asked for
_BLOCK: Final = 1 << 20
_LONGEST: Final = 200  # characters of a name that are left in a temporary one
_ONE_WRITER: Final = (
    "one writer at a time; write parts to datasets of their own, and join them with `foretouch dataset build`"
)


@dataclass(frozen=True)
class Number:
    """A schema of a number with bounds, which are inclusive."""

    kind: type  # int or float
    low: float = -1e12
    high: float = 1e12
    optional: bool = False  # whether null fits too


COUNT: Final = Number(int, 0, 2**63 - 1)
"""The schema of counts and of stamps [ns]."""


@contextmanager
def system_errors(path: str | Path, rule: str = "") -> Iterator[None]:
    """Turn an `OSError` within the block into a `FileError` with its description, after `rule` if there is one."""
    try:
        yield
    except OSError as err:
        cause = os.strerror(err.errno) if err.errno else str(err)
        raise FileError(path, f"{rule}: {cause}" if rule else cause) from err


@contextmanager
def _named(path: str | Path) -> Iterator[None]:
    """Do what `system_errors` does, also where no file can have this name."""
    try:
        with system_errors(path):
            yield
    except (ValueError, TypeError) as err:
        raise FileError(path, f"is not a valid file name: {err}") from err


def open_regular(path: str | Path) -> BufferedReader:
    """Open a regular file for reading.

    Raises:
        FileError: If it is absent, may not be read, is a folder, FIFO, socket or device, or no file can have its name;
            also while it is read, if its disk fails.
    """
    return BufferedReader(_NamedFile(path), _AHEAD)


class _NamedFile(FileIO):
    """A regular file that names itself if its disk fails while it is read."""

    def __init__(self, path: str | Path) -> None:
        self._path = path
        super().__init__(_descriptor(path, os.O_RDONLY))

    def readinto(self, buffer: Any) -> int | None:
        with system_errors(self._path):
            return super().readinto(buffer)

    def readall(self) -> bytes:
        with system_errors(self._path):
            return super().readall()


def open_own(path: Path, flags: int) -> int:
    """Open a file that the package keeps beside others, such as a lock or a log, and create it if it is absent.

    Args:
        path: The file; its name is the package's choice, its folder may be anyone's.
        flags: Of `os.open`, besides `O_CREAT`.

    Returns:
        The descriptor.

    Raises:
        FileError: If it is a link, has a second name, is not a regular file, or cannot be opened.
    """
    if path.is_symlink():
        raise FileError(path, "is a link, and nothing is written through links")
    descriptor = _descriptor(path, flags | os.O_CREAT | os.O_NOFOLLOW)
    if os.fstat(descriptor).st_nlink > 1:
        os.close(descriptor)
        raise FileError(path, "has another name too (a hard link), and what is written would change that file")
    return descriptor


def _descriptor(path: str | Path, flags: int) -> int:
    """Return a descriptor of a regular file, without waiting for the other end of a FIFO."""
    with _named(path):
        descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        raise FileError(path, f"is a {_kind(mode)}, not a regular file")
    return descriptor


def _kind(mode: int) -> str:
    """Return what a file is that is no regular one."""
    return next((name for test, name in _KINDS if test(mode)), "device")


class FileBytes:
    """The bytes of a regular file, read when they are sliced, of which short slices share a read.

    Threads and forked processes read at the same time, since no read depends on a position of the file. A pickled one opens
    the file again, wherever the process is. A file that is truncated after it was opened raises a `FileError`; a mapping of it
    would end the process.

    Args:
        path: The file; its size is the one that it has now.

    Raises:
        FileError: As `open_regular`; later, if bytes are not there any more or cannot be read, or if a pickled one finds other
            bytes at the beginning of the file, or fewer.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._place = Path(path).absolute()
        self._size = self._open(self.path)

    def _open(self, path: Path) -> int:
        """Open the file and return its size."""
        file = open_regular(path)
        weakref.finalize(self, file.close)
        self._descriptor = file.fileno()
        self._ahead: tuple[int, bytes] = 0, b""  # offset and content of a read; replaced as a whole: threads share it
        return os.fstat(self._descriptor).st_size

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "_place": self._place, "_size": self._size, "head": self[: min(_AHEAD, self._size)]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        head = state.pop("head")
        vars(self).update(state)
        if self._open(self._place) < self._size or self[: len(head)] != head:
            raise FileError(self.path, "was changed after it was opened: open it again")

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        start, end, _ = part.indices(self._size)
        at, content = self._ahead
        if at <= start and end <= at + len(content):
            return content[start - at : end - at]
        content = self._read(start, max(end - start, _AHEAD))
        if len(content) < end - start:
            raise FileError(self.path, "was truncated while it was read", field=f"byte {start + len(content)}")
        if end - start >= _AHEAD:
            return content
        self._ahead = start, content
        return content[: end - start]

    def _read(self, start: int, size: int) -> bytes:
        """Return bytes from an offset on, fewer at the end of the file."""
        parts = []
        try:
            while size > 0 and (part := os.pread(self._descriptor, size, start)):  # of some GB less than was asked for
                parts.append(part)
                start, size = start + len(part), size - len(part)
        except OSError as err:  # as `system_errors`, which takes longer than a short read
            raise FileError(self.path, err.strerror or str(err)) from err
        return b"".join(parts)

    def blocks(self, start: int, end: int, overlap: int = 0) -> Iterator[tuple[int, bytes]]:
        """Iterate over the bytes between two offsets by blocks with their offsets; each reaches `overlap` bytes into the next."""
        for at in range(start, end, _BLOCK):
            yield at, self[at : min(at + _BLOCK + overlap, end)]

    def crc32(self, start: int, end: int) -> int:
        """Return the CRC-32 of the bytes between two offsets."""
        crc = 0
        for _, block in self.blocks(start, end):
            crc = zlib.crc32(block, crc)
        return crc

    def find_all(self, pattern: re.Pattern[bytes], overlap: int, start: int, end: int) -> Iterator[int]:
        """Iterate over the offsets between two others at which a pattern of at most `overlap` bytes matches."""
        for at, block in self.blocks(start, end, overlap):
            yield from (at + match.start() for match in pattern.finditer(block) if match.start() < _BLOCK)


def require_replaceable(path: str | Path) -> None:
    """Refuse a file to write where something else than a regular file is, such as a device; a link counts as what it leads to."""
    with _named(path), suppress(FileNotFoundError, NotADirectoryError):
        if not stat.S_ISREG(mode := Path(path).stat().st_mode):
            raise FileError(path, f"cannot be written: is a {_kind(mode)}, not a regular file")


def replace_files(contents: Mapping[Path, bytes]) -> None:
    """Write files that belong together, such as weights and the card with their hash.

    All are written under temporary names of their own before the first is renamed, so that a full disk leaves all of the old
    files. Of several processes that write the same files at once, all files are the last one's. Only a crash between two renames
    leaves a new file beside an old one, which the hash in the card reveals.

    Args:
        contents: By file, in the order in which they are renamed; missing folders are made.

    Raises:
        FileError: Names the file that cannot be written, such as on a full disk.
    """
    parts: list[Path] = []
    path = Path()
    try:
        for path, content in contents.items():
            require_replaceable(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            part = part_of(path)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            with os.fdopen(os.open(part, flags, 0o666), "wb") as file:
                parts.append(part)
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
        with _together(path.parent, len(contents)):
            for path, part in zip(contents, parts, strict=True):
                part.replace(path)
    except OSError as err:
        raise FileError(path, f"cannot be written, the one before is kept: {err.strerror or err}") from err
    finally:
        for part in parts:
            with suppress(OSError):  # the error to report is the first one
                part.unlink(missing_ok=True)


def part_of(path: Path) -> Path:
    """Return a name beside a file that no other writer uses, under which it is written."""
    return path.with_name(f"{path.name[:_LONGEST]}.{secrets.token_hex(6)}{PART}")


@contextmanager
def _together(folder: Path, count: int) -> Iterator[None]:
    """Let no other process rename several files in a folder at the same time, where its file system has locks."""
    if count < 2:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def lock(folder: Path, path: Path | None = None) -> Iterator[None]:
    """Lock a folder for writing, by the file `.lock` in it and until the process ends at the latest.

    Args:
        folder: It exists.
        path: The dataset that is written in it, for the message; by default the folder.

    Raises:
        FileError: Names the process that is writing there.
    """
    path = path or folder
    descriptor = open_own(folder / LOCK, os.O_RDWR)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as err:
            holder = os.read(descriptor, 32).decode("ascii", "replace").strip()
            raise FileError(path, f"process {holder or '?'} is writing this dataset: {_ONE_WRITER}") from err
        if not os.fstat(descriptor).st_nlink:
            raise FileError(path, "another process has just ended to write this dataset: repeat it")
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)


def as_path(path: Any) -> Path:
    """Return a path that a caller gave; a `FileError` if it is none."""
    with _named(path):
        os.fsencode(path)
        return Path(path)


def free_name(path: Path, addition: str) -> Path:
    """Return the path with an addition to its name, and a number where there is a file of that name."""
    names = (f"{path.name}.{addition}{'' if number == 1 else f'-{number}'}" for number in count(1))
    return next(path.with_name(name) for name in names if not os.path.lexists(path.with_name(name)))


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically; `FileError` if it cannot be written, and the file before is kept."""
    replace_files({path: text.encode()})


def require_existing(path: str | Path) -> Path:
    """Return the path of something that exists; a `FileError` if it does not, or if no file can have this name."""
    with _named(path):
        try:
            Path(path).stat()
        except FileNotFoundError as err:
            raise FileError(path, "does not exist") from err
        return Path(path)


def require_writable(path: str | Path, *suffixes: str) -> None:
    """Refuse a file that cannot be written, before the work whose result it is to hold; its folder is created.

    Raises:
        FileError: If its name ends with none of the suffixes, it is a folder, or neither exists nor can be created.
    """
    if Path(path).suffix.lower() not in suffixes:
        raise FileError(path, f"the extension is not one of {', '.join(suffixes)}")
    require_replaceable(path)
    existed = Path(path).exists()
    with system_errors(path, "cannot be written"):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).open("ab").close()
        if not existed:
            Path(path).unlink()


def read_bytes(path: str | Path, limit: int | None = None) -> bytes:
    """Return the content of a regular file of at most `limit` bytes.

    Raises:
        FileError: As `open_regular`; also if the file is larger, or reading fails.
    """
    with open_regular(path) as file, _named(path):
        size = os.fstat(file.fileno()).st_size
        content = b"" if limit is not None and size > limit else file.read() or b""  # None of the kernel's that wait
    if limit is not None and (size := max(size, len(content))) > limit:  # files of the kernel have no size before
        raise FileError(path, f"{size} bytes exceed {limit}", field="size")
    return content


def read_json(path: str | Path) -> Any:
    """Return the document in a JSON file; a `FileError` if it cannot be read, is too large, or is no JSON."""
    return json_in(path, read_bytes(path, TEXT_LIMIT))


def text_in(path: str | Path, content: bytes) -> str:
    """Return the text in the content of a file; a `FileError` if it is not UTF-8."""
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as err:
        raise FileError(path, "is no text in UTF-8", field=f"byte {err.start}") from err


def json_in(path: str | Path, content: bytes) -> Any:
    """Return the document in the content of a file; a `FileError` if it is not JSON that `parse_json` accepts."""
    try:
        return parse_json(text_in(path, content))
    except ValueError as err:
        raise FileError(path, f"is not JSON: {' '.join(str(err).split())}") from err


def parse_json(text: str | bytes) -> Any:
    """Return the document in a JSON text.

    Raises:
        ValueError: If it is not JSON, nests more than 64 levels, or holds half of a surrogate pair, which no file
            accepts, or NaN, an infinity or a number that becomes one, or a whole number of more than 39 digits.
    """
    try:
        document = json.loads(text, parse_constant=_finite, parse_float=_finite, parse_int=whole_number)
    except RecursionError:
        raise ValueError(f"more than {_DEPTH} nested levels") from None
    level = [document] if isinstance(document, dict | list) else []
    for _ in range(_DEPTH + 1):
        groups = (entry.values() if isinstance(entry, dict) else entry for entry in level)
        level = [entry for group in groups for entry in group if isinstance(entry, dict | list)]
        if not level:
            break
    else:
        raise ValueError(f"more than {_DEPTH} nested levels")
    if (b"\\ud" if isinstance(text, bytes) else "\\ud") in text.lower():  # type: ignore[operator]
        json.dumps(document, ensure_ascii=False).encode()
    return document


def whole_number(text: str) -> int:
    """Return the whole number in a text; a ValueError if it has more than 39 digits."""
    if len(text) > _DIGITS:
        raise ValueError(f"{shown(text, 40)} is not a number that can be used")
    return int(text)


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{shown(text, 40)} is not a number that can be used")
    return value


_JSON_WORDS: Final = {
    dict: "a mapping",
    list: "a list",
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    type(None): "null",
}


def require_schema(path: str | Path, value: Any, schema: Any, field: str = "") -> Any:
    """Check what a file holds against a schema, and return it.

    Args:
        path: The file, for the message.
        value: Of JSON or YAML.
        schema: A type; a tuple of types, of which one fits; a `Number`; a list of one schema, for a list; or a mapping of
            schemas by key, of which a key with `?` behind it may be absent, and others are ignored unless there is a
            schema for `*`, which is for all of them. Whole numbers are below 2^63,
            also as `float`, which is finite; no number is `bool`.
        field: Name of the value.

    Raises:
        FileError: Names file, field and rule.
    """
    if isinstance(schema, list):
        items = require_schema(path, value, list, field)
        return [require_schema(path, item, schema[0], f"{field}[{number}]") for number, item in enumerate(items)]
    if isinstance(schema, Number):
        if value is None and schema.optional:
            return value
        require_schema(path, value, schema.kind, field)
        if not schema.low <= value <= schema.high:
            rule = f"{shown(value, 40)} is not within [{schema.low:g}, {schema.high:g}]"
            raise FileError(path, rule, field=field or None)
        return value
    if isinstance(schema, Mapping):
        mapping = require_schema(path, value, dict, field)
        if "*" in schema:
            others = dict.fromkeys(mapping, schema["*"])
            schema = others | {key: inner for key, inner in schema.items() if key != "*"}
        for key, inner in schema.items():
            name = key.removesuffix("?")
            where = f"{field}.{name}" if field else name
            if name in mapping:
                require_schema(path, mapping[name], inner, where)
            elif name == key:
                raise FileError(path, "is missing", field=where)
        return mapping
    types = schema if isinstance(schema, tuple) else (schema,)
    if type(value) not in types and not (float in types and type(value) is int):
        names = " or ".join(_JSON_WORDS.get(kind, kind.__name__) for kind in types)
        raise FileError(path, f"{quoted(value)} is not {names}", field=field or None)
    if (type(value) is int and not -(2**63) <= value < 2**63) or (type(value) is float and not math.isfinite(value)):
        raise FileError(path, f"{shown(value, 40)} is not a number that can be used", field=field or None)
    return value


def cache_folder(name: str) -> Path:
    """Return a folder below the user's cache for what can be made again; it is made if it is absent."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "foretouch" / name
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def file_sha256(path: str | Path) -> str:
    """Return the SHA-256 of a regular file, hexadecimal; a `FileError` as `open_regular`, or if reading fails."""
    with open_regular(path) as file, _named(path):
        return hashlib.file_digest(file, "sha256").hexdigest()
