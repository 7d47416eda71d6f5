# SPDX-License-Identifier: Apache-2.0
"""What the area `perception` measures of a setting, on generated scenes with known objects."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from foretouch.experiments.framework.experiment import Cell
from foretouch.pipeline import Pipeline
from foretouch.tradeoff.area import find_area
from foretouch.tradeoff.areas.perception import measures
from foretouch.tradeoff.areas.perception.data import PerceptionData, PerceptionSettings, load
from foretouch.tradeoff.areas.perception.variants import GRASP, SEGMENTATION, list_variants

SETTINGS = PerceptionSettings(scenes=2, real=0, detail="few")


@cache
def loaded() -> PerceptionData:
    return load(SETTINGS, Path("no recordings"))


def rows_of(step: str, changes: dict[str, object], **values: object) -> list[dict[str, object]]:
    cell = Cell("one", {"variant": "one", "step": step, "changes": changes, **values})
    return [{**cell.values, **row} for row in measures.run(cell, SETTINGS, loaded())]


def test_an_overlap_is_that_of_the_found_object_which_covers_most() -> None:
    truth = np.array([[2, 2, 2, 2, 0, 3, 3, 0]], np.int32)
    labels = np.array([[1, 1, 1, 2, 0, 3, 3, 3]], np.int32)
    assert measures.overlaps(labels, truth, range(2, 4)) == [3 / 4, 2 / 3]


def test_the_shipped_settings_move_nothing_and_touch_the_surface() -> None:
    rows = rows_of(GRASP, {})
    assert len(rows) == 6
    assert all(row["moved"] is False and row["touch_counts"] == 0.0 for row in rows)
    assert {row["score_change"] for row in rows} <= {0.0, None}
    errors = [row["error_mm"] for row in rows]
    assert max(errors) < 6.0  # half a voxel, in which points of both faces of an edge may be averaged
    assert np.median(errors) < 1.5


def test_a_coarser_grid_loses_some_of_the_masks() -> None:
    (coarse,), (shipped,) = (
        measures.tabulate(SETTINGS, rows_of(SEGMENTATION, changes)) for changes in ({"grid_rows": 30}, {})
    )
    assert coarse["iou"] < shipped["iou"]
    assert shipped["iou_low"] <= shipped["iou"] <= shipped["iou_high"]
    assert shipped["score"] is None  # its time is not GeoGrasp's
    assert shipped["wrong_scenes"] == 0


def test_grasps_that_move_are_equal_better_or_worse() -> None:
    row = measures._moves(
        [{"moved": True, "score_change": change} for change in (0.05, 0.5, -0.5, -0.05)]
        + [{"moved": False, "score_change": 0.0}, {"moved": None, "score_change": None}]
    )
    assert row == {"moved": 0.8, "moved_equal": 0.5, "moved_better": 0.25, "moved_worse": 0.25}


def test_noise_of_the_points_moves_grasps_without_another_setting() -> None:
    rows = rows_of(GRASP, {}, jitter_mm=2.0)
    assert any(row["score_change"] for row in rows)


@pytest.mark.parametrize("detail", ["few", "all"])
def test_variants_are_settings_of_the_pipeline(detail: str) -> None:
    variants = find_area("perception").checked_variants(SETTINGS.replace(detail=detail))
    assert variants == list_variants(detail)
    shipped = Pipeline().config
    for one in variants:
        made = measures.pipeline_of(one.values["changes"], one.values["step"])
        assert (made.config == shipped) == (not one.values["changes"]), one.name


def test_segmentation_and_grasps_are_timed_on_one_cloud_after_the_other() -> None:
    for one in list_variants("few")[:2]:
        timed = measures.timed(one, SETTINGS, loaded())
        first, second = timed.answer(1), timed.answer(1)
        assert first.shape in ((3,), (6,))
        assert not np.array_equal(first, second)
