# SPDX-License-Identifier: Apache-2.0
"""Files of earlier releases are read with the same numbers, and files of another format version are refused by name."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from compatibility_files import EXPECTED, REFUSED, read
from every_case import every_case
from recording_builders import write_grasps

from foretouch.dataset.editing import relabel
from foretouch.dataset.files import sealed
from foretouch.dataset.formats import open_samples
from foretouch.dataset.recording.edits import read_edits
from foretouch.dataset.recording.reader import RecordedDataset
from foretouch.dataset.recording.verify import verify_dataset
from foretouch.dataset.recording.writer import RecordingWriter
from foretouch.dataset.store import SEAL, Store
from foretouch.errors import FileError
from foretouch_lab.dataset.store_writer import build_store
from foretouch_lab.learning.data.splits import SPLITS_FILE, make_splits, read_splits

RELEASES = sorted((Path(__file__).parent / "data").glob("from_*"))


@pytest.mark.committed_numbers
def test_files_of_releases_are_read_with_the_same_numbers(tmp_path: Path) -> None:
    """Keys may be added, but none may be missing and no value may differ; recordings of 0.2 are refused."""

    def check(folder: Path) -> None:
        expected = json.loads((folder / EXPECTED).read_text(encoding="utf-8"))
        expected = {key: value for key, value in expected.items() if not key.startswith(REFUSED)}
        assert not list(_differences(expected, read(folder, tmp_path / folder.name)))[:10]

    every_case(RELEASES, check)


def _differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        for key, value in old.items():
            yield from _differences(value, new.get(key, "absent"), f"{where}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for k, (one, other) in enumerate(zip(old, new, strict=True)):
            yield from _differences(one, other, f"{where}[{k}]")
    elif type(old) is not type(new) or old != new:
        yield f"{where}: {new!r}, not {old!r}"


def test_other_format_versions_are_refused_by_name(tmp_path: Path) -> None:
    recording, store = tmp_path / "recording", tmp_path / "store"
    write_grasps(recording)
    relabel(recording, ["cheezit/0"], "cup")
    build_store([recording], store, attach=lambda samples: {SPLITS_FILE: make_splits(samples, 3)})

    def check(path: Path, version: object, *readers: Any) -> None:
        kept = path.read_text()
        content = json.loads(kept.partition("\n")[0] if path.suffix == ".jsonl" else kept)
        content["schema_version"] = version
        path.write_text(sealed(content, SEAL) if path.parent == store else json.dumps(content) + "\n")
        for reader in readers:
            with pytest.raises(FileError, match=rf"{path.name}: .*schema_version: .* is not [12]"):
                reader()
        path.write_text(kept)

    identity = RecordedDataset(recording)[0].identity
    openers = [lambda: RecordedDataset(recording), lambda: open_samples(recording), lambda: verify_dataset(recording)]
    files_and_readers = [
        (recording / "manifest.json", *openers, lambda: RecordingWriter(recording, identity)),
        (recording / "edits.jsonl", lambda: read_edits(recording), *openers),
        (store / "manifest.json", lambda: Store(store), lambda: open_samples(store)),
        (store / "splits.json", lambda: read_splits(store)),
    ]
    every_case([(path, v, *readers) for v in (0, 3, "1", None) for path, *readers in files_and_readers], check)
