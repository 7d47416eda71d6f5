# SPDX-License-Identifier: Apache-2.0
"""A new format of datasets is one module and one line of the table: every command and reader then supports it."""

import sys
from collections.abc import Iterator

import numpy as np
import pytest
from recording_builders import record, write_dataset

from foretouch.cli.main import main
from foretouch.dataset import formats
from foretouch.dataset.importing import import_samples
from foretouch.dataset.samples import export_samples, is_sample_set, open_samples
from foretouch.dataset.source import open_source
from foretouch.dataset.store import Store
from foretouch.dataset.store_writer import build_store
from foretouch.errors import FileError

MODULE = """
import json
import numpy as np
from foretouch.dataset.record import SampleRecord
from foretouch.dataset.samples import DatasetFormat, SampleSet
from foretouch.types import Cloud, Grasp, GraspSample, Touch


def _open(path, unfinished):
    files = sorted(path.glob("*.json"))

    def read(k):
        facts = json.loads(files[k].read_text())
        cloud = Cloud(np.load(files[k].with_suffix(".npy")), None, "camera", facts["stamp_ns"])
        grasp = Grasp(np.array(facts["g1"]), np.array(facts["g2"]), np.eye(3))
        touch = Touch.from_vector(np.array(facts["touch"]))
        return SampleRecord(sample=GraspSample(facts["id"], facts["object"], cloud, grasp, touch, None, facts["stamp_ns"]))

    return SampleSet(path=path, kind="jsonnpy", size=len(files), record=read, name=lambda k: str(files[k]))


def _export(samples, out, result, progress):
    out.mkdir()
    for k, record in enumerate(samples.records()):
        sample = record.sample
        facts = {"id": sample.id, "object": sample.object, "stamp_ns": sample.stamp_ns,
                 "g1": sample.grasp.g1.tolist(), "g2": sample.grasp.g2.tolist(), "touch": sample.touch.vector().tolist()}
        (out / f"{k:03d}.json").write_text(json.dumps(facts))
        np.save(out / f"{k:03d}.npy", sample.cloud.xyz)
        result.written += 1
        progress()


DATASET_FORMAT = DatasetFormat(
    recognise=lambda path: next(path.glob("*.json")).with_suffix(".npy").is_file(), open=_open, export=_export
)
"""


@pytest.fixture
def jsonnpy(tmp_path, monkeypatch) -> Iterator[None]:
    """A format of `.json` and `.npy` pairs: its module and its line."""
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "jsonnpy_format.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path / "modules")
    line = formats.FormatEntry("jsonnpy", "JSON and NumPy files", "jsonnpy_format", (), ("*.json",), exported=True)
    monkeypatch.setattr(formats, "FORMATS", (line, *formats.FORMATS))
    yield
    sys.modules.pop("jsonnpy_format", None)


@pytest.mark.usefixtures("jsonnpy")
def test_a_new_format_is_read_built_exported_imported_and_listed(tmp_path, call, capsys) -> None:
    write_dataset(tmp_path / "ds", 3)
    out = tmp_path / "pairs"
    exported = call("dataset", "export", tmp_path / "ds", "-o", out, "--format", "jsonnpy", "--json")
    assert (exported.status, exported.records[0]["samples"]) == (0, 3)
    (info,) = call("dataset", "info", out, "--json").records
    assert (info["kind"], info["samples"], info["objects"]) == ("jsonnpy", 3, {"ball": 3})
    assert call("dataset", "build", out, "-o", tmp_path / "store", "--json").records[0]["samples"] == 3
    np.testing.assert_array_equal(Store(tmp_path / "store")[2].cloud.xyz, record(2).sample.cloud.xyz)
    assert import_samples(out, tmp_path / "again").labelled == 3
    source = open_source(out)
    assert source.kind == "samples"
    assert [item.sample.id for item in source if item.sample] == ["ball/000001", "ball/000002", "ball/000003"]
    for action in ("info", "build", "import", "export", "show"):
        with pytest.raises(SystemExit):
            main(["dataset", action, "--help"])
        text = " ".join(capsys.readouterr().out.split())
        assert "JSON and NumPy files, recorded dataset (MCAP), training store (Arrow) or vision2tactile folders" in text
        assert ("{jsonnpy,vision2tactile,npz,rosbag2}" in text) == (action == "export"), action


def test_a_path_of_no_format_is_refused_with_the_list(tmp_path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    for path in (tmp_path, tmp_path / "notes.txt"):
        assert not is_sample_set(path)
        with pytest.raises(FileError, match=r"is not a dataset: no recorded dataset \(MCAP\), training store"):
            open_samples(path)
    with pytest.raises(FileError, match="does not exist"):
        export_samples(tmp_path / "absent", tmp_path / "out", "npz")
    with pytest.raises(FileError, match="is not a dataset"):
        build_store([tmp_path], tmp_path / "store")


def test_every_module_of_the_table_supports_what_its_line_declares() -> None:
    import importlib

    from foretouch.dataset.samples import DatasetFormat

    for entry in formats.FORMATS:
        functions = importlib.import_module(entry.module).DATASET_FORMAT
        missing = DatasetFormat()
        assert isinstance(functions, DatasetFormat)
        assert entry.readable == (functions.open is not missing.open) == (functions.recognise is not missing.recognise)
        assert entry.exported == (functions.export is not missing.export)
