# SPDX-License-Identifier: Apache-2.0
"""A format of another package is one module and one entry point: every command and reader then supports it."""

import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from installed_package import install
from recording_builders import record, write_dataset

from foretouch.dataset import formats
from foretouch.dataset.samples import SampleSet
from foretouch.dataset.source import open_source
from foretouch.dataset.store import Store
from foretouch.types import Sample


def _open(path, unfinished) -> SampleSet:
    files = sorted(path.glob("*.number"))

    def read(k: int) -> Sample:
        one = record(int(files[k].read_text()))
        return replace(one, id=f"ball/{k + 1:06d}")

    return SampleSet(path=path, kind="numbers", size=len(files), read=read, name=lambda k: str(files[k]))


def _export(samples, out, result, progress) -> None:
    out.mkdir()
    for k, _ in enumerate(samples):
        (out / f"{k:03d}.number").write_text(str(k))
        result.samples += 1
        progress()


@pytest.fixture
def numbers(monkeypatch, tmp_path) -> None:
    """A format of files with the number of a record each: its module and its line."""
    module = ModuleType("numbers_format")
    module.__dict__.update(recognise=lambda path: any(path.glob("*.number")), open_set=_open, export=_export)
    module.ENTRY = formats.FormatEntry("files of numbers", module.__name__, (), ("*.number",), exported=True)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    install(tmp_path / "site", {"foretouch.formats": {"numbers": f"{module.__name__}:ENTRY"}})
    monkeypatch.syspath_prepend(tmp_path / "site")


@pytest.mark.usefixtures("numbers")
def test_a_new_format_is_read_built_exported_imported_and_listed(tmp_path, call) -> None:
    write_dataset(tmp_path / "ds", 3)
    out = tmp_path / "pairs"
    exported = call("dataset", "export", tmp_path / "ds", "-o", out, "--format", "numbers", "--json")
    assert (exported.status, exported.records[0]["samples"]) == (0, 3)
    (info,) = call("dataset", "info", out, "--json").records
    assert (info["kind"], info["samples"], info["objects"]) == ("numbers", 3, {"ball": 3})
    assert call("dataset", "build", out, "-o", tmp_path / "store", "--json").records[0]["samples"] == 3
    np.testing.assert_array_equal(Store(tmp_path / "store")[2].cloud.xyz, record(2).cloud.xyz)
    imported = call("dataset", "import", out, "-o", tmp_path / "again").out
    assert "│ notes    │ equal_stamps: 3 samples" in imported
    source = open_source(out)
    assert source.kind == "samples"
    assert [item.sample.id for item in source if item.sample] == ["ball/000001", "ball/000002", "ball/000003"]
