# SPDX-License-Identifier: Apache-2.0
"""Files replaced as a whole or not at all: whoever reads sees the old or the new one, never a part."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from foretouch.errors import FileError

__all__ = ["replace_files"]


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


def _write_through(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
