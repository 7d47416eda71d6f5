# SPDX-License-Identifier: Apache-2.0
"""A recorded dataset on disk: a manifest, and one MCAP file for each recording session.

Layout, schema version 1::

    dataset/
      manifest.json        format, schema version, hand, camera, version of foretouch; with its own checksum
      session-0001.mcap    the first session; later ones add files, and never change a finished file
      .lock                locked by the one process that writes
"""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import BinaryIO, Final

from foretouch import __version__
from foretouch.checked_files import open_own, open_regular, replace_files
from foretouch.dataset.files import disk_errors, new_folder, read_manifest, sealed, sync_folder
from foretouch.dataset.record import Identity
from foretouch.dataset.recording.sample_codec import SCHEMA_VERSION
from foretouch.errors import FileError

_FORMAT: Final = "foretouch-dataset"
_MANIFEST: Final = "manifest.json"
_SEAL: Final = "sha256"
_LOCK: Final = ".lock"
_PART: Final = f"{_MANIFEST}.part"


def is_dataset(path: str | Path) -> bool:
    """Whether the folder has the manifest of a recorded dataset, which may be damaged or of another version."""
    try:
        with open_regular(Path(path) / _MANIFEST) as file:
            return f'"{_FORMAT}"'.encode() in file.read(65536)
    except (OSError, FileError):
        return False


def recorded_files(path: Path) -> list[Path]:
    """The MCAP files of a recorded dataset, oldest first; `path` itself if it is a file (raises as `read_manifest`)."""
    if path.is_file():
        return [path]
    if not is_dataset(path):
        raise FileError(path, "is no recorded dataset" if path.exists() else "does not exist")
    _read_identity(path)
    return session_files(path)


def session_files(path: Path) -> list[Path]:
    """The MCAP files of a dataset, oldest first."""
    return sorted(path.glob("session-*.mcap"))


def new_session_path(path: Path) -> Path:
    """The file of the next session; numbers are never used twice."""
    taken = [int(p.name[8:12]) for p in path.glob("session-[0-9][0-9][0-9][0-9].mcap*")]
    return path / f"session-{max(taken, default=0) + 1:04d}.mcap"


def _read_identity(path: Path) -> tuple[Identity, str]:
    """Hand and camera of a dataset, and the version of foretouch that made it (raises as `read_manifest`)."""
    file = path / _MANIFEST
    content = read_manifest(file, _FORMAT, SCHEMA_VERSION, _SEAL)
    for name in ("hand", "camera"):
        properties = content.get(name)
        if not isinstance(properties, dict) or not all(isinstance(value, str) for value in properties.values()):
            raise FileError(file, "is no list of named texts", field=name)
    return Identity(hand=content["hand"], camera=content["camera"]), str(content.get("foretouch"))


@contextmanager
def lock(path: Path) -> Iterator[None]:
    """Lock a dataset for writing, until the process ends at the latest; a `FileError` names another that is writing."""
    file = path / _LOCK
    fd = open_own(file, os.O_RDWR)
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
    """Lock a dataset of this hand and camera for writing (see `lock`); it is created if it does not exist."""
    with disk_errors(path):  # such as a name that is too long
        is_other = path.exists() and not (path / _MANIFEST).exists()
        # A process that is killed before it has written the manifest leaves these two.
        if is_other and not (path.is_dir() and all(entry.name in {_LOCK, _PART} for entry in path.iterdir())):
            raise FileError(path, "exists and is no recorded dataset")
        path.mkdir(parents=True, exist_ok=True)
    with lock(path):
        if (path / _MANIFEST).exists():
            _require_same(path, identity)
        else:
            _create_manifest(path, identity)
        yield


def copy_session(source: BinaryIO, file: Path, folder: Path, identity: Identity) -> Path:
    """Copy a session whose file was removed into a new dataset in `folder`, which appears complete or not at all.

    Returns:
        The dataset: its name is that of `file`'s folder, or that name with a number.
    """
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    name = file.parent.absolute().name
    names = (name if number == 1 else f"{name}-{number}" for number in count(1))
    path = next(folder / one for one in names if not (folder / one).exists())
    with new_folder(path) as part, opened_to_write(part, identity):
        with (part / file.name).open("xb") as copy:
            source.seek(0)
            shutil.copyfileobj(source, copy)
            copy.flush()
            os.fsync(copy.fileno())
        sync_folder(part)
    with disk_errors(folder):
        sync_folder(folder)
    return path


def _create_manifest(path: Path, identity: Identity) -> None:
    """Write the manifest of a new dataset; it appears complete or not at all."""
    content = {
        "format": _FORMAT,
        "schema_version": SCHEMA_VERSION,
        "foretouch": __version__,
        "hand": dict(sorted(identity.hand.items())),
        "camera": dict(sorted(identity.camera.items())),
    }
    replace_files({path / _MANIFEST: sealed(content, _SEAL).encode()})
    with disk_errors(path / _MANIFEST):
        sync_folder(path)


def _require_same(path: Path, identity: Identity) -> None:
    """Refuse to continue with another hand, camera or minor version of foretouch; names all differences."""
    known, version = _read_identity(path)
    differences = [
        f"{name}.{fact}: {old.get(fact, 'absent')} there, {new.get(fact, 'absent')} here"
        for name, old, new in (("hand", known.hand, identity.hand), ("camera", known.camera, identity.camera))
        for fact in sorted(old.keys() | new.keys())
        if old.get(fact) != new.get(fact)
    ]
    if version.split(".")[:2] != __version__.split(".")[:2]:
        differences.append(f"foretouch: {version} there, {__version__} here")
    if differences:
        raise FileError(path, f"is a dataset of another kind, record into a new one: {'; '.join(differences)}")
