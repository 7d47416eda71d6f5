# SPDX-License-Identifier: Apache-2.0
"""A dataset on disk: a manifest that says what it holds, and one MCAP file for each session of recording.

Layout, schema version 1::

    dataset/
      manifest.json        format, schema version, hand, camera, version of foretouch; with its own checksum
      session-0001.mcap    the first session; later ones append files, never bytes to a finished file
      .lock                held by the one process that writes
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from foretouch import __version__
from foretouch.dataset.recording.messages import SCHEMA_VERSION
from foretouch.dataset.recording.record import Identity
from foretouch.errors import FileError

__all__ = [
    "FORMAT",
    "MANIFEST",
    "create_manifest",
    "is_dataset",
    "is_vacant",
    "lock",
    "new_session_path",
    "opened_to_write",
    "read_identity",
    "require_same",
    "session_files",
    "sync_folder",
]

FORMAT: Final = "foretouch-dataset"
MANIFEST: Final = "manifest.json"
_LOCK: Final = ".lock"
_PART: Final = f"{MANIFEST}.part"
_SESSION: Final = "session-{:04d}.mcap"


def is_dataset(path: str | Path) -> bool:
    """Whether the folder's manifest is one of a dataset, be it damaged or of another version."""
    try:
        with (Path(path) / MANIFEST).open("rb") as file:
            return f'"{FORMAT}"'.encode() in file.read(65536)
    except OSError:
        return False


def is_vacant(path: Path) -> bool:
    """Whether a dataset can begin here: nothing is there, or what one that was killed at once has left."""
    leftovers = {_LOCK, _PART}
    return not path.exists() or (path.is_dir() and all(entry.name in leftovers for entry in path.iterdir()))


def session_files(path: Path) -> list[Path]:
    """The recordings of a dataset, oldest first."""
    return sorted(path.glob("session-*.mcap"))


def new_session_path(path: Path) -> Path:
    """Where the next session goes; numbers are never used twice."""
    taken = [int(p.name[8:12]) for p in path.glob("session-[0-9][0-9][0-9][0-9].mcap*")]
    return path / _SESSION.format(max(taken, default=0) + 1)


def create_manifest(path: Path, identity: Identity) -> None:
    """Write the manifest of a new dataset; it is there as a whole or not at all.

    Raises:
        FileError: If the folder cannot be made or written.
    """
    content = {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "foretouch": __version__,
        "hand": dict(sorted(identity.hand.items())),
        "camera": dict(sorted(identity.camera.items())),
    }
    part = path / _PART
    try:
        path.mkdir(parents=True, exist_ok=True)
        with part.open("w", encoding="utf-8") as file:
            file.write(_sealed(content))
            file.flush()
            os.fsync(file.fileno())
        part.replace(path / MANIFEST)
        sync_folder(path)
    except OSError as err:
        raise FileError(path / MANIFEST, f"{err.strerror or err} (errno {err.errno})") from err


def read_identity(path: Path) -> tuple[Identity, str]:
    """Hand and camera of a dataset, and the version of foretouch that made it.

    Raises:
        FileError: If the manifest is absent, damaged, or of another schema version.
    """
    file = path / MANIFEST
    content = _read(file)
    version = content.get("schema_version")
    if version != SCHEMA_VERSION:
        newer = isinstance(version, int) and version > SCHEMA_VERSION
        advice = "it was written by a newer foretouch" if newer else f"foretouch {__version__} reads that one alone"
        raise FileError(file, f"{version} is not {SCHEMA_VERSION}: {advice}", field="schema_version")
    if _sealed(content) != file.read_text(encoding="utf-8"):
        raise FileError(file, "damaged: the text is not that of which its checksum was taken", field="sha256")
    return Identity(hand=content["hand"], camera=content["camera"]), str(content["foretouch"])


def require_same(path: Path, identity: Identity) -> None:
    """Refuse to go on with another hand, another camera, or another minor version of foretouch.

    Raises:
        FileError: Names every difference.
    """
    known, version = read_identity(path)
    pairs = [("hand", known.hand, identity.hand), ("camera", known.camera, identity.camera)]
    differences = [line for name, old, new in pairs for line in _differences(name, old, new)]
    if version.split(".")[:2] != __version__.split(".")[:2]:
        differences.append(f"foretouch: {version} there, {__version__} here")
    if differences:
        raise FileError(path, f"is a dataset of another kind, record into a new one: {'; '.join(differences)}")


@contextmanager
def lock(path: Path) -> Iterator[None]:
    """Be the only writer of a dataset; the system lets go of it however the process ends.

    Raises:
        FileError: If another process writes, which is named.
    """
    file = path / _LOCK
    try:
        fd = os.open(file, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as err:
        raise FileError(file, f"{err.strerror or err} (errno {err.errno})") from err
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as err:
            holder = os.read(fd, 32).decode("ascii", "replace").strip()
            raise FileError(path, f"process {holder or '?'} is writing this dataset: one recorder at a time") from err
        os.ftruncate(fd, 0)
        os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(fd)


@contextmanager
def opened_to_write(path: Path, identity: Identity) -> Iterator[None]:
    """Be the only writer of a dataset that is of this hand and camera; it is made where there is none.

    Raises:
        FileError: If another process writes, it is of another kind, or it cannot be written.
    """
    if not (path / MANIFEST).exists() and not is_vacant(path):
        raise FileError(path, "exists, and is no dataset to go on with")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise FileError(path, f"{err.strerror or err} (errno {err.errno})") from err
    with lock(path):
        if (path / MANIFEST).exists():
            require_same(path, identity)
        else:
            create_manifest(path, identity)
        yield


def sync_folder(path: Path) -> None:
    """Put the names of a folder on the disk, so that a new file outlives a power cut."""
    fd = os.open(path, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _differences(name: str, old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    return [
        f"{name}.{fact}: {old.get(fact, 'absent')} there, {new.get(fact, 'absent')} here"
        for fact in sorted(old.keys() | new.keys())
        if old.get(fact) != new.get(fact)
    ]


def _sealed(content: Mapping[str, Any]) -> str:
    """The manifest's text; its checksum is over the rest of it, and the text can be told from any other."""
    body = {name: value for name, value in content.items() if name != "sha256"}
    digest = hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()
    return json.dumps({**body, "sha256": digest}, indent=2, ensure_ascii=False) + "\n"


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except OSError as err:
        raise FileError(file, err.strerror or str(err)) from err
    except (ValueError, RecursionError) as err:
        raise FileError(file, f"damaged: is no JSON: {' '.join(str(err).split())}") from err
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileError(file, f"is not {FORMAT}", field="format")
    for name in ("hand", "camera"):
        facts = content.get(name)
        if not isinstance(facts, dict) or not all(isinstance(value, str) for value in facts.values()):
            raise FileError(file, "is no list of named texts", field=name)
    return content
