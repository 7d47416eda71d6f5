# SPDX-License-Identifier: Apache-2.0
"""An area of one's own, measured from skill to picture; resumed, timed again, redrawn and refused."""

import json
import shutil
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from foretouch.cli.main import main
from foretouch.errors import ConfigError
from foretouch.experiments.framework import sweep
from foretouch.experiments.framework.executors import CellResult, run_cell
from foretouch.experiments.framework.manifest import read_results
from foretouch.timing import MachineLoad
from foretouch.tradeoff.area import area_names, find_area
from foretouch.tradeoff.frontier import frontier
from foretouch.tradeoff.picture import spread
from foretouch.tradeoff.timing import peak_memory_mb

SOURCE = """
import math
import time
from hashlib import sha256

import numpy as np

from foretouch.experiments import Cell
from foretouch.tradeoff.area import Area, Panel, Timed, TradeoffSettings, Variant

TERMS = {"shipped": 8, "short": 2, "long": 12, "slow and bad": 1}


class Words:
    def __init__(self, path):
        self.sha256 = sha256(path.read_bytes()).hexdigest()


def variants(settings):
    made = [Variant(name, "shipped" if name == "shipped" else "terms", {"terms": n}) for name, n in TERMS.items()]
    return [*made, Variant("other library", "library", missing="fast_pi is not installed")]


def series(terms):
    return 4.0 * sum((-1.0) ** k / (2 * k + 1) for k in range(terms))


def timed(variant, settings, data):
    terms = variant.values["terms"]
    naps = 2e-3 if variant.name == "slow and bad" else 1e-4 * terms

    def answer(count):
        end = time.thread_time() + naps
        while time.thread_time() < end:
            pass
        return np.full(count, series(terms))

    return Timed(answer, 0.001 * terms)


EXPERIMENT = Area(
    name="pi",
    question="How many digits in a millisecond?",
    module=__name__,
    settings=TradeoffSettings,
    presets={"small": {"timing_s": 0.3, "requests": [1, 3]}, "full": {}},
    load=lambda settings, path: Words(path),
    cells=lambda settings, data: [Cell(name.replace(" ", "_"), {"variant": name}) for name in TERMS],
    run=lambda cell, settings, data: [{"skill": 1.0 - abs(series(TERMS[cell.values["variant"]]) - math.pi)}],
    tabulate=lambda settings, rows: [{"skill_low": None, "skill_high": None, **row} for row in rows],
    summarise=lambda rows: (),
    variants=variants,
    timed=timed,
    shipped="shipped",
    reference="long",
    skills={"skill": "closeness to pi"},
    panels=(Panel("skill", 1, "One number"),),
    unit="units",
    seconds=lambda settings, data, cells: 100.0 * len(cells),
)
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "pi_lab").mkdir()
    (tmp_path / "pi_lab/__init__.py").touch()
    (tmp_path / "pi_lab/pi.py").write_text(SOURCE)
    (tmp_path / "data.txt").write_text("3")
    for name in ("pi_lab", "pi_lab.pi"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sweep, "in_processes", lambda job, cells, workers: (run_cell(job, cell) for cell in cells))
    return tmp_path


def words(lab: Path, *more: str) -> list[str]:
    return ["tradeoff", "pi_lab.pi", "-o", str(lab / "out"), "--data", str(lab / "data.txt"), "--workers", "1", *more]


def test_an_area_gives_table_picture_and_sentences(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(lab, "--json")) == 0
    *cells, last = map(json.loads, capsys.readouterr().out.splitlines())
    assert [cell["status"] for cell in cells] == ["done"] * 4
    assert last["frontier"] == {"One number": ["short", "shipped", "long"]}
    assert last["skipped"] == {"other library": "fast_pi is not installed"}
    rows = read_results(lab / "out/tradeoff.csv")
    assert {(row["variant"], row["request"]) for row in rows} == {(v, n) for v in (
        "shipped", "short", "long", "slow and bad") for n in (1, 3)}  # fmt: skip
    for row in rows:
        assert row["ms_p50"] <= row["ms_p95"] <= row["ms_p99"]
        assert row["calls"] >= 5
        assert row["state"] in ("idle", "loaded")
        assert row["size_mb"] > 0.0
    (short,) = (row for row in rows if row["variant"] == "short" and row["request"] == 1)
    assert short["ratio"] == pytest.approx(6.0, rel=0.3)  # to the reference in the same run
    assert short["difference"] == pytest.approx(0.350, abs=0.001)  # of its answers to those of the shipped one
    summary = (lab / "out/summary.md").read_text()
    for text in (
        "Most skilful: long", "Fastest: short", "shipped (shipped) is on the frontier",
        "Skipped: other library: fast_pi is not installed.", "other processes used",
    ):  # fmt: skip
        assert text in summary
    assert (lab / "out/tradeoff.png").stat().st_size > 10_000


def test_skills_are_kept_and_times_are_measured_again(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(lab)) == 0
    first = (lab / "out/tradeoff.csv").read_text()
    capsys.readouterr()
    assert main(words(lab)) == 1
    assert "--resume" in capsys.readouterr().err
    assert main(words(lab, "--resume", "--json")) == 0
    assert json.loads(capsys.readouterr().out)["reused"] == 4  # no cell was run
    shutil.rmtree(lab / "out/cells")  # as published results are
    assert main(words(lab, "--times", "--json")) == 0
    assert json.loads(capsys.readouterr().out)["cells"] == 0
    again = (lab / "out/tradeoff.csv").read_text()
    assert again != first
    assert main(words(lab, "--redraw", "--json")) == 0
    assert (lab / "out/tradeoff.csv").read_text() == again


def test_runs_of_an_idle_and_a_loaded_machine_are_kept_apart(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for state in ("loaded", "idle", "loaded"):
        row = {"state": state, "other_cores": 0.0, "load_before": 0.0, "load_after": 0.0}
        monkeypatch.setattr(MachineLoad, "row", lambda self, row=row: row)
        assert main(words(lab, "--resume")) == 0
    states = [row["state"] for row in read_results(lab / "out/tradeoff.csv")]
    assert states == ["loaded"] * 8 + ["idle"] * 8
    assert ", idle: " in (lab / "out/summary.md").read_text()  # which the picture shows


def test_full_says_beforehand_how_long_it_takes(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(lab, "--preset", "full", "timing_s=0.1", "--json")) == 0
    assert capsys.readouterr().err == "about 7 minutes with 1 processes\n"


def test_the_data_are_read_once(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For the estimate, the skills and the times; each process of cells reads them for itself."""
    assert find_area("pi_lab.pi")
    words_of, readings = sys.modules["pi_lab.pi"].Words, []
    original = words_of.__init__
    monkeypatch.setattr(words_of, "__init__", lambda self, path: readings.append(path) or original(self, path))
    monkeypatch.setattr(sweep, "in_processes", lambda job, cells, workers: (CellResult(cell, []) for cell in cells))
    assert main(words(lab, "--preset", "full", "timing_s=0.1", "--json")) == 0
    assert len(readings) == 1


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ('shipped="shipped"', 'shipped="absent"', "variants: 'absent' is absent"),
        ("return [*made,", "return [*made, *made,", "occurs twice"),
        ("return [*made,", 'return [*(Variant(f"v{k}", "x") for k in range(121)), *made,', "126 exceeds 120"),
        ('{"variant": name})', '{"variant": name, "trains": 7})', "28 trainings exceed 25"),
    ],
)
def test_a_wrong_area_is_refused(lab: Path, old: str, new: str, error: str, capsys: pytest.CaptureFixture[str]) -> None:
    (lab / "pi_lab/pi.py").write_text(SOURCE.replace(old, new))
    assert main(words(lab)) == 1
    assert error in capsys.readouterr().err


def test_areas_of_the_package() -> None:
    assert "model" in area_names()
    for name in area_names():
        area = find_area(name)
        assert area.name == name
        for preset in area.presets:
            variants = area.checked_variants(area.resolve(preset, {}))
            assert [one for one in variants if one.factor == "shipped"]
    with pytest.raises(ConfigError, match=r"'nothing' is none of .*model"):
        find_area("nothing")


def test_the_frontier_holds_what_nothing_beats() -> None:
    points = [("a", 1.0, 0.1), ("b", 2.0, 0.3), ("c", 3.0, 0.3), ("d", 4.0, 0.2), ("e", 5.0, 0.9), ("f", 0.5, None)]
    rows = [{"variant": n, "ms_p50": t, "cpu_ms": t, "state": "idle", "skill": s} for n, t, s in points]
    assert [row["variant"] for row in frontier(rows, "skill")] == ["a", "b", "e"]


@pytest.mark.parametrize("wanted", [[0.1, 0.5, 0.9], [0.5, 0.5, 0.51, 0.52], [0.97, 0.98, 1.0], [0.3]])
def test_labels_do_not_overlap(wanted: list[float]) -> None:
    places = spread(wanted, 0.05)
    assert all(b - a >= 0.05 - 1e-9 for a, b in pairwise(places))
    assert max(places) <= 1.0 + 1e-9


def test_peak_memory_is_that_of_the_call() -> None:
    used = peak_memory_mb(lambda: bytearray(30_000_000))
    assert used is None or 25.0 < used < 40.0
