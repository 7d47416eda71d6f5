# SPDX-License-Identifier: Apache-2.0
"""File operations that datasets share: readable disk errors, durable names, folders that appear as a whole."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from foretouch.errors import FileError


@contextmanager
def disk_errors(path: Path, rule: str = "") -> Iterator[None]:
    """Turn an `OSError` into a `FileError` with its description and number, after `rule` if there is one."""
    try:
        yield
    except OSError as err:
        prefix = f"{rule}: " if rule else ""
        reason = os.strerror(err.errno) if err.errno else err
        raise FileError(path, f"{prefix}{reason} (errno {err.errno})") from err


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Write a folder beside its final path, and move it there at the end; an error leaves nothing behind.

    Yields:
        Where to create the folder, under its final name: formats name their files after it.

    Raises:
        FileError: If `path` exists, or the disk fails.
    """
    if path.exists():
        raise FileError(path, "exists already and is not overwritten")
    part = path.with_name(f".{path.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        with disk_errors(path, "cannot be written"):
            part.mkdir(parents=True)
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
