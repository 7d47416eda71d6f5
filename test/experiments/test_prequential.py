# SPDX-License-Identifier: Apache-2.0
"""The experiment joins predictions that know neither the object nor that of the reading, and scores every grasp once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from experiment_samples import cell_rows, make_collection
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.experiments import find_experiment
from foretouch.experiments.framework.manifest import read_results, write_results
from foretouch.experiments.prequential import _recordings
from foretouch.experiments.prequential.results import TRACKER, with_past_mean
from foretouch.experiments.shared.tables import select, unique
from foretouch.learning.data import labels_of
from foretouch.types import Touch


def test_predictions_know_neither_the_object_nor_that_of_the_reading() -> None:
    data = make_collection(6, 4)
    rows, _ = cell_rows("prequential", data)
    recordings = _recordings(rows)
    assert len(recordings) == 6
    names = np.array([sample.object for sample in data.samples])
    labels = labels_of(data.samples)
    for target, recording in recordings.items():
        np.testing.assert_array_equal(recording.readings, labels)  # these samples are in order of time
        for name in np.unique(names):
            known = labels[(names != target) & (names != name)]
            own = recording.expected[recording.objects == name]
            np.testing.assert_allclose(own, np.tile(known.mean(axis=0), (len(own), 1)))
    assert _recordings([row for row in rows if row["without"] != ["campbells", "spam"]]) == {}


def test_tares_are_read_and_left_out() -> None:
    data = make_collection(3, 4)
    tare = Touch.from_vector(labels_of(data.samples).mean(axis=0))
    samples = [replace(one, tare=tare if k % 4 == 0 else None) for k, one in enumerate(data.samples)]
    rows, settings = cell_rows("prequential", replace(data, samples=samples))
    for recording in _recordings(rows).values():
        assert_array_equal(np.isfinite(recording.tares).all(axis=1), np.arange(12) % 4 == 0)
        assert_allclose(recording.tares[::4], 0.0, atol=1e-9)  # from the mean of the others' tares
    table = find_experiment("prequential").tabulate(settings, rows)
    assert unique(table, "vision") == ["training_mean, with tares", "training_mean", "past_mean"]


def test_every_grasp_is_scored_once_and_nothing_later_enters_the_past(tmp_path: Path) -> None:
    cells, settings = cell_rows("prequential", make_collection(6, 6))
    experiment = find_experiment("prequential")
    rows = write_results(tmp_path, experiment.tabulate(settings, cells))
    own = select(rows, method=TRACKER, vision="training_mean", modality="E_TH", object="all")
    grasps = {row["bin"]: row["grasps"] for row in own}
    assert grasps["all"] == 36
    assert grasps["none"] == grasps["1 touch"] == 6
    assert grasps["first 3"] + grasps["3-9"] == 36
    past = select(rows, vision="past_mean", bin="all", object="all")
    assert {row["grasps"] for row in past} == {30}  # nothing was read before the first object
    assert all(np.isfinite(row["skill"]) for row in rows if row["skill"] is not None)
    assert read_results(tmp_path / "results.csv") == rows
    titles = [table.title for table in experiment.summarise(rows)]
    assert sum(title.startswith("training_mean") for title in titles) == 4
    (figure,) = experiment.draw(rows, tmp_path)
    assert figure.stat().st_size > 5_000
    first = _recordings(cells)["cheezit"]
    shown = with_past_mean(first, 1)
    assert set(shown.objects) == {"campbells", "cheezit"}
    assert_allclose(shown.expected, np.tile(first.readings[:6].mean(axis=0), (12, 1)))
