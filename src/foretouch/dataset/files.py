# SPDX-License-Identifier: Apache-2.0
"""Files that datasets share: durable names, folders that appear as a whole, sealed manifests."""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from foretouch import __version__
from foretouch.errors import FileError, VersionError, shown
from foretouch.files import TEXT_LIMIT, json_in, read_bytes, system_errors


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Write a folder beside its final path, and move it there at the end; an error leaves nothing behind.

    Gives where to create it, under its final name, after which formats name files; a `FileError` if `path` exists.
    """
    if path.exists():
        raise FileError(path, "exists already and is not overwritten")
    part = path.with_name(f".{path.name}.part")
    if part.is_dir():  # `rmtree` would wait for the other end of a FIFO
        shutil.rmtree(part, ignore_errors=True)
    with system_errors(path, f"cannot be written, by way of {part.name}"):
        part.mkdir(parents=True)
    try:
        with system_errors(path, "cannot be written"):
            yield part / path.name
            (part / path.name).rename(path)
    finally:
        shutil.rmtree(part, ignore_errors=True)


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
