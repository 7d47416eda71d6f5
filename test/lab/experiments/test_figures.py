# SPDX-License-Identifier: Apache-2.0
"""Figures of experiments draw the values of the table, and mark values outside of the panel."""

import pytest
from matplotlib.figure import Figure

from foretouch.tactile import MODALITIES
from foretouch_lab.experiments.shared import figures
from foretouch_lab.experiments.shared.figures import draw_intervals, draw_series


@pytest.fixture
def axes():
    return Figure().subplots()


def lines(axes) -> list[tuple[list[float], list[float]]]:
    return [([*map(float, line.get_xdata())], [*map(float, line.get_ydata())]) for line in axes.lines]


def row(name: str, skill: float, low: float | None = None, high: float | None = None, **more) -> dict:
    return {"predictor": name, "skill": skill, "skill_low": low, "skill_high": high, **more}


def test_skills_with_intervals_one_below_the_other(axes) -> None:
    rows = [row("b", 0.3, 0.1, 0.4), row("a", -0.2), row("c", -7.25, -9.0, -3.0)]
    draw_intervals(axes, rows, "predictor", ["a", "b", "c"])
    assert ([0.3], [1.0]) in lines(axes)
    assert ([0.1, 0.4], [1.0, 1.0]) in lines(axes)
    assert ([-0.2], [0.0]) in lines(axes)
    assert ([-1.5], [2.0]) in lines(axes)  # out of the panel: an arrow at its edge, with the number
    assert [text.get_text().strip() for text in axes.texts] == ["-7.2"]


def test_lines_over_touches(axes) -> None:
    rows = [row("a", skill, skill - 0.1, skill + 0.1, touches=n) for n, skill in ((10, 0.5), (0, -3.0), (3, 0.2))]
    draw_series(axes, rows, "touches", "predictor", ["a"], lowest=-0.5)
    assert ([0.0, 1.0, 2.0], [-3.0, 0.2, 0.5]) in lines(axes)
    assert ([2.0, 2.0], [0.4, 0.6]) in lines(axes)
    assert [line for line in lines(axes) if len(line[0]) == 1] == [([0.0], [-0.5])]
    assert axes.get_ylim() == (-0.5, 1.0)
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0", "3", "10"]


def test_each_line_has_a_panel_for_each_modality(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []
    monkeypatch.setattr(figures, "save_small", lambda figure, path: drawn.append(figure) or path)
    rows = [{"modality": name, "value": k} for k, name in enumerate(MODALITIES)]

    def draw(axes, own) -> None:
        axes.plot([row["value"] for row in own], label="a")

    places = (("above", "right upper"), ("", ""))
    lines = [figures.Line(1.0, rows, draw, title, legend=place) for title, place in places]
    assert figures.save_panels(tmp_path / "a.png", 8.0, lines, sharex=True) == [tmp_path / "a.png"]
    axes = drawn[0].axes
    assert [one.get_title() for one in axes[3:5]] == ["above: E_MF", "PDC_TH"]
    assert [one.lines[0].get_ydata().tolist() for one in axes] == [[k] for k in range(4)] * 2
    assert len(drawn[0].legends) == 1
