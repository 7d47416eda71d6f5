# SPDX-License-Identifier: Apache-2.0
"""The guard of `make bench`: what it calls lost, that it measures again, and that that what it writes is read."""

from pathlib import Path

import pytest

from benchmarks.common import read_csv
from benchmarks.guard import bench, cases

CLOCK = [0.0]  # [s], which only jobs move


@pytest.fixture(autouse=True)
def few_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "_TURNS", 4)
    monkeypatch.setattr(bench.time, "process_time", lambda: CLOCK[0])


def busy(seconds: float):
    """A job that takes CPU time."""

    def job() -> None:
        CLOCK[0] += seconds

    return job


def made(ours_s: float, peer_s: float, name: str = "made") -> cases.Case:
    return cases.Case(name, "a slower one", lambda: (busy(ours_s), busy(peer_s)))


def test_a_ratio_of_cpu_times_that_stays_low_is_measured_again_and_lost(capsys: pytest.CaptureFixture[str]) -> None:
    runner = bench.Runner(made(0.002, 0.006))
    assert runner.measure().ratio == pytest.approx(3.0, rel=0.1)
    assert not bench.guard([runner], {"made": 5.0})
    assert capsys.readouterr().out.count("measured again") == bench.AGAIN
    assert bench.guard([runner], {})  # a new case is not lost
    answers = iter((2.0, 4.0))
    runner.measure = lambda: bench.Measured(next(answers), 1.0)  # low once only
    assert bench.guard([runner], {"made": 4.0})


def test_renewed_ratios_are_those_of_the_next_run(tmp_path: Path) -> None:
    path, names = tmp_path / "ratios.csv", [case.name for case in cases.all_cases()]
    for count, name in enumerate(names[:2], 1):
        bench.renew([bench.Runner(made(0.001, 0.003, name))], path)
        assert {row["name"]: float(row["ratio"]) for row in read_csv(path)} == dict.fromkeys(
            names[:count], pytest.approx(3.0, rel=0.1)
        )
    assert set(names) == {row["name"] for row in read_csv(bench.RATIOS)}
