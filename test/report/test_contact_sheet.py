# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from foretouch.report.touch_figure import save_contact_sheet
from foretouch.types import Cloud, Grasp, GraspSample, Touch


def sample(pdc: float) -> GraspSample:
    points = np.random.default_rng(0).random((200, 3), np.float32)
    touch = Touch(pdc, pdc, np.linspace(1000.0, 3000.0, 24), np.full(24, 2000.0))
    grasp = Grasp(points[0].astype(np.float64), points[1].astype(np.float64), np.eye(3))
    return GraspSample("can/0", "can", Cloud(points), grasp, touch, extra={"force_th_n": 1.0})


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_sheet_has_a_row_for_two_samples(tmp_path, count) -> None:
    path = save_contact_sheet(tmp_path / "new" / "sheet.png", [sample(2000.0)] * count, "a title")
    height = matplotlib.image.imread(path).shape[0]
    assert height == pytest.approx(100 * (2.6 * max(1, -(-count // 2)) + 1.3), abs=2)


def test_an_unlabelled_sample_is_drawn_without_its_fingers(tmp_path) -> None:
    labelled = save_contact_sheet(tmp_path / "a.png", [sample(2000.0)]).read_bytes()
    unlabelled = save_contact_sheet(tmp_path / "b.png", [replace(sample(2000.0), touch=None)]).read_bytes()
    assert labelled != unlabelled


def test_a_sheet_has_one_scale_and_no_label_is_cut(tmp_path, monkeypatch) -> None:
    kept: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: kept.append(figure))
    save_contact_sheet(
        tmp_path / "a.png", [sample(2000.0), replace(sample(2100.0), id="a_long_name/000123")], "a title"
    )
    (figure,) = kept
    figure.canvas.draw()
    dots = [one for axes in figure.axes for one in axes.collections if len(one.get_offsets()) == 24]
    assert len(dots) == 4
    assert {one.get_clim() for one in dots} == {(1000.0, 3000.0)}
    assert sum(axes.get_label() == "<colorbar>" for axes in figure.axes) == 1
    drawn, page = figure.get_tightbbox(), figure.bbox_inches
    assert (drawn.x0 >= 0.0, drawn.y0 >= 0.0) == (True, True)
    assert (drawn.x1 <= page.x1, drawn.y1 <= page.y1) == (True, True)
