# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from foretouch.report.touch_figure import save_contact_sheet
from foretouch.types import Cloud, Grasp, GraspSample, Touch


def sample(pdc: float) -> GraspSample:
    points = np.random.default_rng(0).random((200, 3), np.float32)
    touch = Touch(pdc, pdc, np.linspace(1000.0, 3000.0, 24), np.full(24, 2000.0))
    grasp = Grasp(points[0].astype(np.float64), points[1].astype(np.float64), np.eye(3))
    return GraspSample("can/0", "can", Cloud(points), grasp, touch, extra={"force_th_n": 1.0})


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_sheet_has_a_row_for_two_samples(tmp_path: Path, count: int) -> None:
    path = save_contact_sheet(tmp_path / "new" / "sheet.png", [sample(2000.0)] * count, "a title")
    height = matplotlib.image.imread(path).shape[0]
    assert height == pytest.approx(100 * (2.9 * max(1, -(-count // 2)) + 0.4), abs=2)


def test_an_unlabelled_sample_is_drawn_without_its_fingers(tmp_path: Path) -> None:
    labelled = save_contact_sheet(tmp_path / "a.png", [sample(2000.0)]).read_bytes()
    unlabelled = save_contact_sheet(tmp_path / "b.png", [replace(sample(2000.0), touch=None)]).read_bytes()
    assert labelled != unlabelled
