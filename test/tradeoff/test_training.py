# SPDX-License-Identifier: Apache-2.0
"""What the area `training` measures: which grasps a variant trains on, its skill, and the time of the robot."""

from pathlib import Path

import pytest
from experiment_samples import make_collection

from foretouch.experiments.framework.experiment import Cell, Row
from foretouch.learning.data import Dataset, labels_of
from foretouch.learning.evaluation.metrics import BootstrapConfig
from foretouch.tradeoff.area import find_area
from foretouch.tradeoff.areas.training import measures, results, variants

SETTINGS = measures.TrainingSettings(trees=2, detail="few", bootstrap=BootstrapConfig(draws=100))
DATA = make_collection()


def cells(detail: str, data: Dataset = DATA) -> list[Cell]:
    return measures.cells(SETTINGS.replace(detail=detail), data)


def table(names: tuple[str, ...]) -> dict[str, Row]:
    chosen = [cell for cell in cells("few") if cell.values["variant"] in names and cell.values["column"] == "known"]
    rows = [{**cell.values, **row} for cell in chosen for row in measures.run(cell, SETTINGS, DATA)]
    return {row["variant"]: row for row in measures.tabulate(SETTINGS, rows)}


def test_few_trains_no_network_and_all_at_most_25() -> None:
    assert not any(cell.values.get("trains") for cell in cells("few"))
    everything = cells("all")
    find_area("training").check_trainings(everything)
    assert 5 <= sum(cell.values.get("trains", 0) for cell in everything) <= 25


def test_fewer_grasps_or_objects_are_part_of_all() -> None:
    train, _ = measures.first_block(DATA)
    five = measures.chosen_samples({"grasps": 5}, train)
    assert len(five) == 5 * 8
    assert {one.id for one in five} < {one.id for one in measures.chosen_samples({"grasps": 8}, train)}
    assert len({one.object for one in measures.chosen_samples({"objects": 3}, train)}) == 3
    assert measures.chosen_samples({"grasps": 1000}, train) == measures.chosen_samples({"grasps": 9}, train)


def test_more_grasps_are_more_skilful_and_take_the_robot_longer() -> None:
    rows = table((variants.CONTACT, variants.MEAN, "5 grasps an object"))
    shipped, fewer, mean = rows[variants.CONTACT], rows["5 grasps an object"], rows[variants.MEAN]
    assert shipped["known"] > fewer["known"] > mean["known"] == 0.0
    assert shipped["robot_h_known"] == pytest.approx(shipped["grasps_known"] * 60.0 / 3600.0, abs=0.01)
    assert shipped["known_low"] < shipped["known"] < shipped["known_high"]


def test_the_fit_that_is_timed_predicts_what_the_measured_one_does() -> None:
    train, test = measures.first_block(DATA)
    (shipped, *_) = variants.list_variants("few")
    answer = measures.timed(shipped, SETTINGS, DATA).answer(1)
    expected = measures._predict(shipped.values, SETTINGS, measures._described(DATA), train, test[:10])
    assert (answer == expected).all()
    assert answer.shape == (10, 50)
    assert abs(answer - labels_of(test[:10])).max() < 1000.0


def row(variant: str, factor: str, known: float, hours: float, cpu_ms: float) -> Row:
    made: Row = {
        "variant": variant,
        "factor": factor,
        "known": known,
        "known_low": None,
        "known_high": None,
        "new": None,
    }
    made |= {"one_block": None, "robot_h_known": hours, "robot_h_new": None, "grasps_known": int(60 * hours)}
    return made | {"cpu_ms": cpu_ms, "request": 1, "state": "idle"}


ROWS = [
    row(variants.CONTACT, "shipped", 0.4, 4.0, 3000.0),
    row("5 grasps an object", "labels", 0.2, 2.0, 1000.0),
    row("5 trees", "trees", 0.3, 4.0, 1000.0),
]


def test_a_sentence_tells_what_an_hour_of_the_robot_buys() -> None:
    robot, computer = results.notes(ROWS)
    assert robot == (
        "Robot, known objects, more grasps of each: from 120 to 240 grasps, 2.0 hours, skill 0.200 to 0.400: +0.100 an hour."
    )
    assert computer == (
        "Computer, trees: from 5 trees to contact model as shipped, 2.0 s more of one core, skill 0.300 to 0.400."
    )


def test_the_figure_is_drawn_from_rows_alone(tmp_path: Path) -> None:
    assert [path.name for path in results.draw(ROWS, tmp_path)] == ["labels.png"]
    assert results.draw(ROWS[:1], tmp_path) == []
