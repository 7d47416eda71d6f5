# SPDX-License-Identifier: Apache-2.0
"""Figures of experiments draw what the table says, and hide nothing that lies outside of the panel."""

import pytest
from foretouch.experiments.cross_type.figure import draw_errors
from foretouch.experiments.framework.figures import FIGURES, draw_figures
from foretouch.experiments.shared.skill_figure import LEAST_SKILL, draw_skills
from foretouch.experiments.unseen_object.figure import draw_course
from matplotlib.figure import Figure


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


def test_a_skill_out_of_the_panel_is_told_at_its_edge(axes) -> None:
    draw_skills(axes, [{"predictor": "a", "skill": -7.25, "skill_low": -9.0, "skill_high": -3.0}], ["a"])
    assert ([LEAST_SKILL], [0.0]) in lines(axes)
    assert [text.get_text().strip() for text in axes.texts] == ["-7.2"]


def test_course_over_touches(axes) -> None:
    rows = [
        {"object": "cup", "touches": touches, "skill": skill, "skill_low": None, "skill_high": None}
        for touches, skill in ((10, 0.5), (0, -0.1), (3, 0.2))
    ]
    draw_course(axes, rows, "object", ["cup"])
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


def test_someone_s_own_experiment_has_no_figure(tmp_path) -> None:
    assert draw_figures("counting", [{"number": 1}], tmp_path) == []
    assert {"cross_validation", "time_blocked", "cross_type", "unseen_object"} <= set(FIGURES)


def test_a_course_out_of_the_panel_is_told_at_its_edge(axes) -> None:
    rows = [
        {"object": "cup", "touches": touches, "skill": skill, "skill_low": None, "skill_high": None}
        for touches, skill in ((0, -3.0), (1, -2.0), (3, 0.2))
    ]
    draw_course(axes, rows, "object", ["cup"], -0.5)
    assert [line for line in lines(axes) if len(line[0]) == 1] == [([0.0], [-0.5]), ([1.0], [-0.5])]
    assert axes.get_ylim() == (-0.5, 1.0)


def test_markers_at_one_table_stand_beside_each_other(axes) -> None:
    rows = [{"predictor": name, "table": "within", "rmse": 40.0} for name in ("mean", "trees", "contact")]
    draw_errors(axes, rows, ["within"])
    places = [places[0] for places, _ in lines(axes)]
    assert places == sorted(set(places))
    assert sum(places) == pytest.approx(0.0)
