# SPDX-License-Identifier: Apache-2.0
"""P1's network as its public code trains, splits and tests it: on made-up grasps, with hardly any training."""

import json

from experiment_samples import make_collection

from foretouch_lab.experiments import find_experiment
from foretouch_lab.experiments.shared.tables import select
from foretouch_lab.learning.training.run_config import load_run_config


def test_splits_ways_of_testing_and_published_errors() -> None:
    experiment, data = find_experiment("p1_as_published"), make_collection(each=20)
    settings = experiment.resolve("smoke", {"modalities": ["PDC_MF"]})
    cells = experiment.cells(settings, data)
    assert [cell.values["part"] for cell in cells[:5]] == [f"split {k}" for k in range(5)]
    assert len(cells) == 12  # five within each of two types, and one in each direction
    found = [{**cell.values, **row} for cell in (cells[0], cells[-1]) for row in experiment.run(cell, settings, data)]
    # 40 samples: 40 / 500 = 8 %, rounded up as ShuffleSplit does
    assert {row["samples"] for row in select(found, part="split 0")} == {4}
    assert {row["samples"] for row in select(found, part="boxes to cylinders")} == {40}
    batch, running, mean = found[-3:]
    assert [row["predictor"] for row in found[-3:]] == ["batch", "running", "mean"]
    assert batch["squared"] != running["squared"] != mean["squared"]
    table = experiment.tabulate(settings, json.loads(json.dumps(found)))
    published = select(table, predictor="P1 (published)")
    told = {row["table"]: row["as_published_counts"] for row in published}
    assert told == {"within p1_cylinders": 153.0, "across types": 165.0}
    assert len(experiment.summarise(table)) == 4


def test_the_recipe_differs_from_p1_in_three_switches() -> None:
    plain, published = (load_run_config(name).to_mapping() for name in ("p1", "p1_as_published"))
    changed = {
        part: {key for key in plain[part] if plain[part][key] != published[part][key]} for part in ("model", "train")
    }
    assert changed == {"model": {"trunk_relu"}, "train": {"partial_batches", "root_epsilon"}}
