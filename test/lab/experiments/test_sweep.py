# SPDX-License-Identifier: Apache-2.0
"""Sweeps: what is finished stays finished, whatever is killed; what changed is refused by name."""

import hashlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from every_case import every_case, every_refusal
from own_experiments.counting import EXPERIMENT, CountingSettings

from foretouch.errors import ConfigError, DatasetError, FileError, ForetouchError
from foretouch_lab.experiments import Cell, Sweep
from foretouch_lab.experiments.framework.manifest import read_results, write_results, write_summary
from foretouch_lab.experiments.framework.sweep import run_cell

TESTS = Path(__file__).parents[2]
PATH = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])  # where workers find `own_experiments`


@pytest.fixture
def sweep(tmp_path: Path, numbers: Path):
    """Runs the experiment `counting` into a folder."""

    def run(name: str = "out", settings=None, resume: bool = False, **options):
        given = CountingSettings(**settings or {})
        result = Sweep(EXPERIMENT, given, tmp_path / name, source=numbers, resume=resume)
        result.run(**options)
        result.finish()
        return result

    return run


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


def starts(trace: Path) -> dict[str, int]:
    names = [path.name.split(".")[0] for path in trace.iterdir()]
    return {name: names.count(name) for name in sorted(names)}


def test_table_manifest_and_cells(sweep, out) -> None:
    reported = []
    result = sweep(workers=2, progress=lambda key, _seconds, _error, *counts: reported.append((key, *counts)))
    assert [row["number"] for row in result.rows] == [k for k in range(6) for _ in range(2)]
    assert read_results(out / "results.csv") == result.rows
    assert sorted(key for key, *_ in reported) == [f"cell{k}" for k in range(6)]
    assert [one[1:] for one in reported] == [(k + 1, 6) for k in range(6)]
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["experiment"] == "counting"
    assert manifest["settings"] == CountingSettings().to_mapping()
    assert manifest["data"] == {"sha256": result.data_sha256}
    assert manifest["cells"] == {"all": 6, "finished": 6, "failed": {}}
    (session,) = manifest["sessions"]
    assert {"foretouch", "git", "python", "platform", "cpu", "workers"} <= set(session)
    assert str(out.parent) not in (out / "manifest.json").read_text()


def test_killed_and_resumed_equals_uninterrupted(sweep, tmp_path, numbers, trace, in_this_process) -> None:
    words = [sys.executable, "-m", "foretouch.cli.main", "experiment", "own_experiments.counting", "--json"]
    words += ["-o", f"{tmp_path}/cut", "--data", str(numbers), "--workers", "1", "cells=4", "pause_s=0.3"]
    words.append(f"trace={trace}")
    environment = {**os.environ, "PYTHONPATH": PATH}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment, start_new_session=True) as process:
        assert [json.loads(process.stdout.readline())["status"] for _ in range(2)] == ["done", "done"]
        os.killpg(process.pid, signal.SIGKILL)
    done = {path.stem for path in (tmp_path / "cut/cells").iterdir() if path.suffix == ".json"}
    assert {"cell0", "cell1"} <= done < {f"cell{k}" for k in range(4)}
    settings = {"cells": 4, "pause_s": 0.3, "trace": str(trace)}
    result = sweep("cut", settings=settings, resume=True)
    assert result.reused == len(done)
    assert all(starts(trace)[key[4:]] == 1 for key in done)
    sweep("whole", settings=settings)
    assert (tmp_path / "cut/results.csv").read_bytes() == (tmp_path / "whole/results.csv").read_bytes()
    assert len(json.loads((tmp_path / "cut/manifest.json").read_text())["sessions"]) == 2


def test_failures_are_named_and_the_others_go_on(sweep, out, trace) -> None:
    hurt = {
        "cells": 4,
        "broken": (2,),
        "dies": (0,),
        "dies_once": (3,),
        "trace": str(trace),
    }  # the last two never at a time
    result = sweep(settings=hurt, workers=2)
    assert result.failures == {"cell2": "cell 2: is broken", "cell0": "its process died (killed, or out of memory)"}
    assert sorted({row["number"] for row in result.rows}) == [1, 3]
    assert json.loads((out / "manifest.json").read_text())["cells"]["failed"] == result.failures


def test_what_changed_is_refused_by_name(sweep, out, numbers, in_this_process) -> None:
    sweep(settings={"cells": 2})
    with pytest.raises(FileError, match="--resume continues"):
        sweep(settings={"cells": 2})
    with pytest.raises(ConfigError, match=r"settings\.pause_s: 0\.0 is not 0\.1; a sweep is resumed with"):
        sweep(settings={"cells": 2, "pause_s": 0.1}, resume=True)
    before = (out / "results.csv").read_bytes()
    numbers.write_text("1 2.6\n")
    with pytest.raises(ConfigError, match=r"data\.sha256"):
        sweep(settings={"cells": 2}, resume=True)
    assert (out / "results.csv").read_bytes() == before
    with pytest.raises(ConfigError, match="preset: 'quick' is not one of full, smoke"):
        EXPERIMENT.resolve("quick", {})
    with pytest.raises(ConfigError, match="paus: unknown setting; known: cells"):
        EXPERIMENT.resolve("full", {"paus": 1})
    text = json.dumps(CountingSettings().to_mapping())
    with pytest.raises(DatasetError, match="with which the sweep started"):
        run_cell("own_experiments.counting", text, str(numbers), "0" * 64, Cell("cell0", {"number": 0}))


def test_more_cells_keep_those_that_are_finished(sweep, out, trace, in_this_process) -> None:
    hurt = {"trace": str(trace), "broken": (1,)}
    sweep(settings={"cells": 3, **hurt})
    more = sweep(settings={"cells": 5, **hurt}, resume=True)
    assert (more.reused, more.finished, len(more.rows)) == (2, 4, 8)
    fewer = sweep(settings={"cells": 3, "shown": 1, **hurt}, resume=True)
    assert (fewer.reused, len(fewer.cells), len(fewer.rows)) == (2, 3, 1)
    assert json.loads((out / "manifest.json").read_text())["settings"]["cells"] == 3


def test_folders_of_something_else_are_left_alone(sweep, tmp_path, in_this_process) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/precious").touch()
    for resume in (False, True):
        with pytest.raises(FileError, match="already exists"):
            sweep(resume=resume)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["precious"]
    sweep("new", settings={"cells": 1}, resume=True)  # nothing there: it begins

    def check(text: str, rule: str) -> None:
        (tmp_path / "new/cells/cell0.json").write_text(text)
        with pytest.raises(FileError, match=rf"cell0.json: .*{rule}"):
            sweep("new", settings={"cells": 1}, resume=True)

    every_case(
        [("{", "is not JSON"), ("[" * 100_000 + "]" * 100_000, "nested levels"), ("[]", "is not a mapping")], check
    )


def test_a_damaged_manifest_is_refused_by_file_and_field(sweep, out, in_this_process) -> None:
    sweep(settings={"cells": 1})
    file = out / "manifest.json"
    whole = json.loads(file.read_text())

    def check(name: str, value: object) -> None:
        file.write_text(json.dumps({**whole, name: value}))
        with pytest.raises(ForetouchError, match=rf"manifest\.json: {name}[.:]"):
            sweep(settings={"cells": 1}, resume=True)

    every_case([("sessions", 5), ("experiment", 1)], check)


def test_results_are_rounded_and_read_back_as_they_were(tmp_path) -> None:
    rows = [
        {"a": 1, "b": 0.1 + 0.2, "c": None, "d": "x, y", "e": True},
        {"a": 1_562_000_000_123_456_789, "b": -1.23456e-9, "c": 123.456, "d": "z", "e": False},
    ]
    written = write_results(tmp_path, rows)
    assert [(row["b"], row["c"]) for row in written] == [(0.3, None), (-1.2346e-9, 123.46)]
    assert read_results(tmp_path / "results.csv") == written


def test_summary_states_how_results_were_made_also_without_the_manifest(sweep, out, numbers, in_this_process) -> None:
    result = sweep(settings={"cells": 2, "broken": (5,)})
    write_summary(out, EXPERIMENT, EXPERIMENT.tables(result.rows), result.origin())
    text = (out / "summary.md").read_text()
    assert "`foretouch experiment counting cells=2 'broken=[5]'`; foretouch" in text
    assert f"sha256 of the data `{hashlib.sha256(numbers.read_bytes()).hexdigest()[:16]}`" in text
    (out / "manifest.json").unlink()
    write_summary(out, EXPERIMENT, [])
    (title, _, origin, *rest) = (out / "summary.md").read_text().splitlines()
    assert text.startswith(f"{title}\n\n{origin}\n\n## counted")
    assert rest == []


@pytest.fixture
def ray():
    return pytest.importorskip("ray", reason="ray is not installed: pip install 'foretouch[sweep]'")


@pytest.mark.slow
@pytest.mark.timeout(600)  # starting nodes and processes takes a minute or two on a busy machine
def test_ray_gives_the_same_bits_and_outlives_a_node(ray_cluster, tmp_path, sweep, trace) -> None:
    lost = ray_cluster.add_node(num_cpus=1)
    settings = {"cells": 8, "pause_s": 1.0, "dies_once": (0,), "trace": str(trace)}
    seen = []

    def kill(key, *_) -> None:
        seen.append(key)
        if len(seen) == 2:
            ray_cluster.remove_node(lost, allow_graceful=False)

    result = sweep("ray", settings=settings, address=ray_cluster.address, progress=kill)
    assert result.failures == {}
    assert sorted(seen) == [f"cell{k}" for k in range(8)]
    assert sum(starts(trace).values()) <= 8 + 2  # cell 0, and at most the one that the lost node ran
    sweep("local", settings={**settings, "pause_s": 0.0})
    assert (tmp_path / "ray/results.csv").read_bytes() == (tmp_path / "local/results.csv").read_bytes()


def test_no_cluster_is_told_at_once(ray, sweep) -> None:
    addresses = ("127.0.0.1:1", "ray://127.0.0.1:1", "localhost:no")
    cases = [(f"--address: {addresse}: no cluster answers", addresse) for addresse in addresses]
    every_refusal(ConfigError, cases, lambda address: sweep(address=address, resume=True))
