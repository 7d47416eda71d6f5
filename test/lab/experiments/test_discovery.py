# SPDX-License-Identifier: Apache-2.0
"""A new experiment is one module: in this package, or in a user's own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import foretouch_lab.experiments
from foretouch.cli.main import main
from foretouch.errors import ConfigError
from foretouch_lab.experiments import find_experiment, list_experiments

SOURCE = """
from dataclasses import dataclass
from hashlib import sha256

from foretouch.config import Settings, setting
from foretouch_lab.experiments import Cell, Experiment, Table
from foretouch.report.panels import new_figure, save


@dataclass(frozen=True, kw_only=True)
class StiffnessSettings(Settings):
    cells: int = setting(3, "Number of cells", minimum=1)


@dataclass(frozen=True)
class Words:
    text: str

    @property
    def sha256(self):
        return sha256(self.text.encode()).hexdigest()


def draw(rows, folder):
    figure = new_figure(4.0, 3.0)
    figure.subplots().plot([row["number"] for row in rows], [row["length"] for row in rows])
    return [save(figure, folder / "stiffness.png")]


EXPERIMENT = Experiment(
    name="stiffness",
    question="How stiff is it?",
    module=__name__,
    settings=StiffnessSettings,
    presets={"full": {}},
    load=lambda settings, path: Words(path.read_text()),
    cells=lambda settings, data: [Cell(f"cell{k}", {"number": k}) for k in range(settings.cells)],
    run=lambda cell, settings, data: [{"length": len(data.text) * cell.values["number"]}],
    tabulate=lambda settings, rows: list(rows),
    summarise=lambda rows: [Table("stiffness", ["length"], [[str(row["length"])] for row in rows])],
    figure=draw,
)
"""


@pytest.mark.usefixtures("in_this_process")
def test_a_module_of_ones_own_or_in_the_package(tmp_path: Path, capsys, numbers: Path, monkeypatch) -> None:
    folder, out = tmp_path / "my_lab", tmp_path / "out"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "stiffness.py").write_text(SOURCE)
    for name in ("my_lab", "my_lab.stiffness", "foretouch_lab.experiments.stiffness"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["experiment", "my_lab.stiffness", "-o", str(out), "--data", str(numbers), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["figures"] == ["stiffness.png"]
    assert (out / "results.csv").read_text() == "number,length\n0,0\n1,6\n2,12\n"
    summary = (out / "summary.md").read_text()
    assert summary.startswith("# How stiff is it?\n\n`foretouch experiment stiffness --preset full`; foretouch 0.")
    assert summary.endswith("## stiffness\n\n| length |\n| --- |\n| 0 |\n| 6 |\n| 12 |\n")
    assert (out / "stiffness.png").stat().st_size > 5000
    with pytest.raises(ConfigError, match=r"is not one of my_lab\.stiffness:stiffness"):
        find_experiment("my_lab.stiffness:rubber")
    monkeypatch.setattr(foretouch_lab.experiments, "__path__", [*foretouch_lab.experiments.__path__, str(folder)])
    assert "stiffness" in [one.name for one in list_experiments()]  # also as a module of the package
    assert find_experiment("stiffness").module == "foretouch_lab.experiments.stiffness"


def test_every_experiment_is_found_by_its_name_without_matplotlib() -> None:
    for one in list_experiments():
        assert find_experiment(one.name) is one
        assert find_experiment(f"{one.module}:{one.name}") is one
    for name in ("framework", "shared"):
        with pytest.raises(ConfigError, match=f"{name!r} is not one of prequential, cross_validation, time_blocked"):
            find_experiment(name)
    code = "import sys, foretouch_lab.experiments as e; e.list_experiments(); sys.exit('matplotlib' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
