# SPDX-License-Identifier: Apache-2.0
"""Files of versions 0.2 and 0.4 are read with the same numbers; recordings of 0.2 and other format versions are refused by name.

Code of that version wrote `data/from_0_2_0`, and printed what stands in its `expected.json`. They are not renewed: files
that newer code wrote prove nothing about older ones. Code of 0.4.0 wrote `data/from_0_4_0`: in each folder the labelled
`record(n, points=5)` and the unlabelled `record(10 + n, points=4)` of `recording_builders`, by a camera whose name has n letters.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from recording_builders import assert_same_sample, record, write_grasps

from foretouch.cli.main import main
from foretouch.dataset.files import sealed
from foretouch.dataset.formats import open_samples
from foretouch.dataset.recordings.editing import relabel
from foretouch.dataset.recordings.edits import read_edits
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.store import SEAL, Store
from foretouch.errors import FileError
from foretouch.types import Sample
from foretouch_lab.dataset.store_writer import build_store
from foretouch_lab.learning.data.splits import SPLITS_FILE, make_splits, read_splits

FROM_0_4 = Path(__file__).parent / "data" / "from_0_4_0"
CHANGING = {"ms", "seconds", "version", "out", "path", "original"}
"""Keys whose values differ from run to run, or name folders."""


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A copy of the files of version 0.2."""
    return Path(shutil.copytree(Path(__file__).parent / "data" / "from_0_2_0", tmp_path / "old"))


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Any:
    """Runs a command that has to succeed; gives its JSON lines."""

    def run(*words: object) -> list[dict[str, Any]]:
        assert main([*map(str, words), "--json"]) == 0, words
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    return run


def _values(path: Path) -> dict[str, str]:
    with np.load(path, allow_pickle=False) as arrays:
        return {
            name: f"{a.dtype}{a.shape} {hashlib.sha256(a.tobytes()).hexdigest()[:16]}" for name, a in arrays.items()
        }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items() if key not in CHANGING}
    return [_plain(item) for item in value] if isinstance(value, list) else value


@pytest.mark.committed_numbers
def test_a_store_and_models_of_version_0_2_are_read_with_the_same_numbers(old: Path, printed: Any) -> None:
    """Keys may be added, but none may be missing and no value may differ."""
    store, npz, built = old / "store", old / "store-npz", old / "store-built"
    found = {
        "store: info": printed("dataset", "info", store),
        "store: verify": printed("dataset", "verify", store),
        "store: export": printed("dataset", "export", store, "-o", npz, "--format", "npz"),
        "store: values": {path.name: _values(path) for path in sorted(npz.rglob("*.npz"))},
        "store: build": printed("dataset", "build", store, "-o", built, "--seed", 3),
        "store: splits": json.loads((built / "splits.json").read_text(encoding="utf-8")),
        **{f"model: {card.stem}": printed("models", card) for card in sorted((old / "model").glob("*.json"))},
    }
    plain = json.loads(json.dumps(_plain(found)).replace(f"{old}/", ""))
    assert not list(_differences(json.loads((old / "expected.json").read_text(encoding="utf-8")), plain))[:10]


def test_every_command_refuses_a_recording_of_version_0_2_and_names_what_converts_it(old: Path, capsys: Any) -> None:
    for words in (["info"], ["verify"], ["repair"], ["import", "-o", str(old / "new")]):
        assert main(["dataset", *words, str(old / "recording")]) == 1
        rule = "convert it with `foretouch dataset import OLD -o NEW` of version 0.3"
        assert rule in capsys.readouterr().err


def turned(sample: Sample, read: Sample) -> Sample:
    """Return a sample with the rotation of the one that was read, whose last bits another processor computed."""
    rotation = read.grasp.rotation
    np.testing.assert_allclose(rotation, sample.grasp.rotation, atol=1e-14)
    candidates = tuple(replace(grasp, rotation=rotation) for grasp in sample.candidates)
    return replace(sample, grasp=replace(sample.grasp, rotation=rotation), candidates=candidates)


def test_samples_of_version_0_4_are_read_without_a_table_and_counted(tmp_path: Path, printed: Any) -> None:
    """Padding of its messages differs with the length of the camera's name."""
    for number in range(1, 5):
        path = Path(shutil.copytree(FROM_0_4 / "abcd"[:number], tmp_path / str(number)))
        labelled, unlabelled = RecordedDataset(path)
        assert_same_sample(labelled, turned(replace(record(number, points=5), table=None), labelled))
        expected = replace(record(10 + number, points=4, labelled=False), table=None)
        assert_same_sample(unlabelled, turned(expected, unlabelled))
        assert RecordedDataset(path).identity.camera == {"name": "abcd"[:number]}
        (facts,) = printed("dataset", "info", path)
        assert (facts["samples"], facts["tables"]) == (2, 0)
        assert verify_dataset(path)[0].clean
        with pytest.raises(FileError, match="schema_version: 2 there, 3 here"):
            RecordingWriter(path, RecordedDataset(path).identity)
        (imported,) = printed("dataset", "import", path, "-o", tmp_path / f"new-{number}")
        assert (imported["samples"], imported["tables"]) == (2, 0)
        assert_same_sample(next(iter(RecordedDataset(tmp_path / f"new-{number}"))), labelled)


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
            with pytest.raises(FileError, match=rf"{path.name}: .*schema_version: .* is not [123]"):
                reader()
        path.write_text(kept)

    identity = RecordedDataset(recording).identity
    openers = [lambda: RecordedDataset(recording), lambda: open_samples(recording), lambda: verify_dataset(recording)]
    files_and_readers = [
        (recording / "manifest.json", *openers, lambda: RecordingWriter(recording, identity)),
        (recording / "edits.jsonl", lambda: read_edits(recording), *openers),
        (store / "manifest.json", lambda: Store(store), lambda: open_samples(store)),
        (store / "splits.json", lambda: read_splits(store)),
    ]
    every_case([(path, v, *readers) for v in (0, 9, "1", None) for path, *readers in files_and_readers], check)
