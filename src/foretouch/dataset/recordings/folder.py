# SPDX-License-Identifier: Apache-2.0
"""A recorded dataset on disk: a manifest, and one MCAP file for each recording session.

Layout, schema version 3 (1 and 2 differ in the messages of their samples)::

    dataset/
      manifest.json        format, schema version, hand, camera, version of foretouch, and the sensor if it is no BioTac SP;
                           the sessions by name with the id in each, and the number of edits with the checksum over them;
                           with its own checksum
      session-0001.mcap    the first session; later ones add files, and never change a finished file
      .lock                locked by the one process that writes
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from foretouch import __version__
from foretouch.base.files import LOCK, PART, lock, open_regular, replace_files, require_schema, system_errors
from foretouch.dataset.files import read_manifest, sealed, sync_folder
from foretouch.dataset.identity import Identity
from foretouch.dataset.recordings.sample_codec import OLD_VERSION, READ_VERSIONS, SCHEMA_VERSION
from foretouch.errors import FileError
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor, sensor_in, with_sensor

_FORMAT: Final = "foretouch-dataset"
_MANIFEST: Final = "manifest.json"
_SEAL: Final = "sha256"
SESSIONS: Final = "sessions"  # in the manifest, as the next
EDITS: Final = "edits"


def is_dataset(path: str | Path) -> bool:
    """Return whether the folder has the manifest of a recorded dataset, which may be damaged or of another version."""
    try:
        with open_regular(Path(path) / _MANIFEST) as file:
            return f'"{_FORMAT}"'.encode() in file.read(65536)
    except (OSError, FileError):
        return False


def recorded_files(path: Path, *, complete: bool = True) -> list[Path]:
    """Return the MCAP files of a recorded dataset, oldest first; `path` itself if it is a file. A `FileError` for a damaged manifest.

    A dataset of version 1 is refused, and one of which a session is absent, unless it need not be `complete`: then the files of a
    bag are given, too.
    """
    if path.is_file():
        return [path]
    if not is_dataset(path):
        files = [] if complete or (path / _MANIFEST).exists() else sorted(path.glob("*.mcap"))
        if not files:
            raise FileError(path, "is not a recorded dataset" if path.exists() else "does not exist")
        return files
    _read_identity(path)
    if _manifest(path)["schema_version"] not in READ_VERSIONS:
        raise FileError(path, OLD_VERSION)
    for name in stated(path, SESSIONS):
        if complete and not (path / name).exists():
            rule = "is absent: restore it, or take it off the list by `foretouch dataset repair`"
            raise FileError(path / _MANIFEST, f"{name} {rule}", field=SESSIONS)
    return session_files(path)


def session_files(path: Path) -> list[Path]:
    """Return the MCAP files of a dataset, oldest first."""
    return sorted(path.glob("session-*.mcap"))


def new_session_path(path: Path) -> Path:
    """Return the file of the next session; numbers are never used twice."""
    names = (p.name for p in path.glob("session-*"))
    taken = [int(match[1]) for name in names if (match := re.match(r"session-(\d{4})\.mcap", name))]
    return path / f"session-{max(taken, default=0) + 1:04d}.mcap"


def _read_identity(path: Path) -> tuple[Identity, str]:
    """Read hand and camera of a dataset, and the version of foretouch that made it; a `FileError` for a damaged manifest."""
    content = require_schema(path / _MANIFEST, _manifest(path), {"hand": {"*": str}, "camera": {"*": str}})
    return Identity(hand=content["hand"], camera=content["camera"]), str(content.get("foretouch"))


def stated(path: Path, name: str) -> dict[str, Any]:
    """Return what the manifest states of `SESSIONS` or `EDITS`; nothing in one that was written before 0.4. A `FileError` for a damaged manifest."""
    content = require_schema(path / _MANIFEST, _manifest(path), {f"{name}?": {"*": str} if name == SESSIONS else dict})
    return dict(content.get(name, {}))


def restate(path: Path, name: str, facts: Mapping[str, Any]) -> None:
    """Let the manifest of a locked dataset state other facts of `SESSIONS` or `EDITS`; a `FileError` leaves it as it is."""
    replace_files({path / _MANIFEST: sealed({**_manifest(path), name: dict(facts)}, _SEAL).encode()})
    with system_errors(path):
        sync_folder(path)


def recorded_sensor(path: Path) -> Sensor:
    """Return the sensor of a dataset; a `FileError` for a damaged manifest, a `ConfigError` for a faulty description."""
    return sensor_in(_manifest(path), path / _MANIFEST)


@contextmanager
def opened_to_write(path: Path, identity: Identity, sensor: Sensor | None = None) -> Iterator[None]:
    """Lock a dataset of this hand, camera and sensor for writing (see `files.lock`); it is created if it does not exist."""
    sensor = sensor or BIOTAC_SP
    with system_errors(path):  # such as a name that is too long
        is_other = path.exists() and not (path / _MANIFEST).exists()
        # A process that is killed before it has written the manifest leaves these two.
        if is_other and not (path.is_dir() and all(_is_left_over(entry.name) for entry in path.iterdir())):
            raise FileError(path, "exists and is not a recorded dataset")
        path.mkdir(parents=True, exist_ok=True)
    with lock(path):
        is_new = not (path / _MANIFEST).exists()
        if is_new:
            _create_manifest(path, identity, sensor)
        else:
            _require_same(path, identity, sensor)
        try:
            yield
        finally:
            # Nothing was recorded or checked, so the next one may be of another hand.
            if is_new and all(_is_left_over(file.name) for file in path.glob("*") if file.name != _MANIFEST):
                (path / _MANIFEST).unlink(missing_ok=True)


def _is_left_over(name: str) -> bool:
    return name == LOCK or (name.startswith(_MANIFEST) and name.endswith(PART))


def _manifest(path: Path) -> dict[str, Any]:
    return read_manifest(path / _MANIFEST, _FORMAT, _SEAL, *READ_VERSIONS, 1)


def _create_manifest(path: Path, identity: Identity, sensor: Sensor) -> None:
    content = {
        "format": _FORMAT,
        "schema_version": SCHEMA_VERSION,
        "foretouch": __version__,
        "hand": dict(sorted(identity.hand.items())),
        "camera": dict(sorted(identity.camera.items())),
    }
    replace_files({path / _MANIFEST: sealed(with_sensor(content, sensor), _SEAL).encode()})
    with system_errors(path / _MANIFEST):
        sync_folder(path)


def _require_same(path: Path, identity: Identity, sensor: Sensor) -> None:
    """Refuse to continue with another hand, camera, sensor, schema or minor version of foretouch; names all differences."""
    old, new = _facts(*_read_identity(path), recorded_sensor(path)), _facts(identity, __version__, sensor)
    old["schema_version"], new["schema_version"] = str(_manifest(path)["schema_version"]), str(SCHEMA_VERSION)
    differences = [
        f"{name}: {old.get(name, 'absent')} there, {new.get(name, 'absent')} here"
        for name in sorted(old.keys() | new.keys())
        if old.get(name) != new.get(name)
    ]
    if differences:
        named = ", or name what is unknown here (identity.hand, identity.camera)" if "unknown" in new.values() else ""
        raise FileError(path, f"is a dataset of another kind, record into a new one{named}: {'; '.join(differences)}")


def _facts(identity: Identity, version: str, sensor: Sensor) -> dict[str, str]:
    facts = {"foretouch": ".".join(version.split(".")[:2]), "sensor": f"{sensor.config.name} ({sensor.sha256[:8]})"}
    for group, values in (("hand", identity.hand), ("camera", identity.camera)):
        facts |= {f"{group}.{name}": value for name, value in values.items()}
    return facts
