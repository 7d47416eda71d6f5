# SPDX-License-Identifier: Apache-2.0
"""A new experiment is one module: in this package, or in a user's own, such as `own_experiments.counting`."""

import os
import subprocess
import sys

import own_experiments
import pytest

import foretouch_lab.experiments
from foretouch.errors import ConfigError
from foretouch_lab.experiments import find_experiment, list_experiments


def test_a_module_of_ones_own_or_in_the_package(monkeypatch) -> None:
    with pytest.raises(ConfigError, match=r"is not one of own_experiments\.counting:counting"):
        find_experiment("own_experiments.counting:rubber")
    paths = [*foretouch_lab.experiments.__path__, *own_experiments.__path__]
    monkeypatch.setattr(foretouch_lab.experiments, "__path__", paths)
    assert find_experiment("counting").module == "foretouch_lab.experiments.counting"  # also as a module of the package
    monkeypatch.delitem(sys.modules, "foretouch_lab.experiments.counting")


def test_a_file_or_an_unknown_module_is_refused_with_what_is_asked_for(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo.yaml")
    for name in ("./fifo.yaml", "..", "a..b", "/lab/mine.yaml"):
        with pytest.raises(ConfigError, match="is no name of a module: give a name of `foretouch experiment list`"):
            find_experiment(name)
    with pytest.raises(
        ConfigError, match=r"fifo\.yaml: No module named 'fifo': give a name of `foretouch experiment list`"
    ):
        find_experiment("fifo.yaml")


def test_every_experiment_is_found_by_its_name_without_matplotlib() -> None:
    for experiment in list_experiments():
        assert find_experiment(experiment.name) is experiment
        assert find_experiment(f"{experiment.module}:{experiment.name}") is experiment
    for name in ("framework", "shared"):
        with pytest.raises(ConfigError, match=f"{name!r} is not one of label_ratio, leaderboard"):
            find_experiment(name)
    code = "import sys, foretouch_lab.experiments as e; e.list_experiments(); sys.exit('matplotlib' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
