# SPDX-License-Identifier: Apache-2.0
"""Smaller draws are part of larger ones, and every size is compared with the same mean."""

from pathlib import Path

import numpy as np
import pytest
from experiment_samples import make_collection, make_samples
from matplotlib.figure import Figure

from foretouch.errors import DatasetError
from foretouch.experiments import find_experiment, run_sweep
from foretouch.experiments.learning_curve import NEW, SIMULATED, draw_curve, some_grasps, some_objects
from foretouch.experiments.shared.simulated_data import RealAndSimulated

SAMPLES = make_samples(6, 10)


def test_of_each_object_as_many_grasps() -> None:
    few, more = ({s.id for s in some_grasps(SAMPLES, count, 3)} for count in (3, 7))
    assert few < more
    assert (len(few), len(more)) == (18, 42)
    assert few != {s.id for s in some_grasps(SAMPLES, 3, 4)}
    with pytest.raises(DatasetError, match="campbells has 10 grasps, fewer than 11"):
        some_grasps(SAMPLES, 11, 0)


def test_objects_are_drawn_whole() -> None:
    few, more = (some_objects(SAMPLES, count, 1) for count in (2, 5))
    assert {s.object for s in few} < {s.object for s in more}
    assert (len(few), len(more)) == (20, 50)
    with pytest.raises(DatasetError, match="6 objects are fewer than 7"):
        some_objects(SAMPLES, 7, 0)


def test_all_sizes_are_compared_with_the_mean_of_the_whole_training_side() -> None:
    experiment = find_experiment("learning_curve")
    settings = experiment.resolve("smoke", {"objects": [2, 7], "predictors": ["training_mean"]})
    data = RealAndSimulated(make_collection(8, 12), make_collection(8, 12))
    cells = [cell for cell in experiment.cells(settings, data) if cell.values["ground"] == NEW]
    two, seven = (
        [row for cell in cells if cell.values["size"] == size for row in experiment.run(cell, settings, data)]
        for size in (2, 7)
    )
    assert [row["reference"] for row in two] == [row["reference"] for row in seven]
    # The mean of all seven is the reference itself; that of two is another one.
    for row in seven:
        np.testing.assert_allclose(row["squared"], row["reference"])
    assert all(row["squared"] != row["reference"] for row in two)


@pytest.mark.real_data
def test_sweep(tmp_path: Path, real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[2])
    experiment = find_experiment("learning_curve")
    few = {"grounds": [SIMULATED], "scene": "config/scenes/deformables.yaml", "samples": 24, "effort": 0.01}
    few |= {"simulated_objects": [2, 3], "seeds": [0, 1]}
    source = real_data / "vision2tactile"
    result = run_sweep(experiment, experiment.resolve("smoke", few), tmp_path / "out", source=source)
    assert result.failures == {}
    assert {row["size"] for row in result.rows} == {2, 3}
    assert {row["seeds"] for row in result.rows} == {2}
    (figure,) = experiment.draw(result.rows, tmp_path)
    assert figure.stat().st_size > 5000


def test_a_line_over_the_size() -> None:
    rows = [{"predictor": "a", "size": size, "skill": size / 100, "skill_low": None} for size in (40, 10)]
    axes = Figure().subplots()
    draw_curve(axes, rows, ["a"])
    assert axes.lines[0].get_xydata().tolist() == [[10.0, 0.1], [40.0, 0.4]]
    assert axes.get_xscale() == "log"
