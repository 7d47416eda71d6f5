# SPDX-License-Identifier: Apache-2.0
"""The experiment joins predictions that know neither the object nor that of the reading, and scores every grasp once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from experiment_samples import cell_rows, make_collection
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.tactile import biotac_touch
from foretouch_lab.experiments import find_experiment
from foretouch_lab.experiments.framework.manifest import read_results, write_results
from foretouch_lab.experiments.prequential import _recordings
from foretouch_lab.experiments.prequential.results import CONSTANT, EVERYTHING
from foretouch_lab.experiments.shared.tables import select, unique
from foretouch_lab.learning.data import labels_of


def left_out(rows: list) -> list:
    """Rows of fits without one object or two."""
    return [row for row in rows if "without" in row]


def test_predictions_know_neither_the_object_nor_that_of_the_reading() -> None:
    data = make_collection(6, 4)
    rows, _ = cell_rows("prequential", data)
    recordings = _recordings(left_out(rows))
    assert len(recordings) == 6
    names = np.array([sample.object for sample in data.samples])
    labels = labels_of(data.samples)
    for target, recording in recordings.items():
        np.testing.assert_array_equal(recording.readings, labels)  # these samples are in order of time
        for name in np.unique(names):
            known = labels[(names != target) & (names != name)]
            own = recording.expected[recording.objects == name]
            np.testing.assert_allclose(own, np.tile(known.mean(axis=0), (len(own), 1)))
    assert _recordings([row for row in left_out(rows) if row["without"] != ["campbells", "spam"]]) == {}


def test_tares_and_temperatures_are_joined_with_their_grasps() -> None:
    data = make_collection(3, 4)
    tare = biotac_touch(labels_of(data.samples).mean(axis=0))
    samples = [
        replace(one, tare=tare if k % 4 == 0 else None, extra={"TDC_TH": 2400.0 + k} if k % 2 else {})
        for k, one in enumerate(data.samples)
    ]
    rows, settings = cell_rows("prequential", replace(data, samples=samples))
    for recording in _recordings(left_out(rows)).values():
        assert_array_equal(np.isfinite(recording.tares).all(axis=1), np.arange(12) % 4 == 0)
        assert_allclose(recording.tares[::4], 0.0, atol=1e-9)  # from the mean of the others' tares
        assert_array_equal(recording.tdc[1::2, 0], 2400.0 + np.arange(1, 12, 2))
        assert np.isnan(recording.tdc[::2]).all()
    table = find_experiment("prequential").tabulate(settings, rows)
    assert {"temperature", "history + touches + tares", EVERYTHING} < set(unique(table, "sources"))


def test_every_grasp_is_scored_once_and_tables_are_made_of_the_rows(tmp_path: Path) -> None:
    cells, settings = cell_rows("prequential", make_collection(6, 6))
    experiment = find_experiment("prequential")
    rows = write_results(tmp_path, experiment.tabulate(settings, cells))
    own = select(rows, sources="history + touches", vision=CONSTANT, modality="E_TH", object="all")
    grasps = {row["regime"]: row["grasps"] for row in own}
    assert grasps == {
        "never touched": 5,
        "first three": 15,
        "later": 15,
        "all": 30,
    }  # nothing was read before the first object
    assert all(np.isfinite(row["skill"]) for row in rows if row["skill"] is not None)
    assert read_results(tmp_path / "results.csv") == rows
    titles = [table.title for table in experiment.summarise(rows)]
    assert [title.partition(":")[0] for title in titles[:4]] == ["never touched", "first three", "later", "all"]
    (figure,) = experiment.draw(rows, tmp_path)
    assert figure.stat().st_size > 5_000


def test_the_gain_of_vision_is_paired_and_stands_beside_its_skill() -> None:
    trees = {"predictors": [CONSTANT, "geometry_trees"], "training_fraction": 0.02}
    cells, settings = cell_rows("prequential", make_collection(7, 5), **trees)
    experiment = find_experiment("prequential")
    rows = experiment.tabulate(settings, cells)
    place = ("sources", "regime", "modality")
    without = {tuple(row[name] for name in place): row for row in select(rows, vision=CONSTANT, object="all")}
    assert {row["vs_constant"] for row in without.values()} == {None}
    found = select(rows, vision="geometry_trees", object="all")
    assert len(found) == len(without)
    for row in found:
        assert_allclose(row["vs_constant"], row["skill"] - without[tuple(row[name] for name in place)]["skill"])
        verdict = "better" if row["vs_constant_low"] > 0.0 else "worse" if row["vs_constant_high"] < 0.0 else "tie"
        assert row["vs_constant_verdict"] == verdict
    known = [row for row in found if row["sources"] == "history + touches" and row["regime"] == "all"]
    assert all(row["vs_constant_low"] <= row["vs_constant"] <= row["vs_constant_high"] for row in known)
    tables = {table.title: table for table in experiment.summarise(rows)}
    assert len(tables["Gain of vision, geometry_trees"].rows) == len(found) / 4


def test_nothing_later_enters_a_prediction() -> None:
    """Predictions before a run change with no later sample, and know neither the object nor that of an earlier reading."""
    data = make_collection(4, 6)
    labels = labels_of(data.samples)
    rows, _ = cell_rows("prequential", data)
    before = {row["before"]: np.array(row["expected"]) for row in rows if "before" in row}
    assert_allclose(before[1], np.tile(labels[:6].mean(axis=0), (12, 1)))  # of one object: its mean
    assert_allclose(before[3][18:], np.tile(labels[:18].mean(axis=0), (6, 1)))
    assert_allclose(before[3][:6], np.tile(labels[6:18].mean(axis=0), (6, 1)))


def test_sources_that_carry_no_knowledge_change_nothing(rng) -> None:
    """Sensors without drift, objects without an effect: only vision differs from the mean, and touches gain nothing."""
    cells, settings = cell_rows("prequential", make_collection(6, 6))
    for row in cells:
        row["readings"] = None if "readings" not in row else (2000.0 + rng.normal(0.0, 20.0, (6, 50))).tolist()
        row["expected"] = np.full_like(row["expected"], 2000.0).tolist()
    rows = find_experiment("prequential").tabulate(settings, cells)
    for row in select(rows, object="all", regime="later"):
        assert abs(row["skill"]) < 0.25
