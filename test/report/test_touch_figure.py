# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from sim_builders import CAN, run, scene

from foretouch.pipeline import FoundObject
from foretouch.report.touch_figure import draw_electrodes, save_touch_picture
from foretouch.types import Plane, Touch, TouchPrediction


@pytest.fixture(scope="module")
def sample() -> tuple[FoundObject, TouchPrediction, Touch]:
    """An object, a prediction and a tare."""
    state = run(scene(CAN), "cloud", "grasp", "touch", "tare")
    target = FoundObject("1", state.cloud, Plane.from_coefficients([0, 0, -1, 1.25]))
    return target, TouchPrediction(state.grasp, state.touch), state.tare


def test_what_was_read_takes_a_row_of_its_own(sample, tmp_path: Path) -> None:
    target, prediction, tare = sample
    alone = save_touch_picture(tmp_path / "a.png", None, target, prediction)
    both = save_touch_picture(tmp_path / "new" / "b.png", None, target, prediction, rest=tare, read=prediction.value)
    assert imread(both).shape[0] > 1.5 * imread(alone).shape[0]


def test_equal_touches_are_drawn_alike(sample, tmp_path: Path) -> None:
    target, prediction, tare = sample
    path = save_touch_picture(tmp_path / "a.png", None, target, prediction, rest=tare, read=prediction.value)
    image = imread(path)[..., :3]
    half = image.shape[0] // 2
    columns = slice(2 * image.shape[1] // 3, None)
    dark = [float((part[:, columns].mean(axis=-1) < 0.6).mean()) for part in (image[:half], image[half:])]
    assert dark[0] == pytest.approx(dark[1], rel=0.05)


def test_without_a_prediction_what_was_read_is_drawn_still(sample, tmp_path: Path) -> None:
    target, prediction, tare = sample
    refused = replace(prediction, value=None, status="refused", reason="no usable model")
    nothing = imread(save_touch_picture(tmp_path / "a.png", None, target, refused))
    read = imread(save_touch_picture(tmp_path / "b.png", None, target, refused, rest=tare, read=prediction.value))
    assert (read < 0.9).mean() > 1.5 * (nothing < 0.9).mean()


def test_an_interval_stands_beside_the_predicted_pressure_and_not_beside_the_reading(sample, tmp_path: Path) -> None:
    target, prediction, tare = sample
    low, high = (Touch.from_vector(prediction.value.vector() + shift) for shift in (-60.0, 60.0))
    bounded = replace(prediction, lower=low, upper=high)
    plain = imread(save_touch_picture(tmp_path / "a.png", None, target, prediction, rest=tare, read=prediction.value))
    doubtful = imread(save_touch_picture(tmp_path / "b.png", None, target, bounded, rest=tare, read=prediction.value))
    changed = np.flatnonzero((plain != doubtful).any(axis=(1, 2)))
    assert changed.size
    assert changed.max() < plain.shape[0] / 2  # the predicted row is the upper one


def test_colours_are_the_drop_from_rest_within_the_limits() -> None:
    axes = Figure().add_subplot()
    electrodes, rest = np.linspace(3000.0, 2500.0, 24), np.full(24, 3100.0)
    draw_electrodes(axes, electrodes, rest, colour="red", limits=(0.0, 700.0))
    dots = axes.collections[0]
    np.testing.assert_array_equal(dots.get_array(), rest - electrodes)
    assert dots.get_clim() == (0.0, 700.0)
