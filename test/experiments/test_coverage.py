# SPDX-License-Identifier: Apache-2.0
"""Coverage is that of the released intervals, on objects that are neither fitted to nor calibrated on."""

from pathlib import Path

import numpy as np
import pytest
from contact_model_builders import FEW_TREES, with_tares
from experiment_samples import make_samples

from foretouch.experiments import find_experiment
from foretouch.experiments.coverage import coverage_rows, coverage_table
from foretouch.experiments.shared.folds import by_object, split_objects
from foretouch.learning.data import labels_of
from foretouch.learning.evaluation.metrics import BootstrapConfig
from foretouch.learning.training.contact import ContactPredictor

FEW_DRAWS = BootstrapConfig(draws=200)


def test_coverage_and_width_are_counted_value_by_value() -> None:
    train, test = split_objects(with_tares(make_samples(6, 8), 30.0), 5, seed=0)
    fitted = ContactPredictor(train, labels_of(train), FEW_TREES)
    (held,) = by_object(test)
    counts, half = fitted.intervals_after([], held, tare=True)
    inside = np.abs(labels_of(held) - counts) <= half
    none, three = coverage_rows(fitted, held, 2.0 * half[0], (0, 3), 4, tare=True)
    expected = [inside[:, :1], inside[:, 1:2], inside[:, 2:26], inside[:, 26:]]
    np.testing.assert_allclose(none["coverage"], [part.mean() for part in expected])
    np.testing.assert_allclose(none["width"], (half / half[0]).mean() / 2.0, rtol=0.3)
    assert none["grasps"] == 8
    assert three["grasps"] == 5
    assert all(after <= before for after, before in zip(three["width"], none["width"], strict=True))


def _row(condition: str, part: str, name: str, share: float, touches: int = 0) -> dict:
    head = {"condition": condition, "part": part, "object": name, "tare": False, "touches": touches, "grasps": 10}
    return {**head, "coverage": [share] * 4, "width": [0.5] * 4, "unfamiliar": 0.2}


def test_objects_have_equal_weight_and_means_outside_the_accepted_range_are_marked() -> None:
    rows = [_row("simulated", "0", "a", 1.0), _row("simulated", "1", "a", 0.8), _row("simulated", "1", "b", 0.5)]
    table = coverage_table(rows, FEW_DRAWS)
    together = next(row for row in table if row["object"] == "all")
    assert together["coverage"] == pytest.approx((0.9 + 0.5) / 2.0)
    assert together["low"] is None  # no interval from two objects
    assert together["grasps"] == 20  # both splits tested the same ten grasps of a
    blocks = coverage_table([_row("time blocks", str(k), "a", 0.9) for k in range(5)], FEW_DRAWS)
    assert {row["grasps"] for row in blocks} == {50}  # but each block of time has others
    rows = [_row("left out", "", f"o{k}", 0.6 + 0.02 * k, touches) for k in range(8) for touches in (0, 1)]
    found, table, each = find_experiment("coverage").summarise(coverage_table(rows, FEW_DRAWS))
    assert all("☒" in cell for row in table.rows for cell in row[1:])
    assert [row[0] for row in table.rows] == ["no touch", "1 touch"]
    assert len(each.rows) == 8
    assert found.notes == [
        "left out: coverage is .67 on average; the lowest of one object is .60 (o0, PDC_TH, no touch)"
    ]


@pytest.mark.real_data
def test_sweep(swept, real_data: Path) -> None:
    few = {"samples": 20, "train_objects": 15, "contact.trees": 2}
    rows = swept("coverage", real_data / "vision2tactile", **few)
    assert {row["objects"] for row in rows if row["object"] == "all"} == {5}
    assert {row["tare"] for row in rows} == {False, True}
