# SPDX-License-Identifier: Apache-2.0
"""The list of a dataset's sessions in its manifest, by which a session that is missing or another one is noticed.

A session is listed once its file exists and before its first message is written, under an id that the file holds too; at
its end, with its number of samples and the SHA-256 of its index, which has the checksum of all its data. So a crash can
leave a listed session unfinished, and a file that is not listed and has no message, but never a listed session without
its file, a file with messages that is not listed, or another file under a listed name. `repair` enters what it finds,
and reports what is lost. Datasets of foretouch 0.2.0 have no list; the next session or repair makes one.
"""

import hashlib
import os
import shutil
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import BinaryIO

from foretouch.dataset.files import new_folder, sync_folder
from foretouch.dataset.record import Identity
from foretouch.dataset.recording.folder import opened_to_write, read_listed, session_files, write_listed
from foretouch.dataset.recording.records import (
    Chunk,
    Damage,
    Declarations,
    Record,
    contents,
    declared_samples,
    summary_of,
)
from foretouch.files import FileBytes, system_errors
from foretouch.tactile.description import Sensor

SESSIONS = "sessions"
ID = "id"
REPAIRED = "repaired_by"
_DATA_END = 13  # bytes of the record before the index


@dataclass(frozen=True)
class Session:
    """One session in the list."""

    file: str  # name of its file
    id: str  # drawn at random, and in the file too; "" if it was recorded by foretouch 0.2.0
    samples: int = 0  # at its end
    sha256: str = ""  # of its index; "" until its end


def listed_sessions(path: Path) -> list[Session] | None:
    """The list of a dataset, None where it has none (raises as `read_manifest`, or if it is no list of sessions)."""
    schema = [{"file": str, "id": str, "samples": int, "sha256": str}]
    found = read_listed(path, SESSIONS, schema)
    return None if found is None else [Session(**one) for one in found]


def begin_session(path: Path, session: Session) -> None:
    """List a session whose file exists, and those before it if there was no list; the caller holds the lock."""
    known = listed_sessions(path)
    if known is None:
        known = [session_in(file) for file in session_files(path) if file.name != session.file]
    _write(path, [*known, session])


def end_session(path: Path, file: Path) -> None:
    """List a session as it is now, at its end or after its repair; the caller holds the lock."""
    _write(path, [session_in(file) if one.file == file.name else one for one in listed_sessions(path) or []])


def list_sessions(path: Path) -> None:
    """List the sessions as they are now; the caller holds the lock, and has reported what is lost."""
    _write(path, [session_in(file) for file in session_files(path)])


def copy_session(source: BinaryIO, file: Path, folder: Path, identity: Identity, sensor: Sensor) -> Path:
    """Copy a session whose file was removed into a new dataset in `folder`, which appears complete or not at all.

    Returns:
        The dataset: its name is that of `file`'s folder, or that name with a number.
    """
    with system_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    name = file.parent.absolute().name
    names = (name if number == 1 else f"{name}-{number}" for number in count(1))
    path = next(folder / one for one in names if not (folder / one).exists())
    with new_folder(path) as part, opened_to_write(part, identity, sensor):
        with (part / file.name).open("xb") as copy:
            source.seek(0)
            shutil.copyfileobj(source, copy)
            copy.flush()
            os.fsync(copy.fileno())
        list_sessions(part)
        sync_folder(part)
    with system_errors(folder):
        sync_folder(folder)
    return path


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


def _write(path: Path, sessions: list[Session]) -> None:
    write_listed(path, SESSIONS, [asdict(session) for session in sessions])
