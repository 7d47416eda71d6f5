# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from sim_builders import CAN, run, scene

from foretouch.pipeline import FoundObject
from foretouch.report.touch_figure import DrawnGrasp, _agreement, _draw_front, _Scale, save_touch_picture
from foretouch.types import Plane, Touch, TouchPrediction


@pytest.fixture(scope="module")
def sample() -> tuple[FoundObject, TouchPrediction, Touch]:
    """An object, a prediction and a tare."""
    state = run(scene(CAN), "cloud", "grasp", "touch", "tare")
    target = FoundObject("1", state.cloud, Plane.from_coefficients([0, 0, -1, 1.25]))
    return target, TouchPrediction(state.grasp, state.touch), state.tare


def picture(path: Path, target: FoundObject, prediction: TouchPrediction, **options) -> np.ndarray:
    return imread(save_touch_picture(path, [DrawnGrasp(target=target, prediction=prediction, **options)]))[..., :3]


def test_what_was_read_is_beside_what_was_predicted(sample, tmp_path) -> None:
    target, prediction, tare = sample
    alone = picture(tmp_path / "a.png", target, prediction)
    both = picture(tmp_path / "new" / "b.png", target, prediction, rest=tare, read=prediction.value)
    assert both.shape[0] == alone.shape[0]
    assert both.shape[1] > 1.3 * alone.shape[1]


def test_a_second_grasp_takes_a_row_of_its_own(sample, tmp_path) -> None:
    target, prediction, _ = sample
    one = DrawnGrasp(target=target, prediction=prediction)
    alone, both = (imread(save_touch_picture(tmp_path / f"{k}.png", [one] * k)) for k in (1, 2))
    assert both.shape[0] > 1.8 * alone.shape[0]
    assert both.shape[1] == alone.shape[1]


def dots_of(figure: Figure) -> list:
    """Electrodes of all fingers of a figure."""
    return [dots for axes in figure.axes for dots in axes.collections if len(dots.get_offsets()) == 24]


def test_all_electrodes_have_one_scale_and_equal_touches_equal_colours(sample, tmp_path, monkeypatch) -> None:
    target, prediction, tare = sample
    drawn: list[Figure] = []
    monkeypatch.setattr("foretouch.report.touch_figure.save", lambda figure, path: drawn.append(figure) or path)
    other = Touch.from_vector(prediction.value.vector() - 500.0)
    rows = [
        DrawnGrasp(target=target, prediction=prediction, rest=tare, read=read) for read in (prediction.value, other)
    ]
    save_touch_picture(tmp_path / "a.png", rows)
    dots = dots_of(drawn[0])
    assert len(dots) == 8
    assert len({one.get_clim() for one in dots}) == 1
    np.testing.assert_array_equal(dots[0].get_array(), dots[1].get_array())  # predicted and read of the thumb
    np.testing.assert_allclose(dots[5].get_array() - dots[4].get_array(), 500.0)


def test_without_a_prediction_what_was_read_is_drawn_still(sample, tmp_path) -> None:
    target, prediction, tare = sample
    refused = replace(prediction, value=None, status="refused", reason="no usable model")
    nothing = picture(tmp_path / "a.png", target, refused)
    read = picture(tmp_path / "b.png", target, refused, rest=tare, read=prediction.value)
    assert (read < 0.9).sum() > 1.3 * (nothing < 0.9).sum()
    assert _agreement(DrawnGrasp(target=target, prediction=refused)) == "not predicted: no usable model"


def test_a_sentence_states_how_prediction_and_reading_agree(sample) -> None:
    target, prediction, _ = sample
    value = prediction.value.vector()
    low, high = (Touch.from_vector(value + shift) for shift in (-60.0, 60.0))
    shifted = value.copy()
    shifted[[0, 10, 11, 12]] += (-100.0, 50.0, 70.0, -80.0)
    one = DrawnGrasp(target=target, prediction=prediction, read=Touch.from_vector(shifted))
    text = "Predicted and read differ by 100 (thumb) and 0 (middle finger) counts of pressure, and by 4 counts an electrode"
    assert _agreement(one) == f"{text}."
    bounded = replace(one, prediction=replace(prediction, lower=low, upper=high))
    assert _agreement(bounded) == f"{text}; within their 90 % intervals: 1 of 2 pressures, 46 of 48 electrodes."
    assert _agreement(replace(one, read=None)) == ""


def test_an_interval_changes_the_predicted_pressures_alone(sample, tmp_path) -> None:
    target, prediction, tare = sample
    low, high = (Touch.from_vector(prediction.value.vector() + shift) for shift in (-60.0, 60.0))
    bounded = replace(prediction, lower=low, upper=high)
    plain, marked = (picture(tmp_path / "a.png", target, one, rest=tare) for one in (prediction, bounded))
    changed = np.flatnonzero((plain != marked).any(axis=(1, 2)))
    assert changed.size
    assert changed.max() < plain.shape[0] / 4  # in the titles


def test_the_contacts_are_named_by_their_fingers_within_the_axes(sample) -> None:
    target, prediction, _ = sample
    figure = Figure(figsize=(3, 3))
    axes = figure.add_subplot()
    _draw_front(axes, target.cloud, prediction.grasp)
    figure.canvas.draw()
    names = {text.get_text(): text for text in axes.texts}
    assert names.keys() == {"thumb", "middle finger"}
    for name, contact in (("thumb", prediction.grasp.g1), ("middle finger", prediction.grasp.g2)):
        assert names[name].xy == pytest.approx(contact[:2])
    boxes = [text.get_window_extent() for text in names.values()]
    assert not boxes[0].overlaps(boxes[1])
    assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_colours_are_the_drops_from_rest_within_the_limits_of_the_page(sample) -> None:
    _, prediction, tare = sample
    axes = Figure().add_subplot()
    far = Touch.from_vector(prediction.value.vector() - 500.0)
    scale = _Scale([(prediction.value, tare), (far, tare)])
    scale.draw(axes, prediction.value, tare, "TH")
    np.testing.assert_array_equal(axes.collections[0].get_array(), tare.e_th - prediction.value.e_th)
    drops = np.concatenate([tare.e_th - touch.e_th for touch in (prediction.value, far)])
    drops = np.concatenate([drops, *(tare.e_mf - touch.e_mf for touch in (prediction.value, far))])
    assert axes.collections[0].get_clim() == (drops.min(), drops.max())
