# SPDX-License-Identifier: Apache-2.0
"""Pictures of predicted and read touches, and contact sheets of samples."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from constant_models import sensor_with_dead
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text
from scene_builders import scene_cloud
from sim_builders import CAN, run, scene

from foretouch.api import plan, segment
from foretouch.models import load_model
from foretouch.report.scene_figure import PANELS, draw_scene
from foretouch.report.touch_figure import DrawnGrasp, _agreement, save_contact_sheet, save_touch_picture
from foretouch.tactile import biotac_touch
from foretouch.tactile.description import packaged_sensor
from foretouch.types import ASSUMED_TABLE, Cloud, Grasp, Plane, Prediction, Sample, Touch
from foretouch.types.scene import Object

BIOTAC_SP = packaged_sensor("biotac_sp")


@pytest.fixture(scope="module")
def sample() -> tuple[Object, Prediction, Touch]:
    """An object, a prediction and a tare."""
    state = run(scene(CAN))
    target = Object.of("1", state.cloud, Plane.from_coefficients([0, 0, -1, 1.25]))
    return target, Prediction.of(state.grasp, state.touch), state.tare


def picture(path: Path, target: Object, prediction: Prediction, **options) -> np.ndarray:
    return imread(save_touch_picture(path, [DrawnGrasp(target=target, prediction=prediction, **options)]))[..., :3]


def dots_of(figure: Figure) -> list:
    """Electrodes of all fingers of a figure, with their levels."""
    return [dots for dots in discs_of(figure) if dots.get_array() is not None and len(dots.get_offsets()) == 24]


def discs_of(figure: Figure) -> list[EllipseCollection]:
    """All discs and rings."""
    return [dots for axes in figure.axes for dots in axes.collections if isinstance(dots, EllipseCollection)]


def test_all_electrodes_have_one_scale_and_equal_touches_equal_colours(sample, tmp_path, monkeypatch) -> None:
    target, prediction, tare = sample
    drawn: list[Figure] = []
    monkeypatch.setattr("foretouch.report.touch_figure.save", lambda figure, path, dpi: drawn.append(figure) or path)
    other = biotac_touch(prediction.value.values - 500.0)
    rows = [
        DrawnGrasp(target=target, prediction=prediction, rest=tare, read=read) for read in (prediction.value, other)
    ]
    save_touch_picture(tmp_path / "a.png", rows)
    dots = dots_of(drawn[0])
    assert len(dots) == 8
    drops = [tare["E_TH"] - prediction.value["E_TH"], tare["E_MF"] - prediction.value["E_MF"]]
    np.testing.assert_array_equal(dots[0].get_array(), drops[0])  # from rest, within the limits of the page
    most = np.percentile(np.abs([drops, drops, np.add(drops, 500.0), drops]), 98.0)
    assert {dot.get_clim() for dot in dots} == {(-most, most)}  # at rest is the middle of the colours
    np.testing.assert_array_equal(dots[0].get_array(), dots[1].get_array())  # predicted and read of the thumb
    np.testing.assert_allclose(dots[5].get_array() - dots[4].get_array(), 500.0)


def test_the_image_has_the_distance_of_the_object_whatever_its_table(sample, tmp_path, monkeypatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr("foretouch.report.touch_figure.save", lambda figure, path, dpi: drawn.append(figure) or path)
    scene = segment(scene_cloud(1))
    target = replace(scene.objects[0], plane=ASSUMED_TABLE)
    save_touch_picture(tmp_path / "a.png", [DrawnGrasp(prediction=sample[1], target=target, scene=scene.cloud)])
    distance = np.linalg.norm(target.cloud.xyz.mean(axis=0))
    assert drawn[0].axes[0].get_title().startswith(f"what the camera sees, {distance:.2f} m away,")


def test_a_sentence_states_the_agreement_and_an_interval_changes_predicted_pressures_alone(sample, tmp_path) -> None:
    target, prediction, tare = sample
    value = prediction.value.values
    low, high = (biotac_touch(value + shift) for shift in (-60.0, 60.0))
    shifted = value.copy()
    shifted[[0, 10, 11, 12]] += (-100.0, 50.0, 70.0, -80.0)
    one = DrawnGrasp(target=target, prediction=prediction, read=biotac_touch(shifted))
    assert _agreement(one, BIOTAC_SP) == "mean difference: E 4 counts"
    bounded = replace(one, prediction=Prediction.of(prediction.grasp, prediction.value, low, high))
    text = "mean difference: E 4 counts; within their 90 % intervals: 46 of 48 E, 1 of 2 PDC"
    assert _agreement(bounded, BIOTAC_SP) == text
    assert _agreement(replace(one, read=None), BIOTAC_SP) == ""
    plain, marked = (picture(tmp_path / "a.png", target, one, rest=tare) for one in (prediction, bounded.prediction))
    assert (plain != marked).any()  # by the rings of the electrodes


def test_electrodes_that_were_read_outside_of_their_intervals_have_a_square(sample, tmp_path, monkeypatch) -> None:
    target, prediction, tare = sample
    drawn: list[Figure] = []
    monkeypatch.setattr("foretouch.report.touch_figure.save", lambda figure, path, dpi: drawn.append(figure) or path)
    value = prediction.value.values
    low, high = (biotac_touch(value + shift) for shift in (-60.0, 60.0))
    shifted = value.copy()
    # a pressure; an electrode inside, and one of each finger outside
    shifted[[0, 10, 11, 40]] += (-100.0, 50.0, 70.0, -80.0)
    bounded = Prediction.of(prediction.grasp, prediction.value, low, high)
    without = DrawnGrasp(prediction=bounded, read=biotac_touch(shifted), rest=tare)  # no object to draw
    save_touch_picture(tmp_path / "a.png", [without, replace(without, target=target)])
    squares = [line.get_xydata() for axes in drawn[0].axes for line in axes.lines if len(line.get_xydata()) == 5]
    places = 1e3 * BIOTAC_SP.layout.unrolled
    np.testing.assert_allclose(np.mean([square[:4] for square in squares], axis=1), places[[9, 14, 9, 14]])


def test_the_rings_are_as_wide_as_the_intervals(sample, tmp_path, monkeypatch) -> None:
    _, prediction, tare = sample
    drawn: list[Figure] = []
    monkeypatch.setattr("foretouch.report.touch_figure.save", lambda figure, path, dpi: drawn.append(figure) or path)
    value, half = prediction.value.values, np.tile(np.linspace(10.0, 200.0, 25), 2)
    bounded = Prediction.of(prediction.grasp, prediction.value, biotac_touch(value - half), biotac_touch(value + half))
    save_touch_picture(tmp_path / "a.png", [DrawnGrasp(prediction=bounded, rest=tare)])
    rings, discs = (np.concatenate([one.get_widths() for one in discs_of(drawn[0]) if (one.get_array() is None) == ring]) for ring in (True, False))  # fmt: skip
    np.testing.assert_allclose((rings - discs) / half[2:], (rings - discs)[0] / half[2])
    assert "the widest ±200 counts" in drawn[0].axes[-1].get_xlabel()


def test_a_grasp_is_compared_with_its_own_reading_before_and_after(sample, tmp_path, monkeypatch) -> None:
    target, prediction, tare = sample
    drawn: list[Figure] = []
    monkeypatch.setattr("foretouch.report.touch_figure.save", lambda figure, path, dpi: drawn.append(figure) or path)
    value = prediction.value.values
    before = Prediction.of(prediction.grasp, biotac_touch(value - 40.0))
    one = DrawnGrasp(prediction=prediction, earlier=before, target=target, rest=tare, read=biotac_touch(value))
    save_touch_picture(tmp_path / "a.png", [one])
    texts = _agreement(one, BIOTAC_SP).splitlines()
    assert texts == ["before the first touch: mean difference: E 40 counts", "after: mean difference: E 0 counts"]
    after, read, *_ = (dots.get_array() for dots in dots_of(drawn[0]))
    np.testing.assert_array_equal(after, read)
    heads = [text.get_text() for axes in drawn[0].axes for text in axes.texts if text.get_fontweight() == "bold"]
    assert [head for head in heads if "finger" not in head and head != "thumb"] == ["predicted", "read"]


def smallest_text(figure: Figure) -> float:
    """The smallest text of a figure [pt], where it is shown: at most 7.67 inches (736 pixels) wide."""
    figure.canvas.draw()
    sizes = [text.get_fontsize() for text in figure.findobj(Text) if text.get_visible() and text.get_text()]
    return min(sizes) * min(1.0, 7.67 / figure.get_figwidth())


@pytest.mark.parametrize("panels", [PANELS, ("image",), ("touch", "side")])
def test_no_text_is_smaller_than_seven_points_where_it_is_shown(panels, monkeypatch, tmp_path) -> None:
    found = segment(scene_cloud(1))
    grasps = plan(found.objects[0], count=1)
    touch = load_model().predict(found.objects[0], grasps)
    assert smallest_text(draw_scene(found, grasps, touch, panels=panels)) >= 7.0
    drawn: list[Figure] = []
    monkeypatch.setattr("foretouch.report.touch_figure.save", lambda figure, path, dpi: drawn.append(figure) or path)
    save_touch_picture(
        tmp_path / "a.png", [DrawnGrasp(prediction=touch[0], target=found.objects[0], read=touch[0].value)]
    )
    save_contact_sheet(tmp_path / "a.png", [labelled()])
    assert min(map(smallest_text, drawn)) >= 7.0


def labelled(pdc: float = 2000.0) -> Sample:
    points = np.random.default_rng(0).random((200, 3), np.float32)
    touch = biotac_touch(np.hstack([pdc, pdc, np.linspace(1000.0, 3000.0, 24), np.full(24, 2000.0)]))
    grasp = Grasp(points[0].astype(np.float64), points[1].astype(np.float64), np.eye(3))
    return Sample("can/0", "can", Cloud(points), grasp, touch, extra={"force_th_n": 1.0})


def test_a_sheet_has_one_scale_and_no_label_is_cut(tmp_path, monkeypatch) -> None:
    kept: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: kept.append(figure))
    unlabelled = replace(labelled(), touch=None)
    save_contact_sheet(tmp_path / "a.png", [labelled(), replace(labelled(2100.0), id="a_long_name/000123"), unlabelled])
    (figure,) = kept
    figure.canvas.draw()
    dots = dots_of(figure)
    assert len(dots) == 4
    assert len({dot.get_clim() for dot in dots}) == 1
    assert all(1000.0 <= end <= 3000.0 for end in dots[0].get_clim())
    drawn, page = figure.get_tightbbox(), figure.bbox_inches
    assert drawn.x0 >= 0.0 <= drawn.y0
    assert (drawn.x1 <= page.x1 + 1e-9, drawn.y1 <= page.y1 + 1e-9) == (True, True)


def of_any_sensor(name: str, rng: np.random.Generator, *dead: int) -> tuple:
    """A sensor, with dead taxels, and a reading that a blunt contact in the middle of each pad changes, with its rest."""
    sensor = sensor_with_dead(name, *dead)
    tared = sensor.taxel_channels[0].tared
    rest = np.where(not tared, 0.0, 1000.0 + rng.normal(0.0, 5.0, sensor.channels.size))
    places = sensor.layout.positions
    near = np.exp(-((places - places.mean(axis=0)) ** 2).sum(axis=1) / (2.0 * 0.003**2))
    values = rest.copy()
    for k, channel in enumerate(sensor.taxel_channels):
        size = (1500.0 if channel.tared else 0.1) * (1.0 if channel.name in ("Z", "BZ", "normal") else -0.2)
        values[sensor.taxel_columns[..., k]] += size * near
    return sensor, Touch(values, sensor.channels), Touch(rest, sensor.channels)


def test_a_sensor_of_any_layout_is_drawn_by_its_chosen_channel_and_dead_taxels_are_hollow(
    sample, tmp_path, monkeypatch, rng
) -> None:
    target, prediction, _ = sample
    drawn: list[Figure] = []
    monkeypatch.setattr("foretouch.report.touch_figure.save", lambda figure, path, dpi: drawn.append(figure) or path)
    sensor, touch, rest = of_any_sensor("xela_uskin_4x4", rng, 5, 6)
    predicted = Prediction.of(prediction.grasp, touch)
    save_touch_picture(
        tmp_path / "a.png", [DrawnGrasp(prediction=predicted, target=target, rest=rest, read=touch)], sensor
    )
    dots = discs_of(drawn[0])
    taxels = [dot for dot in dots if dot.get_array() is not None]
    assert [len(taxel.get_offsets()) for taxel in taxels] == [14, 14, 16, 16]  # of both fingers, predicted and read
    hollow = [dot for dot in dots if not len(dot.get_facecolor())]
    assert [len(one.get_offsets()) for one in hollow] == [2, 2]
    change = (touch.values - rest.values)[sensor.taxel_columns[1, :, 2]]
    np.testing.assert_array_equal(taxels[2].get_array(), change)  # Z, from rest
    low, high = taxels[0].get_clim()
    assert low == -high < 0.0 < high <= np.abs(change).max()  # it may rise or fall
    assert sorted(axes.get_title() for axes in drawn[0].axes[1:5]) == ["FF", "FF", "thumb", "thumb"]
    assert "change of Z from rest [counts]" in drawn[0].axes[-1].get_xlabel()
    assert "hollow: dead" in drawn[0].axes[-1].get_xlabel()
