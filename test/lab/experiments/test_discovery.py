# SPDX-License-Identifier: Apache-2.0
"""A new experiment is one module: in this package, or in a user's own, such as `own_experiments.counting`."""

import json
import subprocess
import sys
from pathlib import Path

import own_experiments
import pytest

import foretouch_lab.experiments
from foretouch.cli.main import main
from foretouch.errors import ConfigError
from foretouch_lab.experiments import find_experiment, list_experiments


@pytest.mark.usefixtures("in_this_process")
def test_a_module_of_ones_own_or_in_the_package(tmp_path: Path, capsys, numbers: Path, monkeypatch) -> None:
    words = ["experiment", "own_experiments.counting", "--preset", "smoke", "--data", str(numbers), "--json"]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["rows"] == 4
    assert (tmp_path / "out/results.csv").read_text().startswith("number,value,empty\n0,")
    summary = (tmp_path / "out/summary.md").read_text()
    assert summary.startswith(
        "# How far can one count?\n\n`foretouch experiment counting --preset smoke`; foretouch 0."
    )
    assert summary.endswith("## counted\n\n| number |\n| --- |\n| 0 |\n| 0 |\n| 1 |\n| 1 |\n")
    with pytest.raises(ConfigError, match=r"is not one of own_experiments\.counting:counting"):
        find_experiment("own_experiments.counting:rubber")
    paths = [*foretouch_lab.experiments.__path__, *own_experiments.__path__]
    monkeypatch.setattr(foretouch_lab.experiments, "__path__", paths)
    assert find_experiment("counting").module == "foretouch_lab.experiments.counting"  # also as a module of the package
    monkeypatch.delitem(sys.modules, "foretouch_lab.experiments.counting")


def test_every_experiment_is_found_by_its_name_without_matplotlib() -> None:
    for experiment in list_experiments():
        assert find_experiment(experiment.name) is experiment
        assert find_experiment(f"{experiment.module}:{experiment.name}") is experiment
    for name in ("framework", "shared"):
        with pytest.raises(ConfigError, match=f"{name!r} is not one of cross_validation, label_ratio"):
            find_experiment(name)
    code = "import sys, foretouch_lab.experiments as e; e.list_experiments(); sys.exit('matplotlib' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
