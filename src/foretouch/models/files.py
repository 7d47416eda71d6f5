# SPDX-License-Identifier: Apache-2.0
"""Files replaced as a whole or not at all: whoever reads sees the old or the new one, never a part.

Arrays in a safetensors file, checked against the hash that a card names. Such a file holds numbers and no code.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.errors import FileError, ModelError

__all__ = ["file_sha256", "packed", "read_tensors", "replace_files"]


def replace_files(contents: Mapping[Path, bytes]) -> None:
    """Write files that belong together, such as weights and the card that holds their hash.

    All are on the disk under other names before the first is moved to its place, so that a full disk leaves every one of the
    old ones. Only a crash between two moves leaves new beside old; the hash in the card tells that.

    Args:
        contents: By file, in the order in which they are moved; their folders are made if absent.

    Raises:
        FileError: Names the file that cannot be written, such as on a full disk.
    """
    parts = {path: path.with_name(path.name + ".part") for path in contents}
    path = Path()
    try:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            _write_through(parts[path], content)
        for path, part in parts.items():
            part.replace(path)
    except OSError as err:
        for part in parts.values():
            with suppress(OSError):  # that it could not be written is what to tell
                part.unlink()
        raise FileError(path, f"cannot be written, the one before is kept: {err.strerror or err}") from err


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _write_through(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def packed(tensors: Mapping[str, npt.NDArray[Any]]) -> tuple[bytes, str]:
    """Arrays as the content of a safetensors file, and its SHA-256; the same arrays make the same bytes."""
    from safetensors.numpy import save

    content: bytes = save({name: np.asarray(value, order="C") for name, value in tensors.items()})
    return content, hashlib.sha256(content).hexdigest()


def read_tensors(path: Path, sha256: str, named_by: str) -> dict[str, npt.NDArray[Any]]:
    """Arrays by name.

    Args:
        path: The file.
        sha256: That it must have.
        named_by: The card's name, for the message.

    Raises:
        ModelError: Names the file: absent, damaged, or another than the hash tells.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    if not path.is_file():
        raise ModelError(f"{path}: no such weights; {named_by} names them")
    if (found := file_sha256(path)) != sha256:
        raise ModelError(f"{path}: sha256: {found} is not {sha256} of {named_by}; damaged or replaced")
    try:
        tensors: dict[str, npt.NDArray[Any]] = load_file(path)
    except (SafetensorError, OSError, ValueError) as err:
        raise ModelError(f"{path}: damaged: {' '.join(str(err).split())}") from err
    return tensors
