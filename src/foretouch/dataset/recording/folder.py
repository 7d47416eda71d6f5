# SPDX-License-Identifier: Apache-2.0
"""A recorded dataset on disk: a manifest, and one MCAP file for each recording session.

Layout, schema version 2 (1 differs in the messages of its samples)::

    dataset/
      manifest.json        format, schema version, hand, camera, version of foretouch, sessions and edits, and the sensor
                           if it is no BioTac SP; with its own checksum; a manifest of foretouch 0.2.0 lacks sessions and edits
      session-0001.mcap    the first session; later ones add files, and never change a finished file
      .lock                locked by the one process that writes

By the list of sessions in the manifest, a session that is missing or another one is noticed. A session is listed once its
file exists and before its first message is written, under an id that the file holds too; at its end, with its number of
samples and the SHA-256 of its index, which has the checksum of all its data. So a crash can leave a listed session
unfinished, and a file that is not listed and has no message, but never a listed session without its file, a file with
messages that is not listed, or another file under a listed name. `repair` enters what it finds, and reports what is lost.
Datasets of foretouch 0.2.0 have no list; the next session or repair makes one.
"""

import fcntl
import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from foretouch import __version__
from foretouch.dataset.files import read_manifest, sealed, sync_folder
from foretouch.dataset.record import Identity
from foretouch.dataset.recording.records import (
    Chunk,
    Damage,
    Declarations,
    Record,
    contents,
    declared_samples,
    summary_of,
)
from foretouch.dataset.recording.sample_codec import OLD_VERSION, SCHEMA_VERSION
from foretouch.errors import FileError
from foretouch.files import FileBytes, open_own, open_regular, replace_files, require_schema, system_errors
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor, sensor_in, with_sensor

_FORMAT: Final = "foretouch-dataset"
_MANIFEST: Final = "manifest.json"
_SEAL: Final = "sha256"
_LOCK: Final = ".lock"
_PART: Final = f"{_MANIFEST}.part"
ID: Final = "id"
REPAIRED: Final = "repaired_by"
_SESSIONS: Final = "sessions"
_DATA_END: Final = 13  # bytes of the record before the index


@dataclass(frozen=True)
class Session:
    """One session in the list."""

    file: str  # name of its file
    id: str  # drawn at random, and in the file too; "" if it was recorded by foretouch 0.2.0
    samples: int = 0  # at its end
    sha256: str = ""  # of its index; "" until its end


def is_dataset(path: str | Path) -> bool:
    """Whether the folder has the manifest of a recorded dataset, which may be damaged or of another version."""
    try:
        with open_regular(Path(path) / _MANIFEST) as file:
            return f'"{_FORMAT}"'.encode() in file.read(65536)
    except (OSError, FileError):
        return False


def recorded_files(path: Path, *, convert: bool = False) -> list[Path]:
    """The MCAP files of a recorded dataset, oldest first; `path` itself if it is a file (raises as `read_manifest`).

    A dataset of version 1 is refused, except to `convert` it.
    """
    if path.is_file():
        return [path]
    if not is_dataset(path):
        raise FileError(path, "is not a recorded dataset" if path.exists() else "does not exist")
    _read_identity(path)
    if _manifest(path)["schema_version"] != SCHEMA_VERSION and not convert:
        raise FileError(path, OLD_VERSION)
    return session_files(path)


def session_files(path: Path) -> list[Path]:
    """The MCAP files of a dataset, oldest first."""
    return sorted(path.glob("session-*.mcap"))


def new_session_path(path: Path) -> Path:
    """The file of the next session; numbers are never used twice."""
    listed = read_listed(path, _SESSIONS, [{"file": str}]) or []
    names = [*(p.name for p in path.glob("session-*")), *(one["file"] for one in listed)]
    taken = [int(found[1]) for name in names if (found := re.match(r"session-(\d{4})\.mcap", name))]
    return path / f"session-{max(taken, default=0) + 1:04d}.mcap"


def _read_identity(path: Path) -> tuple[Identity, str]:
    """Hand and camera of a dataset, and the version of foretouch that made it (raises as `read_manifest`)."""
    content = _manifest(path)
    for name in ("hand", "camera"):
        properties = require_schema(path / _MANIFEST, content, {name: dict})[name]
        require_schema(path / _MANIFEST, properties, dict.fromkeys(properties, str), name)
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


def recorded_sensor(path: Path) -> Sensor:
    """The sensor of a dataset (raises as `read_manifest`, and a `ConfigError` for a faulty description)."""
    return sensor_in(_manifest(path), path / _MANIFEST)


@contextmanager
def opened_to_write(path: Path, identity: Identity, sensor: Sensor | None = None) -> Iterator[None]:
    """Lock a dataset of this hand, camera and sensor for writing (see `lock`); it is created if it does not exist."""
    sensor = sensor or BIOTAC_SP
    with system_errors(path):  # such as a name that is too long
        is_other = path.exists() and not (path / _MANIFEST).exists()
        # A process that is killed before it has written the manifest leaves these two.
        if is_other and not (path.is_dir() and all(entry.name in {_LOCK, _PART} for entry in path.iterdir())):
            raise FileError(path, "exists and is not a recorded dataset")
        path.mkdir(parents=True, exist_ok=True)
    with lock(path):
        if (path / _MANIFEST).exists():
            _require_same(path, identity, sensor)
        else:
            _create_manifest(path, identity, sensor)
        yield


def read_listed(path: Path, name: str, schema: Any) -> Any:
    """What the manifest lists under a name, checked by a schema; None where it lists none (raises as `read_manifest`)."""
    content = _manifest(path)
    return None if name not in content else require_schema(path / _MANIFEST, content[name], schema, name)


def write_listed(path: Path, name: str, value: Any) -> None:
    """Replace what the manifest lists under a name; the caller holds the lock."""
    _write_manifest(path, {**_manifest(path), name: value})


def _manifest(path: Path) -> dict[str, Any]:
    return read_manifest(path / _MANIFEST, _FORMAT, _SEAL, SCHEMA_VERSION, 1)


def _create_manifest(path: Path, identity: Identity, sensor: Sensor) -> None:
    content = {
        "format": _FORMAT,
        "schema_version": SCHEMA_VERSION,
        "foretouch": __version__,
        "hand": dict(sorted(identity.hand.items())),
        "camera": dict(sorted(identity.camera.items())),
        _SESSIONS: [],
        "edits": {"count": 0, "sha256": ""},
    }
    _write_manifest(path, with_sensor(content, sensor))


def _write_manifest(path: Path, content: Mapping[str, Any]) -> None:
    """Write the manifest, which appears complete or not at all."""
    replace_files({path / _MANIFEST: sealed(content, _SEAL).encode()})
    with system_errors(path / _MANIFEST):
        sync_folder(path)


def _require_same(path: Path, identity: Identity, sensor: Sensor) -> None:
    """Refuse to continue with another hand, camera, sensor or minor version of foretouch; names all differences."""
    known, version = _read_identity(path)
    recorded = recorded_sensor(path)
    differences = [
        f"{name}.{fact}: {old.get(fact, 'absent')} there, {new.get(fact, 'absent')} here"
        for name, old, new in (("hand", known.hand, identity.hand), ("camera", known.camera, identity.camera))
        for fact in sorted(old.keys() | new.keys())
        if old.get(fact) != new.get(fact)
    ]
    if recorded.sha256 != sensor.sha256:
        pair = [f"{one.config.name} ({one.sha256[:8]})" for one in (recorded, sensor)]
        changed = ", the description has changed" * (recorded.config.name == sensor.config.name)
        differences.append(f"sensor: {pair[0]} there, {pair[1]} here{changed}")
    if version.split(".")[:2] != __version__.split(".")[:2]:
        differences.append(f"foretouch: {version} there, {__version__} here")
    if differences:
        raise FileError(path, f"is a dataset of another kind, record into a new one: {'; '.join(differences)}")


def listed_sessions(path: Path) -> list[Session] | None:
    """The list of a dataset, None where it has none (raises as `read_manifest`, or if it is no list of sessions)."""
    schema = [{"file": str, "id": str, "samples": int, "sha256": str}]
    found = read_listed(path, _SESSIONS, schema)
    return None if found is None else [Session(**one) for one in found]


def begin_session(path: Path, session: Session) -> None:
    """List a session whose file exists, and those before it if there was no list; the caller holds the lock."""
    known = listed_sessions(path)
    if known is None:
        known = [session_in(file) for file in session_files(path) if file.name != session.file]
    _list_all(path, [*known, session])


def end_session(path: Path, file: Path) -> None:
    """List a session as it is now, at its end or after its repair; the caller holds the lock."""
    _list_all(path, [session_in(file) if one.file == file.name else one for one in listed_sessions(path) or []])


def list_sessions(path: Path) -> None:
    """List the sessions as they are now; the caller holds the lock, and has reported what is lost."""
    _list_all(path, [session_in(file) for file in session_files(path)])


def session_in(file: Path) -> Session:
    """The session in a file."""
    data = FileBytes(file)
    samples, index = declared_samples(data), summary_of(data)
    session = Session(file.name, about_in(data).get(ID, ""))
    if isinstance(index, Damage) or isinstance(samples, Damage):
        return session
    return replace(session, samples=samples, sha256=index_sha256(data, index[0]))


def about_in(data: FileBytes) -> dict[str, str]:
    """What the file says about itself before its first message."""
    declared = Declarations()
    for item in contents(data, declared):
        if declared.about or not isinstance(item, Record) or isinstance(item.content, Chunk):
            break
    return declared.about


def index_sha256(data: FileBytes, start: int) -> str:
    """SHA-256 of the index of a file, which starts at an offset, with the record before it."""
    return hashlib.sha256(data[max(0, start - _DATA_END) : len(data)]).hexdigest()


def _list_all(path: Path, sessions: list[Session]) -> None:
    write_listed(path, _SESSIONS, [asdict(session) for session in sessions])
