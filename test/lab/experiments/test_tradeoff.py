# SPDX-License-Identifier: Apache-2.0
"""An area of one's own, measured from skill to picture; resumed, timed again, redrawn and refused."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case

from foretouch.cli.main import main
from foretouch.errors import ConfigError
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.manifest import read_results
from foretouch_lab.experiments.framework.tradeoff import Panel, find_area, frontier, frontier_tables, list_areas
from foretouch_lab.experiments.shared.scores import equal_columns
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig

SOURCE = """
import math
import time
from hashlib import sha256

import numpy as np

from foretouch.errors import MissingDependencyError
from foretouch_lab.experiments import Cell
from foretouch_lab.experiments.framework.tradeoff import Area, Panel, TradeoffSettings, Variant

TERMS = {"shipped": 8, "short": 2, "long": 12, "slow and bad": 1}


class Words:
    def __init__(self, path):
        self.sha256 = sha256(path.read_bytes()).hexdigest()


def variants(settings):
    made = [Variant(name, "shipped" if name == "shipped" else "terms", {"terms": n}) for name, n in TERMS.items()]
    return [*made, Variant("other library", "library", {})]


def series(terms):
    return 4.0 * sum((-1.0) ** k / (2 * k + 1) for k in range(terms))


def timed(variant, settings, data):
    if variant.factor == "library":
        raise MissingDependencyError("fast_pi is not installed")
    terms = variant.values["terms"]
    naps = 2e-3 if variant.name == "slow and bad" else 1e-4 * terms

    def answer(count):
        end = time.thread_time() + naps
        while time.thread_time() < end:
            pass
        return np.full(count, series(terms))

    return answer, 1.0


EXPERIMENT = Area(
    name="pi",
    question="How many digits in a millisecond?",
    module=__name__,
    settings=TradeoffSettings,
    presets={"small": {"timing_s": 0.3, "requests": [1, 3], "pause_s": 0.001}, "full": {}},
    load=lambda settings, path: Words(path),
    cells=lambda settings, data: [Cell(name.replace(" ", "_"), {"variant": name}) for name in TERMS],
    run=lambda cell, settings, data: [{"skill": 1.0 - abs(series(TERMS[cell.values["variant"]]) - math.pi)}],
    tabulate=lambda settings, rows: [{"skill_low": None, "skill_high": None, **row} for row in rows],
    variants=variants,
    timed=timed,
    skills={"skill": "closeness to pi"},
    panels=(Panel("skill", 1, "One number"),),
)
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_this_process: None) -> Path:
    (tmp_path / "pi_lab").mkdir()
    (tmp_path / "pi_lab/__init__.py").touch()
    (tmp_path / "pi_lab/pi.py").write_text(SOURCE)
    (tmp_path / "data.txt").write_text("3")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.fixture
def run(lab: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs the command: exit status, and the last line on stdout as JSON, or what is on stderr."""

    def command(*words: str) -> tuple[int, dict[str, object] | str]:
        for name in ("pi_lab", "pi_lab.pi"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        head = ["tradeoff", "pi_lab.pi", "-o", str(lab / "out"), "--data", str(lab / "data.txt"), "--workers", "1"]
        status = main([*head, "--json", *words])
        printed = capsys.readouterr()
        return status, json.loads(printed.out.splitlines()[-1]) if printed.out else printed.err

    return command


def test_an_area_gives_table_and_picture(lab: Path, run) -> None:
    status, last = run()
    assert (status, last["cells"]) == (0, 4)
    assert last["frontier"] == {"One number": ["short", "shipped", "long"]}
    assert last["skipped"] == {"other library": "fast_pi is not installed"}
    *rows, other = read_results(lab / "out/tradeoff.csv")
    assert {(row["variant"], row["request"]) for row in rows} == {(v, n) for v in (
        "shipped", "short", "long", "slow and bad") for n in (1, 3)}  # fmt: skip
    assert (other["variant"], other["request"], other["ms_p50"]) == ("other library", None, None)
    for row in rows:
        assert row["ms_p50"] <= row["ms_p95"] <= row["ms_p99"]
        assert row["calls"] >= 5
        assert row["state"] in ("idle", "loaded")
    short, long = (next(row for row in rows if row["variant"] == one) for one in ("short", "long"))
    assert long["cpu_ms"] / short["cpu_ms"] == pytest.approx(6.0, rel=0.3)
    summary = (lab / "out/summary.md").read_text()
    for text in (
        "| short | ", "| shipped * | ", "| long | ", "Skipped: other library: fast_pi is not installed.", "other processes used",
    ):  # fmt: skip
        assert text in summary
    assert (lab / "out/tradeoff.png").stat().st_size > 10_000


def test_skills_are_kept_and_times_are_measured_again(lab: Path, run) -> None:
    assert run()[0] == 0
    table = lab / "out/tradeoff.csv"
    first = table.read_text()
    status, message = run()
    assert status == 1
    assert "--resume" in message
    assert run("--resume")[1]["reused"] == 4  # no cell was run
    summary = lab / "out/summary.md"
    origin = summary.read_text().splitlines()[2]
    assert origin.startswith("`foretouch tradeoff pi --preset small`; foretouch ")
    shutil.rmtree(lab / "out/cells")  # as published results are
    (lab / "out/manifest.json").unlink()
    again = table.read_text()
    assert again != first
    assert run("--redraw")[1]["figures"] == ["tradeoff.png"]
    assert summary.read_text().splitlines()[2] == origin
    assert table.read_text() == again
    assert {row["skill"] for row in read_results(table) if row["variant"] == "short"} == {0.52507}


def test_a_wrong_area_is_refused(lab: Path, run) -> None:
    (lab / "pi_lab/pi.py").write_text(SOURCE.replace("return [*made,", "return [*made, *made,"))
    status, message = run("--resume")
    assert status == 1
    assert "occurs twice" in message


def test_areas_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    areas = list_areas()
    assert [one.area for one in areas] == ["model", "perception", "simulation", "training"]

    def check(area, preset: str) -> None:
        assert find_area(area.area) is area
        assert [one for one in area.variants(area.resolve(preset, {})) if one.factor == "shipped"]

    every_case({f"{one.area} {preset}": (one, preset) for one in areas for preset in one.presets}, check)
    with pytest.raises(ConfigError, match=r"'nothing' is not one of model, perception"):
        find_area("nothing")
    assert main(["tradeoff", "list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[0])["name"] == "model"


def test_of_variants_that_do_not_differ_significantly_the_fastest_is_on_the_frontier() -> None:
    errors = np.array([[100.0] * 8, [60.0] * 8, [57.0, 62.0] * 4, [20.0] * 8, [19.0, 21.1] * 4])  # of each object
    names = ("mean", "quick", "slow", "best", "fast")
    made = {
        name: [
            {"object": str(k), "count": 1, "squared": [one] * 50, "reference": [100.0] * 50, "part": "all", "seed": 0}
            for k, one in enumerate(own)
        ]
        for name, own in zip(names, errors, strict=True)
    }
    found = equal_columns("skill", made, BootstrapConfig(draws=500))
    equals = {name: row["skill_equals"] for name, row in found.items()}
    assert equals == {"mean": "mean", "quick": "slow", "slow": "slow", "best": "best", "fast": "best"}
    assert found["slow"]["skill_behind"] == pytest.approx(-0.395)
    assert found["slow"]["skill_behind_low"] < -0.395 < found["slow"]["skill_behind_high"] < 0.0
    rows: list[Row] = [
        {"variant": name, "ms_p50": ms, "cpu_ms": ms, "state": "idle", "request": 1, "factor": "", "ms_p95": ms,
         "ms_p99": ms, "skill": 1.0 - own.mean() / 100.0, **found[name]}
        for name, own, ms in zip(names, errors, (1.0, 2.0, 3.0, 5.0, 4.0), strict=True)
    ]  # fmt: skip
    assert [row["variant"] for row in frontier(rows, "skill")] == ["mean", "quick", "fast"]
    (told,) = frontier_tables([Panel("skill", 1, "All")], rows)
    assert [line[0] for line in told.rows] == ["mean", "quick", "fast"]


def test_of_a_table_of_both_states_of_the_machine_the_idle_one_counts() -> None:
    folder = Path(__file__).parents[3] / "docs/results/tradeoff/model"
    rows, area = read_results(folder / "tradeoff.csv"), find_area("model")
    assert {row["state"] for row in rows} == {"idle", "loaded"}
    (note,) = area.tables(rows)[0].notes
    assert note.startswith("In 10 ms you get the default model")
    assert note in (folder / "summary.md").read_text()


def test_the_frontier_holds_what_nothing_beats() -> None:
    points = [("a", 1.0, 0.1), ("b", 2.0, 0.3), ("c", 3.0, 0.3), ("d", 4.0, 0.2), ("e", 5.0, 0.9), ("f", 0.5, None)]
    rows: list[Row] = [{"variant": n, "ms_p50": t, "cpu_ms": t, "state": "idle", "skill": s} for n, t, s in points]
    assert [row["variant"] for row in frontier(rows, "skill")] == ["a", "b", "e"]
