# SPDX-License-Identifier: Apache-2.0
"""`foretouch experiment`: what a person and a program are told."""

import pytest

OWN = "own_experiments.counting"


def test_a_program_gets_a_line_a_cell_and_the_summary_and_exit_status_1_if_one_failed(call, tmp_path, numbers) -> None:
    words = ["experiment", OWN, "-o", tmp_path / "out", "--data", numbers, "--workers", "1", "--json", "cells=3"]
    answer = call(*words)
    assert answer.status == 0, answer.err
    *cells, summary = answer.records
    told = [(record["cell"], record["done"], record["cells"]) for record in cells]
    assert told == [(f"cell{k}", k + 1, 3) for k in range(3)]
    assert summary["status"] == "done"
    assert (summary["cells"], summary["reused"], summary["rows"], summary["failed"]) == (3, 0, 6, {})
    call(*words).check_refused("--resume continues")
    (again,) = call(*words, "--resume").records
    assert again["reused"] == 3
    answer = call("experiment", OWN, "-o", tmp_path / "broken", "--data", numbers, "--json", "cells=2", "broken=[1]")
    assert (answer.status, answer.err) == (1, "foretouch: cell1: cell 1: is broken\n")
    assert (answer.records[-1]["failed"], answer.records[-1]["rows"]) == ({"cell1": "cell 1: is broken"}, 2)


def test_an_unfinished_sweep_says_so_in_its_tables(call, tmp_path, numbers) -> None:
    words = ["experiment", OWN, "-o", tmp_path / "out", "--data", numbers]
    whole = call(*words, "cells=2", "--workers", "1")
    assert whole.status == 0, whole.err
    for text in ("How far can one count?", "counted", "2 cells (0 reused)"):
        assert text in whole.out
    summary = (tmp_path / "out/summary.md").read_text()
    assert "are finished" not in summary
    assert summary.endswith("## counted\n\n| number |\n| --- |\n| 0 |\n| 0 |\n| 1 |\n| 1 |\n")
    words[3] = tmp_path / "other"
    assert call(*words, "cells=3", "broken=[2]", "--workers", "1").status == 1
    summary = tmp_path / "other/summary.md"
    sentence = "**2 of 3 cells are finished.** The tables contain these alone."
    assert sentence in summary.read_text()
    call("experiment", OWN, "-o", tmp_path / "other", "--redraw")
    assert sentence in summary.read_text()


def test_mistakes_are_one_line_and_another_experiment_is_not_redrawn(call, tmp_path, numbers, monkeypatch) -> None:
    monkeypatch.delenv("FORETOUCH_DATA", raising=False)
    out = ["-o", tmp_path / "out"]
    assert "'phrenology' is not one of label_ratio, leaderboard" in call("experiment", "phrenology", *out).err
    assert "No module named" in call("experiment", "no.such", *out).err
    assert "contains no EXPERIMENT" in call("experiment", "foretouch.types", *out).err
    assert "-o DIR is required" in call("experiment", OWN).err
    assert "no data; give --data PATH or set FORETOUCH_DATA" in call("experiment", "prequential", *out).err
    assert "seed: unknown setting" in call("experiment", "prequential", *out, "seed=1").err
    answer = call("experiment", "label_ratio", *out, "--preset", "smoke", "--data", tmp_path)
    answer.check_refused("is neither a scene (.yaml) nor a store")  # and no bar beside it
    assert not (tmp_path / "out").exists()
    for words in (["--bogus"], ["--workers", "0"], ["--workers", "-3"]):
        with pytest.raises(SystemExit) as wrong:
            call("experiment", OWN, *out, "--data", numbers, *words)
        assert wrong.value.code == 2
    call("experiment", OWN, *out, "--data", numbers, "cells=1", "--workers", "1")
    words, results = (*out, "--redraw"), tmp_path / "out" / "results.csv"
    call("experiment", "label_ratio", *words).check_refused(
        "manifest.json: experiment: 'counting' is not 'label_ratio'\n"
    )
    results.write_text("")
    call("experiment", OWN, *words).check_refused("contains no row")
    results.unlink()
    call("experiment", OWN, *words).check_refused("results.csv: No such file or directory\n")
