# SPDX-License-Identifier: Apache-2.0
"""The guard of `make bench`: what it calls lost, that it measures again, and that its cases can be told apart."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.guard import bench, cases


def busy(seconds: float):
    """A job that takes CPU time, and answers."""

    def job() -> np.ndarray:
        end = time.process_time() + seconds
        while time.process_time() < end:
            pass
        return np.ones(2)

    return job


def made(ours_s: float, peer_s: float, name: str = "made") -> cases.Case:
    return cases.Case(name, "a slower one", lambda: (busy(ours_s), busy(peer_s)))


def test_the_ratio_is_that_of_cpu_times() -> None:
    assert bench.Runner(made(0.002, 0.008)).measure().ratio == pytest.approx(4.0, rel=0.1)


def test_a_ratio_that_stays_low_is_measured_again_and_lost(capsys: pytest.CaptureFixture[str]) -> None:
    runner = bench.Runner(made(0.002, 0.004))
    best = bench.guard([runner], {"made": 3.0})
    assert capsys.readouterr().out.count("measured again") == bench.AGAIN
    assert bench.lost(best["made"], 3.0)
    assert not bench.table([runner], best, {"made": 3.0})


def test_a_new_case_is_not_lost() -> None:
    runner = bench.Runner(made(0.002, 0.002))
    assert bench.table([runner], bench.guard([runner], {}), {})


def test_a_ratio_that_was_low_once_only_is_kept() -> None:
    class Disturbed(bench.Runner):
        turns = 0

        def measure(self) -> bench.Measured:
            self.turns += 1
            return bench.Measured(1.0, 2.0 if self.turns == 1 else 4.0)

    best = bench.guard([Disturbed(made(0.001, 0.001))], {"made": 4.0})
    assert best["made"].ratio == 4.0


def test_different_answers_are_not_timed() -> None:
    other = cases.Case("made", "another", lambda: (lambda: np.zeros(2), lambda: np.full(2, 1e-3)), 1e-6)
    with pytest.raises(SystemExit, match="made: its answer is not that of its peer"):
        bench.Runner(other)


def test_renewed_ratios_are_those_that_the_next_run_compares_with(tmp_path: Path) -> None:
    path = tmp_path / "ratios.csv"
    name = cases.all_cases()[0].name
    bench.renew([bench.Runner(made(0.001, 0.003, name))], path)
    assert bench.read_ratios(path) == {name: pytest.approx(3.0, rel=0.1)}
    other = cases.all_cases()[1].name
    bench.renew([bench.Runner(made(0.001, 0.001, other))], path)
    assert set(bench.read_ratios(path)) == {name, other}


def test_every_case_has_a_committed_ratio() -> None:
    assert {case.name for case in cases.all_cases()} == set(bench.read_ratios(bench.RATIOS))
