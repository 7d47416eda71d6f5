# SPDX-License-Identifier: Apache-2.0
"""What the areas of `tradeoff` measure, on made-up grasps, generated scenes and the scenes of the repository."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from experiment_samples import make_collection

from foretouch.errors import ConfigError
from foretouch.pipeline import Pipeline
from foretouch_lab.experiments import tradeoff_model, tradeoff_perception, tradeoff_simulation, tradeoff_training
from foretouch_lab.experiments.framework.experiment import Cell, Row
from foretouch_lab.experiments.framework.tradeoff import Area
from foretouch_lab.learning.data import labels_of, make_folds
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig

GRASPS = make_collection()
QUICK = BootstrapConfig(draws=100)
PERCEPTION = tradeoff_perception.PerceptionSettings(scenes=2)
SIMULATION = tradeoff_simulation.SimulationSettings(compared=4, train=10, trees=2, finest_cells=24)
TRAINING = tradeoff_training.TrainingSettings(trees=2, networks=False, bootstrap=QUICK)
SCENES = Path(__file__).parents[3] / "config" / "scenes"


@cache
def images() -> Any:
    return tradeoff_perception.EXPERIMENT.load(PERCEPTION, Path("no recordings"))


@cache
def scenes() -> Any:
    return tradeoff_simulation.EXPERIMENT.load(SIMULATION, SCENES)


def table(area: Area, settings: Any, data: Any, cells: list[Cell]) -> dict[str, Row]:
    rows = [{**cell.values, **row} for cell in cells for row in area.run(cell, settings, data)]
    return {row["variant"]: row for row in area.tabulate(settings, rows)}


def test_models_are_measured_on_each_split_and_timed() -> None:
    area = tradeoff_model.EXPERIMENT
    settings = tradeoff_model.ModelSettings(splits=("object",), requests=(1, 2), bootstrap=QUICK)
    cells = list(area.cells(settings, GRASPS))
    assert len(cells) == 8
    rows = table(area, settings, GRASPS, cells[:1])
    contact = {one.name for one in area.variants(settings) if one.values["kind"] == "contact"}
    others = {"mean of labels + readings", "contact-v2 + readings"}  # the mean of the object is not known here
    assert rows.keys() == {"mean of labels", "touchnet-v1", *contact, *others}
    assert rows["mean of labels + readings"]["object"] > 0.1
    assert rows["mean of labels"]["object"] == 0.0
    assert rows["contact-v2"]["object_rmse_PDC_TH"] > 0.0
    assert rows["10 trees"]["object"] != rows["contact-v2"]["object"]
    assert rows["touchnet-v1"]["object_E_TH"] is not None  # of its card
    with pytest.raises(ConfigError, match="must hold at least one"):
        settings.replace(seeds=())
    kinds = {"contact-v2", "10 trees", "no surroundings", "forests alone", "mean of labels"}
    kinds |= {"touchnet-v1", "64 points", "papers' four networks", *others, "mean of the object"}
    made = {one.name: area.timed(one, settings, GRASPS) for one in area.variants(settings) if one.name in kinds}
    for name, (answer, _) in made.items():
        assert answer(2).shape == (2, 50), name
    counts = made["contact-v2"][0](1)
    assert not np.array_equal(made["contact-v2 + readings"][0](1), counts)


def perceived(step: str, changes: dict[str, object], **values: object) -> list[Row]:
    cell = Cell("one", {"variant": "one", "step": step, "changes": changes, **values})
    return [{**cell.values, **row} for row in tradeoff_perception.EXPERIMENT.run(cell, PERCEPTION, images())]


def test_overlaps_are_of_the_object_that_covers_most() -> None:
    truth = np.array([[2, 2, 2, 2, 0, 3, 3, 0]], np.int32)
    labels = np.array([[1, 1, 1, 2, 0, 3, 3, 3]], np.int32)
    assert tradeoff_perception.overlaps(labels, truth, range(2, 4)) == [3 / 4, 2 / 3]


def test_shipped_settings_move_nothing_noise_moves_grasps_and_a_coarser_grid_loses_masks() -> None:
    rows = perceived(tradeoff_perception.GRASP, {})
    assert len(rows) == 6
    assert {row["score_change"] for row in rows} <= {0.0, None}
    assert any(row["score_change"] for row in perceived(tradeoff_perception.GRASP, {}, jitter_mm=2.0))
    area = tradeoff_perception.EXPERIMENT
    (coarse,), (shipped,) = (
        area.tabulate(PERCEPTION, perceived(tradeoff_perception.SEGMENTATION, changes))
        for changes in ({"grid_rows": 30}, {})
    )
    assert coarse["iou"] < shipped["iou"]
    assert shipped["iou_low"] <= shipped["iou"] <= shipped["iou_high"]
    assert shipped["score"] is None  # its time is not GeoGrasp's
    assert shipped["wrong_scenes"] == 0


def test_variants_of_perception_are_settings_of_the_pipeline_and_are_timed() -> None:
    area, shipped = tradeoff_perception.EXPERIMENT, Pipeline().config.updated({"grasp.method": "original"})

    def check(one) -> None:
        assert (tradeoff_perception._pipeline(one.values).config == shipped) == (not one.values["changes"])

    variants = list(area.variants(PERCEPTION))
    every_case({one.name: (one,) for one in variants}, check)
    for one in variants[:2]:
        answer, _ = area.timed(one, PERCEPTION, images())
        assert answer(1) is not answer(1)


def simulated(name: str) -> Row:
    area = tradeoff_simulation.EXPERIMENT
    (cell,) = (one for one in area.cells(SIMULATION, scenes()) if one.values["variant"] == name)
    return table(area, SIMULATION, scenes(), [cell])[name]


def test_springs_are_nearly_right_on_rigid_objects_and_an_effect_left_out_changes_counts() -> None:
    finest = simulated("rigid: finest layer")
    assert finest["pattern_error"] == finest["force_error"] == finest["trained_change"] == 0.0
    assert finest["digits_rigid"] is None
    springs, soft = simulated("rigid: winkler 12x12"), simulated("deformables: winkler 12x12")
    assert springs["pattern_error"] < 0.05
    assert soft["pattern_error"] > 0.1
    assert springs["digits_rigid"] == pytest.approx(-np.log10(springs["pattern_error"]), rel=1e-4)
    assert springs["force_error"] < 1e-6  # the hand closes to a force
    assert springs["trained_deformables"] is None
    row = simulated("without noise")
    assert 1.0 < row["counts"] < 20.0  # its deviation is 4 to 5 counts in each of both
    assert row["trained_everything"] is not None


def test_all_variants_of_the_simulator_are_scenes_and_are_timed(tmp_path: Path) -> None:
    area = tradeoff_simulation.EXPERIMENT
    variants = list(area.variants(SIMULATION))
    every_case({one.name: (one,) for one in variants}, lambda one: scenes().changed(one.values))
    answer, _ = area.timed(variants[0], SIMULATION, scenes())
    one, two = answer(1).touch.values, answer(1).touch.values
    assert one.shape == (50,)
    assert not np.array_equal(one, two)
    with pytest.raises(ConfigError, match=r"holds no rigid.yaml; give the folder config/scenes"):
        area.prepare(SIMULATION, tmp_path, tmp_path)


def test_more_grasps_are_more_skilful_take_the_robot_longer_and_fewer_are_part_of_all() -> None:
    area, wanted = tradeoff_training.EXPERIMENT, ("contact model as shipped", "mean of labels", "5 grasps an object")
    cells = [one for one in area.cells(TRAINING, GRASPS) if one.values["variant"] in wanted]
    rows = table(area, TRAINING, GRASPS, [one for one in cells if one.values["column"] == "known"])
    shipped, mean, fewer = (rows[name] for name in wanted)
    assert shipped["known"] > fewer["known"] > mean["known"] == 0.0
    assert shipped["robot_h_known"] == pytest.approx(shipped["grasps_known"] * 60.0 / 3600.0, abs=0.01)
    assert shipped["known_low"] < shipped["known"] < shipped["known_high"]
    columns = {cell.values["column"] for cell in area.cells(TRAINING.replace(networks=True), GRASPS)}
    assert columns == {"known", "new", "one_block"}
    (fold,) = (one for one in make_folds(GRASPS.samples, "time", 0) if one.name == "block 0")
    train, test = fold.sides(GRASPS.samples)
    chosen = tradeoff_training._chosen_samples
    five = chosen({"grasps": 5}, train)
    assert len(five) == 5 * 8
    assert {one.id for one in five} < {one.id for one in chosen({"grasps": 8}, train)}
    assert len({one.object for one in chosen({"objects": 3}, train)}) == 3
    assert chosen({"grasps": 1000}, train) == chosen({"grasps": 9}, train)
    shipped, *_, network = tradeoff_training.EXPERIMENT.variants(TRAINING.replace(networks=True))
    fit, _ = tradeoff_training.EXPERIMENT.timed(shipped, TRAINING, GRASPS)
    answer = fit(1)
    assert answer.shape == (10, 50)
    assert abs(answer - labels_of(test[:10])).max() < 1000.0
    epoch, epochs = tradeoff_training.EXPERIMENT.timed(network, TRAINING, GRASPS)
    assert epochs == 240.0
    assert epoch(1)["loss"] > 0.0
