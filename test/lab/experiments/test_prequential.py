# SPDX-License-Identifier: Apache-2.0
"""The experiment joins predictions that know neither the object nor that of the reading, and scores every grasp once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from experiment_samples import cell_rows, make_collection
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.tactile import biotac_touch
from foretouch_lab.experiments import find_experiment
from foretouch_lab.experiments.framework.manifest import read_results, write_results
from foretouch_lab.experiments.prequential import expected_before, recording_without
from foretouch_lab.experiments.prequential.results import CONSTANT, EVERYTHING
from foretouch_lab.experiments.shared.predictors import PREDICTORS
from foretouch_lab.experiments.shared.tables import select, unique
from foretouch_lab.learning.data import labels_of

MEAN = PREDICTORS[CONSTANT](1.0)


def test_predictions_know_neither_the_object_nor_that_of_the_reading_and_nothing_later() -> None:
    samples = list(make_collection(4, 6).samples)  # in order of time
    names, labels = np.array([sample.object for sample in samples]), labels_of(samples)
    for target in np.unique(names):
        recording = recording_without(samples, target, MEAN)
        assert_array_equal(recording.readings, labels)
        for name in np.unique(names):
            known = labels[(names != target) & (names != name)]
            own = recording.expected[recording.objects == name]
            assert_allclose(own, np.tile(known.mean(axis=0), (len(own), 1)))
    runs = np.repeat(np.arange(4), 6)
    first, last = (expected_before(samples, runs <= run, runs < run, MEAN) for run in (1, 3))
    assert_allclose(first, np.tile(labels[:6].mean(axis=0), (12, 1)))  # of one object: its mean
    assert_allclose(last[18:], np.tile(labels[:18].mean(axis=0), (6, 1)))
    assert_allclose(last[:6], np.tile(labels[6:18].mean(axis=0), (6, 1)))


def test_tares_and_temperatures_give_further_sources_and_a_missing_cell_leaves_its_predictor_out() -> None:
    data = make_collection(3, 4)
    tare = biotac_touch(labels_of(data.samples).mean(axis=0))
    samples = tuple(
        replace(sample, tare=tare if k % 4 == 0 else None, extra={"TDC_TH": 2400.0 + k} if k % 2 else {})
        for k, sample in enumerate(data.samples)
    )
    recording = recording_without(samples, "campbells", MEAN)
    assert_array_equal(np.isfinite(recording.tares).all(axis=1), np.arange(12) % 4 == 0)
    assert_allclose(recording.tares[::4], 0.0, atol=1e-9)  # from the mean of the others' tares
    assert_array_equal(recording.tdc[1::2, 0], 2400.0 + np.arange(1, 12, 2))
    rows, settings = cell_rows("prequential", replace(data, samples=samples))
    experiment = find_experiment("prequential")
    table = experiment.tabulate(settings, rows)
    assert {"temperature", "history + touches + tares", EVERYTHING} < set(unique(table, "sources"))
    assert experiment.tabulate(settings, rows[1:]) == []


@pytest.mark.slow
def test_every_grasp_is_scored_once_the_gain_of_vision_is_paired_and_tables_are_made_of_the_rows(
    tmp_path: Path,
) -> None:
    trees = {"predictors": [CONSTANT, "geometry_trees"], "training_fraction": 0.02}
    cells, settings = cell_rows("prequential", make_collection(7, 6), **trees)
    experiment = find_experiment("prequential")
    rows = write_results(tmp_path, experiment.tabulate(settings, cells))
    own = select(rows, sources="history + touches", vision=CONSTANT, modality="E_TH", object="all")
    grasps = {row["regime"]: row["grasps"] for row in own}  # nothing was read before the first object
    assert grasps == {"never touched": 6, "first three": 18, "later": 18, "all": 36}
    assert all(np.isfinite(row["skill"]) for row in rows if row["skill"] is not None)
    assert read_results(tmp_path / "results.csv") == rows
    place = ("sources", "regime", "modality")
    without = {tuple(row[name] for name in place): row for row in select(rows, vision=CONSTANT, object="all")}
    assert {row["vs_constant"] for row in without.values()} == {None}
    found = select(rows, vision="geometry_trees", object="all")
    assert len(found) == len(without)
    for row in found:
        gain = row["skill"] - without[tuple(row[name] for name in place)]["skill"]
        assert_allclose(row["vs_constant"], gain, rtol=1e-3, atol=1e-3)
        verdict = "better" if row["vs_constant_low"] > 0.0 else "worse" if row["vs_constant_high"] < 0.0 else "tie"
        assert row["vs_constant_verdict"] == verdict
    titles = [table.title for table in experiment.summarise(rows)]
    assert [title.partition(":")[0] for title in titles[:4]] == ["never touched", "first three", "later", "all"]
    (figure,) = experiment.draw(rows, tmp_path)
    assert figure.stat().st_size > 5_000
