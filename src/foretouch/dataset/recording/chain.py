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
from collections.abc import Iterator
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
    RecordedMessage,
    contents,
    declared_samples,
    is_finished,
    summary_of,
)
from foretouch.errors import FileError
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
    session = Session(file.name, _about(data).get(ID, ""))
    if isinstance(index, Damage) or isinstance(samples, Damage):
        return session
    return replace(session, samples=samples, sha256=_sha256(data, index[0]))


def chain_faults(path: Path) -> list[tuple[Path, str]]:
    """Each file of a dataset that contradicts the list, and the rule; none without a list."""
    faults = list(_faults(path))
    return list(_faults(path)) if faults else []  # a recorder may have begun or ended a session meanwhile


def require_chain(path: Path) -> None:
    """Raise a `FileError` for the first of `chain_faults`, but for a file that is cut off, as which it is read."""
    for file, rule in chain_faults(path):
        if not file.exists() or is_finished(FileBytes(file)):
            raise FileError(file, rule)


def _faults(path: Path) -> Iterator[tuple[Path, str]]:
    files = session_files(path)
    sessions = listed_sessions(path)
    if sessions is None:
        return
    for session in sessions:
        file = path / session.file
        if not file.exists():
            ended = f"with {session.samples} samples" if session.sha256 else "as not finished"
            yield file, f"is missing: the manifest lists it {ended}"
        elif rule := _difference(session, FileBytes(file)):
            yield file, rule
    listed = {session.file for session in sessions}
    for file in files:
        if file.name not in listed and (is_finished(data := FileBytes(file)) or _holds_message(data)):
            yield file, "is not in the list of the manifest: it was added by hand"


def _difference(session: Session, data: FileBytes) -> str:
    about = _about(data)
    if about and about.get(ID, "") != session.id:
        return "is the file of another session than the manifest lists"
    index = summary_of(data)
    if not session.sha256 or REPAIRED in about:  # a crash may end a session or a repair before it is listed
        return ""
    if isinstance(index, Damage):
        return f"is not the session of {session.samples} samples that the manifest lists: {index.rule}"
    same = _sha256(data, index[0]) == session.sha256
    return "" if same else "is not the session that the manifest lists: its index has another hash"


def _about(data: FileBytes) -> dict[str, str]:
    """What the file says about itself before its first message."""
    declared = Declarations()
    for item in contents(data, declared):
        if declared.about or not isinstance(item, Record) or isinstance(item.content, Chunk):
            break
    return declared.about


def _holds_message(data: FileBytes) -> bool:
    return any(isinstance(one, RecordedMessage) for one in contents(data, Declarations()))


def _sha256(data: FileBytes, start: int) -> str:
    return hashlib.sha256(data[max(0, start - _DATA_END) : len(data)]).hexdigest()


def _write(path: Path, sessions: list[Session]) -> None:
    write_listed(path, SESSIONS, [asdict(session) for session in sessions])
