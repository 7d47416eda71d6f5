# SPDX-License-Identifier: Apache-2.0
"""Figures of experiments draw the values of the table, and mark values outside of the panel."""

import pytest
from matplotlib.figure import Figure

from foretouch.experiments import find_experiment, list_experiments
from foretouch.experiments.cross_type import draw_errors
from foretouch.experiments.shared.skill import LOWEST_SKILL, draw_skills
from foretouch.experiments.unseen_object import draw_over_touches


@pytest.fixture
def axes():
    return Figure().subplots()


def lines(axes) -> list[tuple[list[float], list[float]]]:
    return [([*map(float, line.get_xdata())], [*map(float, line.get_ydata())]) for line in axes.lines]


def test_skill_and_interval(axes) -> None:
    rows = [
        {"predictor": "b", "skill": 0.3, "skill_low": 0.1, "skill_high": 0.4},
        {"predictor": "a", "skill": -0.2, "skill_low": None, "skill_high": None},
    ]
    draw_skills(axes, rows, ["a", "b"])
    assert ([0.3], [1.0]) in lines(axes)
    assert ([0.1, 0.4], [1.0, 1.0]) in lines(axes)
    assert ([-0.2], [0.0]) in lines(axes)


def test_a_skill_out_of_the_panel_is_marked_at_its_edge(axes) -> None:
    draw_skills(axes, [{"predictor": "a", "skill": -7.25, "skill_low": -9.0, "skill_high": -3.0}], ["a"])
    assert ([LOWEST_SKILL], [0.0]) in lines(axes)
    assert [text.get_text().strip() for text in axes.texts] == ["-7.2"]


def test_course_over_touches(axes) -> None:
    rows = [
        {"object": "cup", "touches": touches, "skill": skill, "skill_low": None, "skill_high": None}
        for touches, skill in ((10, 0.5), (0, -0.1), (3, 0.2))
    ]
    draw_over_touches(axes, rows, "object", ["cup"])
    assert ([0.0, 1.0, 2.0], [-0.1, 0.2, 0.5]) in lines(axes)
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0", "3", "10"]


def test_published_errors_stand_beside_ours(axes) -> None:
    rows = [
        {"predictor": "trees", "table": "within", "rmse": 40.0},
        {"predictor": "trees", "table": "across", "rmse": 80.0},
        {"predictor": "P1 (published)", "table": "across", "rmse": 165.0},
    ]
    draw_errors(axes, rows, ["within", "across"])
    assert lines(axes) == [([0.0, 1.0], [40.0, 80.0]), ([1.0], [165.0])]
    assert axes.get_ylim()[0] == 0.0


def test_an_experiment_may_have_no_figure(tmp_path) -> None:
    assert find_experiment("own_experiments.counting").draw([{"number": 1}], tmp_path) == []
    assert [one.name for one in list_experiments() if one.figure is None] == ["label_ratio_tuning"]


def test_a_course_out_of_the_panel_is_marked_at_its_edge(axes) -> None:
    rows = [
        {"object": "cup", "touches": touches, "skill": skill, "skill_low": None, "skill_high": None}
        for touches, skill in ((0, -3.0), (1, -2.0), (3, 0.2))
    ]
    draw_over_touches(axes, rows, "object", ["cup"], -0.5)
    assert [line for line in lines(axes) if len(line[0]) == 1] == [([0.0], [-0.5]), ([1.0], [-0.5])]
    assert axes.get_ylim() == (-0.5, 1.0)


def test_markers_at_one_table_stand_beside_each_other(axes) -> None:
    rows = [{"predictor": name, "table": "within", "rmse": 40.0} for name in ("mean", "trees", "contact")]
    draw_errors(axes, rows, ["within"])
    places = [places[0] for places, _ in lines(axes)]
    assert places == sorted(set(places))
    assert sum(places) == pytest.approx(0.0)
