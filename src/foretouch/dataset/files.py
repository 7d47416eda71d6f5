# SPDX-License-Identifier: Apache-2.0
"""Files that datasets share: durable names, folders that appear as a whole, sealed manifests."""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from foretouch import __version__
from foretouch.base.files import LOCK, PART, TEXT_LIMIT, free_name, json_in, lock, read_bytes, system_errors
from foretouch.errors import FileError, VersionError, shown


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Write a folder beside its final path, and move it there at the end; an error leaves nothing behind.

    Gives where to create it, under its final name, after which formats name files. What a process that was killed left there is
    removed; what another one is writing is not.

    Args:
        path: The folder.

    Raises:
        FileError: If it exists, another process is writing it, or its folder cannot be written.
    """
    _require_absent(path)
    part = path.with_name(f".{path.name}{PART}")
    with system_errors(path, f"cannot be written, by way of {part.name}"):
        part.mkdir(parents=True, exist_ok=not part.is_symlink())
    with ExitStack() as stack:
        try:
            stack.enter_context(lock(part, path))
        finally:
            _require_absent(path)  # another process may just have ended
        try:
            for left in part.iterdir():
                if left.is_dir() and not left.is_symlink():
                    shutil.rmtree(left, ignore_errors=True)
                elif left.name != LOCK:
                    left.unlink()
            yield part / path.name
            _move(part / path.name, path)
        finally:
            shutil.rmtree(part, ignore_errors=True)


def _require_absent(path: Path) -> None:
    if path.exists():
        raise FileError(path, "exists already and is not overwritten")


def _move(made: Path, path: Path) -> None:
    """Move a folder to its final path; where another program made one meanwhile, beside it."""
    with system_errors(path, "cannot be written"):
        try:
            made.rename(path)
        except OSError:
            if not path.exists():
                raise
            kept = free_name(path, "new")
            made.rename(kept)
            raise FileError(path, f"was made by another program meanwhile; what was written is {kept.name}") from None


def sync_folder(path: Path) -> None:
    """Put the names of a folder on the disk, so that a new file survives a power cut."""
    fd = os.open(path, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def require_version(version: Any, known: int, *also: int) -> None:
    """Refuse a schema version other than `known` and `also` with a `VersionError`."""
    if version not in (known, *also) or isinstance(version, bool):  # a tuple: the version may be a list
        newer = isinstance(version, int) and version > known
        advice = "it was written by a newer foretouch" if newer else f"foretouch {__version__} supports no other"
        raise VersionError(f"schema_version: {shown(version)} is not {known}: {advice}")


def sealed(content: Mapping[str, Any], seal: str) -> str:
    """Return the text of a manifest with its checksum under the name `seal`; equal content gives equal text."""
    body = {name: value for name, value in content.items() if name != seal}
    digest = hashlib.sha256(json.dumps(body, sort_keys=True, allow_nan=False).encode()).hexdigest()
    return json.dumps({**body, seal: digest}, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def read_manifest(file: Path, kind: str, seal: str, *versions: int) -> dict[str, Any]:
    """Return the content of a manifest.

    Raises:
        FileError: If it is absent, no JSON, of another format or schema version, or changed.
    """
    text = read_bytes(file, TEXT_LIMIT)
    content: Any = json_in(file, text)
    if not isinstance(content, dict) or content.get("format") != kind:
        raise FileError(file, f"is not {kind}", field="format")
    try:
        require_version(content.get("schema_version"), *versions)
        unchanged = sealed(content, seal).encode() == text
    except VersionError as err:
        raise FileError(file, str(err)) from err
    except ValueError:  # numbers that are not finite
        unchanged = False
    if not unchanged:
        raise FileError(file, "damaged: the text does not match its checksum", field=seal)
    return content
