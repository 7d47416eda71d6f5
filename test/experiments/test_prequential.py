# SPDX-License-Identifier: Apache-2.0
"""The experiment joins predictions that know neither the object nor that of the reading, and scores every grasp once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from experiment_samples import make_collection
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.experiments import find_experiment
from foretouch.experiments.framework.experiment import Cell
from foretouch.experiments.prequential import _recordings
from foretouch.experiments.prequential.results import TRACKER, summarise_prequential
from foretouch.learning.data import labels_of
from foretouch.types import Touch


def test_predictions_know_neither_the_object_nor_that_of_the_reading() -> None:
    data, experiment = make_collection(6, 4), find_experiment("prequential")
    settings = experiment.resolve("smoke", {})
    rows = [
        {**cell.values, **row}
        for cell in experiment.cells(settings, data)
        for row in experiment.run(Cell(cell.key, cell.values), settings, data)
    ]
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
    data, experiment = make_collection(3, 4), find_experiment("prequential")
    tare = Touch.from_vector(labels_of(data.samples).mean(axis=0))
    samples = [replace(one, tare=tare if k % 4 == 0 else None) for k, one in enumerate(data.samples)]
    data, settings = replace(data, samples=samples), experiment.resolve("smoke", {})
    rows = [
        {**cell.values, **row}
        for cell in experiment.cells(settings, data)
        for row in experiment.run(cell, settings, data)
    ]
    for recording in _recordings(rows).values():
        assert_array_equal(np.isfinite(recording.tares).all(axis=1), np.arange(12) % 4 == 0)
        assert_allclose(recording.tares[::4], 0.0, atol=1e-9)  # from the mean of the others' tares
    table = experiment.tabulate(settings, rows)
    assert list(dict.fromkeys(row["vision"] for row in table)) == [
        "training_mean, with tares",
        "training_mean",
        "past_mean",
    ]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list]:
    data, experiment = make_collection(6, 6), find_experiment("prequential")
    settings = experiment.resolve("smoke", {})
    rows = [
        {**cell.values, **row}
        for cell in experiment.cells(settings, data)
        for row in experiment.run(cell, settings, data)
    ]
    return tmp_path_factory.mktemp("figure"), experiment.tabulate(settings, rows)


def test_every_grasp_is_scored_once(sweep) -> None:
    _, rows = sweep
    of = {
        (row["bin"], row["object"]): row["grasps"]
        for row in rows
        if row["method"] == TRACKER and row["vision"] == "training_mean" and row["modality"] == "E_TH"
    }
    assert of["all", "all"] == 36
    assert of["none", "all"] == of["1 touch", "all"] == 6
    assert of["first 3", "all"] + of["3-9", "all"] == 36
    past = [row for row in rows if row["vision"] == "past_mean" and row["bin"] == "all" and row["object"] == "all"]
    assert {row["grasps"] for row in past} == {30}  # nothing was read before the first object
    assert all(np.isfinite(row["skill"]) for row in rows if row["skill"] is not None)


def parsed(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def test_tables_and_figure_are_made_of_the_rows(sweep) -> None:
    folder, rows = sweep
    titles = [table.title for table in summarise_prequential(rows)]
    assert sum(title.startswith("training_mean") for title in titles) == 4
    assert titles[0] == "Findings"
    stored = [{**row, "bin": str(parsed(row["bin"]))} for row in rows]  # as read from results.csv
    assert stored == rows
    (figure,) = find_experiment("prequential").draw(rows, folder)
    assert figure.stat().st_size > 10_000
