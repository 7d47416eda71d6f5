# SPDX-License-Identifier: Apache-2.0
"""What the area `simulation` measures of a level of contact and of an effect."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from foretouch.errors import ConfigError
from foretouch.experiments.framework.experiment import Cell
from foretouch.tradeoff.area import find_area
from foretouch.tradeoff.areas.simulation import measures, variants

FOLDER = Path(__file__).parents[2] / "config" / "scenes"
SETTINGS = measures.SimulationSettings(compared=4, train=10, test=10, trees=2, finest_cells=24, detail="few")


@cache
def scenes() -> measures.Scenes:
    return measures.load(SETTINGS, FOLDER)


def measured(name: str) -> dict[str, object]:
    one = next(one for one in variants.list_variants("all", 24) if one.name == name)
    cell = Cell("one", {"variant": name, **one.values})
    (row,) = measures.tabulate(SETTINGS, [{**cell.values, **row} for row in measures.run(cell, SETTINGS, scenes())])
    return row


def test_the_finest_level_is_its_own_reference() -> None:
    row = measured("rigid: finest layer")
    assert row["pattern_error"] == row["force_error"] == row["trained_change"] == 0.0
    assert row["digits_rigid"] is None


def test_springs_are_nearly_right_on_rigid_objects_and_half_spaces_are_not() -> None:
    springs, spaces = measured("rigid: winkler 12x12"), measured("rigid: hertz 24x24")
    assert springs["pattern_error"] < 0.05
    assert spaces["pattern_error"] > 1.0
    assert springs["digits_rigid"] == pytest.approx(-np.log10(springs["pattern_error"]), rel=1e-4)
    assert springs["force_error"] < 1e-6  # the hand closes to a force
    assert springs["trained_rigid"] > spaces["trained_rigid"]
    assert springs["trained_deformables"] is None


def test_an_effect_that_is_left_out_changes_counts() -> None:
    row = measured("without noise")
    assert 1.0 < row["counts"] < 20.0  # its deviation is 4 to 5 counts in each of both
    assert row["effect_ms"] > 0.0
    assert row["trained_everything"] is not None


def test_all_variants_are_scenes() -> None:
    for detail in ("few", "all"):
        for one in find_area("simulation").checked_variants(SETTINGS.replace(detail=detail)):
            measures.changed_scene(one.values, scenes())


def test_a_folder_without_scenes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"holds no rigid.yaml; give the folder config/scenes"):
        measures.prepare(SETTINGS, tmp_path, tmp_path)


def test_times_are_of_one_sample_after_the_other() -> None:
    (first, *_) = variants.list_variants("few", 24)
    timed = measures.timed(first, SETTINGS, scenes())
    one, two = timed.answer(1), timed.answer(1)
    assert one.shape == (50,)
    assert not np.array_equal(one, two)
