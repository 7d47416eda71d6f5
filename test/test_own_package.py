# SPDX-License-Identifier: Apache-2.0
"""The package of the page *A package of your own*, installed as it stands there: each of its parts works."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tomllib
from installed_package import install

import foretouch as ft

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"```(toml|python)\n# (\S+)\n(.*?)```", re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A folder with the package, as pip leaves it."""
    text = (ROOT / "docs" / "own_package.md").read_text(encoding="utf-8")
    files = {name: code for _, name, code in BLOCK.findall(text)}
    project = tomllib.loads(files.pop("pyproject.toml"))["project"]
    folder = tmp_path_factory.mktemp("own") / "site"
    install(folder, project["entry-points"], name=project["name"].replace("-", "_"))
    (folder / "my_package").mkdir()
    for name, code in {**files, "my_package/__init__.py": ""}.items():
        (folder / name).write_text(code, encoding="utf-8")
    assert len(files) == 4
    return folder


def foretouch(site: Path, *words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "foretouch", *map(str, words)],
        env={**os.environ, "PYTHONPATH": f"{site}:{os.environ.get('PYTHONPATH', '')}"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_command_runs_and_is_listed(site, tmp_path) -> None:
    (tmp_path / "one").touch()
    assert foretouch(site, "count", tmp_path).stdout == "1 files\n"
    assert json.loads(foretouch(site, "count", tmp_path, "--json").stdout)["files"] == 1
    assert "Count the files of a folder" in foretouch(site, "--help").stdout


def test_the_format_is_read(site, tmp_path, monkeypatch) -> None:
    for name in ("can-1", "mug-1", "mug-2"):
        np.savetxt(tmp_path / f"{name}.reading", np.full(50, 3000.0))
    done = foretouch(site, "dataset", "info", tmp_path, "--json")
    facts = json.loads(done.stdout)
    assert (facts["kind"], facts["objects"], facts["labelled"]) == ("readings", {"can": 1, "mug": 2}, 3), done.stderr
    monkeypatch.syspath_prepend(site)
    assert [sample.id for sample in ft.open(tmp_path)] == ["can/1", "mug/1", "mug/2"]


@pytest.mark.ros
@pytest.mark.slow
def test_the_source_is_shown_by_the_node(site, tmp_path) -> None:
    pytest.importorskip("foretouch_msgs.msg", reason="foretouch_msgs is not installed")
    shutil.copy(ROOT / "examples/data/table_depth.npz", tmp_path / "table.depth")
    done = foretouch(site, "run", "--source", tmp_path / "table.depth", "--count", 3, "--json")
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert (done.returncode, len(answers) >= 3) == (0, True), done.stderr
    absent = foretouch(site, "run", "--source", "tabel.depth")
    assert (absent.returncode, absent.stderr) == (1, "foretouch: tabel.depth: does not exist\n")
