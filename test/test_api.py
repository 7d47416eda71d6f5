# SPDX-License-Identifier: Apache-2.0
"""`import foretouch`: the library as the front door."""

import copy
import gc
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case
from experiment_samples import make_samples
from recording_builders import write_grasps

import foretouch as ft
from foretouch.errors import CloudError, ConfigError, DatasetError, GraspError, ModelError, TactileError
from foretouch.pipeline import Pipeline

TABLE = Path(__file__).parents[1] / "examples" / "data" / "table.npz"


@pytest.fixture(scope="module")
def scene() -> ft.Scene:
    return ft.segment(ft.read_cloud(TABLE))


@pytest.fixture(scope="module")
def depth() -> tuple[np.ndarray, np.ndarray]:
    """A depth image in millimetres of the table, and its intrinsics, fitted to the rays of the cloud."""
    xyz = ft.read_cloud(TABLE).xyz.astype(np.float64)
    rays = xyz[..., :2] / xyz[..., 2:]
    known = np.isfinite(rays).all(axis=2)
    v, u = np.indices(known.shape)
    fx, cx = np.polyfit(rays[..., 0][known], u[known], 1)
    fy, cy = np.polyfit(rays[..., 1][known], v[known], 1)
    return np.nan_to_num(1e3 * xyz[..., 2]).round().astype(np.uint16), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def test_the_front_door_loads_nothing_until_it_is_used_and_every_name_is_there():
    program = "import sys, foretouch; sys.exit('numpy' in sys.modules or 'torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
    assert all(getattr(ft, name) is not None for name in ft.__all__)
    assert {*dir(ft), "__version__"} == set(ft.__all__)
    with pytest.raises(AttributeError, match="did you mean Cloud"):
        _ = ft.Clouds


def test_from_depth_to_touch_in_five_lines_is_the_pipeline_bit_by_bit(depth):
    image, K = depth
    scene = ft.segment(ft.Cloud.from_depth(image, K))
    grasps = ft.plan(scene.objects[0])
    touch = ft.load_model().predict(scene.objects[0], grasps)
    assert (grasps.g1.shape, grasps.pose.shape, grasps.score.shape) == ((1, 3), (1, 4, 4), (1,))
    assert (touch["E"].value.shape, touch["PDC"].upper.shape) == ((1, 2, 24), (1, 2))
    (result,) = ft.Pipeline().run(ft.Cloud.from_depth(image, K)).targets
    for name in ("g1", "g2", "rotation", "score", "object_id"):
        np.testing.assert_array_equal(getattr(grasps, name), getattr(result.plan.grasps, name))
    for end in ("value", "lower", "upper"):
        np.testing.assert_array_equal(getattr(touch, end), getattr(result.predictions, end))
    np.testing.assert_allclose(grasps.pose[0, :3, 3], (grasps.g1[0] + grasps.g2[0]) / 2)
    np.testing.assert_array_equal(grasps.pose[0, :3, :3], grasps[0].rotation)


def test_an_object_is_found_by_its_pixel_and_by_a_point_and_what_is_there_else_is_named(scene):
    for object_ in scene.objects:
        v, u = np.divmod(object_.pixels[len(object_.pixels) // 2], scene.labels.shape[1])
        assert scene.at(int(u), int(v)) is object_
        assert scene.near(object_.cloud.xyz[0]) is object_
        np.testing.assert_allclose(object_.centroid, object_.cloud.xyz.astype(float).mean(axis=0))
    hole = np.array(scene.cloud.xyz)
    hole[0, 0] = np.nan
    assert scene.table is not None
    cases = [
        (scene.at, (5, 5), r"pixel: \(5, 5\) is the table; the objects are 1, 2, 3, 4"),
        (
            scene.at,
            (231.4, 184.0),
            r"pixel: \(231\.4, 184\.0\) is not two whole numbers, column and row; round a click",
        ),
        (scene.at, (0, 999), r"pixel: \(0, 999\) is outside of the image, whose columns end at 479, rows at 359"),
        (ft.segment(ft.Cloud(hole)).at, (0, 0), r"pixel: \(0, 0\) is a pixel without depth"),
        (ft.segment(ft.Cloud(hole.reshape(-1, 3))).at, (0, 0), "has no pixels; select the object by a point"),
        (
            scene.near,
            ([0.0, 0.0, 0.5],),
            r"point: no object within 0\.03 m of \(0, 0, 0\.5\); the nearest is 0\.\d+ m away",
        ),
        *((scene.near, (point,), "point: .* is not ") for point in ([0.0, np.nan, 0.5], "here", [0, [0], 0])),
        (scene.near, (scene.objects[0].centroid, np.nan), "point: no object within nan m"),
        (scene.at, (True, False), r"pixel: \(True, False\) is not two whole numbers"),
        (ft.Object.of, (3, scene.cloud, scene.table), "id: 3 is not a text, such as '1'"),
        (ft.Object.of, ("3", scene.cloud.xyz, scene.table), "cloud: ndarray is not a Cloud"),
        (ft.Object.of, ("3", scene.cloud, (0, 0, -1, 1)), "plane: tuple is not a Plane"),
        (ft.plan, (replace(scene.objects[0], background="enters_view"),), r"target: is background \(enters_view\)"),
        (Pipeline().plan, (scene.cloud,), r"target: \w*Cloud is not an object of a scene"),
        (ft.load_model().predict, (scene.cloud.xyz, []), "cloud: ndarray is neither an object of a scene, such as"),
        (ft.segment, (scene.cloud.xyz,), r"cloud: ndarray is not a Cloud, such as Cloud\.from_depth\(depth, K\)"),
        (Pipeline().run, (None,), "cloud: None is not a Cloud"),
        (Pipeline().run, (scene.cloud.xyz,), "cloud: ndarray is not a Cloud"),
        (
            Pipeline().run,
            (scene.cloud, (0, 0, 1, -1)),
            r"plane: tuple is not a Plane, such as Plane\.from_coefficients",
        ),
        (ft.plan, (scene,), r"target: Scene is not an object of a scene, such as segment\(cloud\)\.objects\[0\]"),
        (ft.plan, (scene.cloud,), r"target: \w*Cloud is not an object .*; Pipeline\(\)\.run\(cloud, plane\) takes"),
    ]

    def check(find, arguments, message):
        with pytest.raises(CloudError, match=message):
            find(*arguments)

    every_case(cases, check)


def test_lists_become_arrays_and_what_is_no_grasp_reading_model_or_setting_is_refused(scene, tmp_path):
    model, target = ft.load_model(), scene.objects[0]
    grasps = ft.plan(target)
    listed = ft.Grasp(*(getattr(grasps[0], name).tolist() for name in ("g1", "g2", "rotation")))
    np.testing.assert_array_equal(model.predict(target, [listed]).value, model.predict(target, grasps).value)
    assert ft.Touch([0] * 50, model.sensor.channels).values.dtype == np.float64
    history = ft.History(model)
    sample = make_samples(1, 1)[0]
    cases = [
        (GraspError, ft.Grasp, ("left", listed.g2, listed.rotation), "g1: left is not of numbers"),
        (TactileError, ft.Touch, ([[1.0], [1.0, 2.0]], model.sensor.channels), "touch: .* is not of numbers"),
        (GraspError, model.predict, (target, listed), r"grasps: Grasp is not a sequence; of one grasp pass \[grasp\]"),
        (GraspError, Pipeline().predict, (target, None), "grasps: NoneType is not a sequence"),
        (GraspError, model.predict, (target, iter([listed])), "grasps: list_iterator is not a sequence"),
        (GraspError, model.predict, (target, [(listed.g1, listed.g2)]), r"grasps: holds tuple, not Grasp\(g1, g2"),
        (GraspError, ft.draw, (scene, listed), "grasps: Grasp is not a sequence"),
        (ConfigError, ft.draw, (scene.cloud,), "scene: Cloud is neither a Scene"),
        (TactileError, history.tare, (np.zeros(50),), r"tare: ndarray is not a Touch, such as Touch\(values, model"),
        (TactileError, history.touched, (target, listed, np.zeros(50)), "touched: ndarray is not a Touch"),
        (ModelError, ft.History, ("contact-v3",), r"model: contact-v3 is not a TouchModel, such as load_model\(\)"),
        (ConfigError, ft.Pipeline, ({"grasp": {"count": 3}},), "config: dict is not a PipelineConfig, such as"),
        (ConfigError, ft.Stream, (ft.PipelineConfig(),), "config: PipelineConfig is not a StreamConfig, such as"),
        (
            CloudError,
            ft.Stream().plan,
            ([scene],),
            r"target: Scene is not an object of a scene, such as segment\(cloud\)",
        ),
        (DatasetError, ft.fit, ([sample] * 3,), f"3 samples have the id '{sample.id}': give each another name after"),
        (
            DatasetError,
            ft.write,
            (tmp_path / "set", [replace(sample, id="s0")]),
            "'s0' is not .*; leave it empty for a",
        ),
    ]

    def check(error, call, arguments, message):
        with pytest.raises(error, match=message):
            call(*arguments)

    every_case(cases, check)


def test_columns_select_join_and_refuse_what_does_not_fit(scene):
    grasps = ft.plan(scene.objects[0], count=4)
    assert len(grasps) > 2
    assert [grasp.score for grasp in grasps] == grasps.score.tolist()
    np.testing.assert_array_equal(grasps[1:].g1, grasps.g1[1:])
    np.testing.assert_array_equal(ft.Grasps.join([grasps[:1], grasps[1:]]).rotation, grasps.rotation)
    np.testing.assert_array_equal(grasps[grasps.score < grasps.score[0]].g1, grasps.g1[1:])
    np.testing.assert_array_equal(grasps[[True, False, True, *[False] * (len(grasps) - 3)]].g1, grasps.g1[[0, 2]])
    assert len(grasps[[]]) == 0
    assert [one.g1.tolist() for one in ft.Grasps.of(list(grasps))] == grasps.g1.tolist()
    with pytest.raises(GraspError, match=r"g2: shape \(1, 3\) is not \(2, 3\)"):
        ft.Grasps(np.zeros((2, 3)), np.zeros((1, 3)), np.zeros((2, 3, 3)))
    unsound = grasps.replace(g1=np.vstack([grasps.g2[:1], np.full((1, 3), np.nan), grasps.g1[2:]]))
    touch = ft.load_model().predict(scene.objects[0], unsound)
    assert touch.status[:2].tolist() == ["bad_grasp"] * 2
    assert touch.ok[2:].all()
    assert np.isnan(touch["E"].value[:2]).all()
    with pytest.raises(GraspError, match=r"g1: .* is not finite"):
        _ = touch[1].grasp
    with pytest.raises(TactileError, match="channel: 'F' is not one of PDC, E"):
        _ = touch["F"]
    with pytest.raises(TactileError, match="message: int is not a TouchPrediction, TouchPredictionBatch or"):
        ft.reading(3)
    swapped = touch.put([0], touch[[2]])
    np.testing.assert_array_equal(swapped.value[0], touch.value[2])
    for mask in (touch.ok, touch.ok.tolist()):
        marked = touch.flagged("late", mask)
        assert ["late" in own for own in marked.flags] == touch.ok.tolist()
    none = ft.plan(scene.objects[0], config=ft.PipelineConfig.from_mapping({"hand": {"opening_m": 0.02}}))
    assert (len(none), none.status) == (0, "no_grasp")
    unfelt = ft.load_model().predict(scene.objects[0], none)
    assert (unfelt["E"].value.shape, unfelt["PDC"].lower.shape, unfelt["PDC_TH"].upper.shape) == (
        (0, 2, 24),
        (0, 2),
        (0, 1),
    )
    assert "hand.opening_m" in none.reason


def test_predictions_adapt_to_touches_and_go_on_from_a_file(scene, tmp_path):
    model, target = ft.load_model(), scene.objects[0]
    grasps = ft.plan(target, count=2)
    vision = model.predict(target, grasps)
    hand, second = ft.History(model), 1_000_000_000
    read = ft.Touch(vision.value[0] - 60.0, vision.channels)
    hand.touched(target, grasps[0], read, stamp_ns=second)
    after = hand.predict(target, grasps, stamp_ns=2 * second)
    assert (after[0].reference, after[0].evidence.touches) == ("touches", 1)
    twin = copy.copy(hand)
    twin.touched(target, grasps[0], read, stamp_ns=2 * second)
    assert (hand.touches, twin.touches) == (1, 2)
    moved = after.value[0] - vision.value[0]
    assert (moved < 0).all()
    hand.save(tmp_path / "hand.safetensors")
    again = ft.History.load(tmp_path / "hand.safetensors", model)
    np.testing.assert_array_equal(again.predict(target, grasps, stamp_ns=2 * second).value, after.value)
    other = hand.predict(scene.objects[1], ft.plan(scene.objects[1]), stamp_ns=2 * second)
    assert other[0].reference == "history"
    for number, reference in enumerate(("touches", "history")):  # the model finds out which object it is, too
        target = scene.objects[number]
        assert model.predict(target, ft.plan(target), history=hand)[0].reference == reference
    with pytest.raises(TactileError):
        hand.tare(ft.Touch(np.full(50, -5.0), vision.channels), stamp_ns=2 * second)


def test_a_dataset_is_columns_and_parts(tmp_path):
    write_grasps(tmp_path / "session")
    samples = ft.open(tmp_path / "session")
    arrays = samples.to_arrays()
    assert arrays["E"].shape == (len(arrays["id"]), 2, 24)
    for row, sample in enumerate(one for one in samples if one.touch is not None):
        np.testing.assert_array_equal(arrays["touch"][row], sample.touch.values)
        np.testing.assert_array_equal(arrays["E"][row, 1], sample.touch["E_MF"])
        np.testing.assert_array_equal(arrays["g1"][row], sample.grasp.g1)
    folds = samples.split("object")
    assert len(folds) == len(set(arrays["object"]))
    for train, test in folds:
        assert not {one.object for one in train} & {one.object for one in test}
        assert len(train) + len(test) == len(arrays["id"])
    with pytest.raises(DatasetError, match="split: 'objects' is not one of"):
        samples.split("objects")
    with pytest.raises(DatasetError, match=rf"{len(samples)} is not the number of a sample, 0 to {len(samples) - 1}"):
        samples.subset([0, len(samples)])


@pytest.mark.filterwarnings("error:Implicitly cleaning up", "error::pytest.PytestUnraisableExceptionWarning")
def test_a_fitted_model_predicts_and_is_loaded_again(tmp_path):
    samples = make_samples(3, 12)
    model = ft.fit(samples, calibrate=False, contact={"trees": 3})
    one = samples[0]
    predicted = model.predict(one.cloud, [one.grasp])
    assert np.abs(predicted.value[0] - one.touch.values).mean() < 300.0
    model.save(tmp_path / "mine")
    loaded = ft.load_model(tmp_path / "mine")
    np.testing.assert_array_equal(loaded.predict(one.cloud, [one.grasp]).value, predicted.value)
    with pytest.raises(ft.ForetouchError, match="exists already"):
        model.save(tmp_path / "mine")
    with pytest.raises(ModelError, match="was not loaded from files"):
        ft.TouchModel(model.predictor, model.card).save(tmp_path / "other")
    assert model.path is not None
    folder = model.path.parent
    assert folder.exists()
    del model
    gc.collect()
    assert not folder.exists()


def test_the_drawing_has_what_is_given(scene, tmp_path):
    grasps = ft.plan(scene.objects[0], count=2)
    touch = ft.load_model().predict(scene.objects[0], grasps)
    whole = ft.draw(scene, grasps, touch, path=tmp_path / "a.png", number=1)
    assert (tmp_path / "a.png").stat().st_size > 10_000
    image, above, side, *fingers, scale = whole.axes
    assert {text.get_text() for text in image.texts} == {"1", "2", "3", "4", "g1", "g2"}
    corners = image.patches[0].get_xy()  # of the table, in pixels: all around the objects
    rows, columns = np.nonzero(scene.labels)
    assert (corners.min(axis=0) < (columns.min(), rows.min())).all()
    assert (corners.max(axis=0) > (columns.max(), rows.max())).all()
    assert {"g1", "g2"} <= {text.get_text() for text in (*above.texts, *side.texts)}
    for axes, electrodes in zip(fingers, touch["E"].value[1], strict=True):
        np.testing.assert_allclose(axes.collections[-1].get_array(), electrodes)
    assert "90 % interval" in scale.get_xlabel()
    fallen = ft.draw(scene, grasps, touch, rest=ft.load_model().rest).axes[3].collections[-1].get_array()
    np.testing.assert_allclose(fallen, ft.load_model().rest["E"][0] - touch["E"].value[0, 0])
    assert [len(ft.draw(scene, grasps, touch, panels=one).axes) for one in (["image"], ["touch"], ["above", "side"])] == [1, 3, 2]  # fmt: skip
    with pytest.raises(ConfigError, match="panels: 'bars' is not one of image, touch, above, side"):
        ft.draw(scene, panels=["bars"])
    for wrong, rule in (({"panels": "image"}, "panels: image is not a list"), ({"rest": 3}, "rest: 3 is not a Touch")):
        with pytest.raises(ft.ForetouchError, match=rule):
            ft.draw(scene, **wrong)
    assert len(ft.draw(scene).axes) == 1
    views = ft.draw(scene.objects[0], grasps).axes
    assert len(views) == 2
    legends = [axes.get_legend() for axes in views if axes.get_legend() is not None]
    assert {text.get_text() for legend in legends for text in legend.get_texts()} == {"not seen"}
    table = scene.objects[0].plane
    away = replace(scene.objects[0], plane=ft.Plane(-table.normal, -table.offset))  # as a user may state it
    assert (
        min(ft.draw(away, grasps).axes[1].collections[0].get_offsets()[:, 1]) > -10.0
    )  # objects stand above the table
    refused = ft.Predictions.refused(grasps, touch.channels, "refused", "too wide")
    assert "too wide" in ft.draw(scene, grasps, refused).axes[-1].texts[0].get_text()
    priced = replace(scene.objects[0], id="5$ or $x^{")  # no formula
    ft.draw(priced, ft.plan(priced)).canvas.draw()
    ft.draw(priced, ft.plan(priced), path=tmp_path / "b.svg")
    with pytest.raises(ConfigError, match="number: 7 is not one of the 2 grasps"):
        ft.draw(scene, grasps, number=7)
    with pytest.raises(ConfigError, match="grasps: are on object 1, not on 2"):
        ft.draw(scene.objects[1], grasps)


def test_rotations_that_are_not_given_are_computed_on_an_object_as_the_planner_does(scene):
    target, model = scene.objects[0], ft.load_model()
    planned = ft.plan(target, count=4)
    bare = ft.Grasps(planned.g1, planned.g2)
    touch = model.predict(target, bare)
    np.testing.assert_allclose(touch.grasps.rotation, planned.rotation, atol=1e-12)
    np.testing.assert_allclose(touch.value, model.predict(target, planned).value, atol=1e-6)
    assert touch.ok.all()
    some = ft.Grasps.of([planned[0], ft.Grasp(planned.g1[1], planned.g2[1])])
    np.testing.assert_array_equal(model.predict(target, some).grasps.rotation[0], planned.rotation[0])
    between = Pipeline().grasp_between(target, planned.g1[2], planned.g2[2])
    np.testing.assert_allclose(between.rotation, touch.grasps.rotation[2], atol=1e-12)
    on_a_table = model.predict(target.cloud, bare, table=target.plane)
    np.testing.assert_array_equal(on_a_table.value, touch.value)
    counts = model.estimate(target, planned).counts
    np.testing.assert_allclose(model.estimate(target, bare).counts, counts, atol=1e-6)
    np.testing.assert_array_equal(model.estimate(target.cloud, planned, target.plane).counts, counts)
    without = model.predict(target.cloud, bare)
    assert without.status.tolist() == ["bad_grasp"] * 4
    assert without.reason[0] == (
        "rotation: is not given, and computing it needs the table; pass an object of a scene, or table"
    )
    with pytest.raises(GraspError, match="rotation: of grasp 0 is not given; a prediction on an object computes it"):
        _ = bare.pose
    history = ft.History(model)
    history.touched(target, bare[0], touch[0].value, stamp_ns=1_000_000_000)
    assert history.touches == 1


def test_what_is_no_rotation_no_plane_and_no_hand_is_refused_at_once(scene):
    planned = ft.plan(scene.objects[0], count=4)
    g1, g2, turned = planned.g1, planned.g2, planned.rotation
    cases = [
        (GraspError, lambda: ft.Grasps(g1[:2], g2, turned), r"g2: shape \(4, 3\) is not \(2, 3\)"),
        (
            GraspError,
            lambda: ft.Grasps(g1, g2, np.ones((4, 3, 3))),
            r"rotation: \[\[1.0, 1.0, 1.0\].*is not a rotation",
        ),
        (GraspError, lambda: ft.Grasp(g1[0], g2[0], np.ones((3, 3))), "rotation: .*is not a rotation matrix"),
        (GraspError, lambda: ft.Grasps(g1, g2, np.diag([1.0, 1.0, -1.0])[None].repeat(4, 0)), "is not a rotation"),
        (CloudError, lambda: ft.Plane([0, 0, 0], -1.2), r"normal: length 0 of \[0.0, 0.0, 0.0\].*is not 1"),
        (CloudError, lambda: ft.Plane([0, 0, 2], -1.2), r"Plane\.from_coefficients\(\(a, b, c, d\)\) takes any length"),
        (CloudError, lambda: ft.Plane([0, 0, 1], np.nan), "the offset is not finite"),
        (CloudError, lambda: ft.Plane("up", 1.0), "normal: up is not of numbers"),
        (ConfigError, lambda: ft.plan(scene.objects[0], hand="franka"), "franka"),
    ]

    def check(error, call, message):
        with pytest.raises(error, match=message):
            call()

    every_case(cases, check)
    by_setting = ft.PipelineConfig.from_mapping({"hand": {"name": "franka_hand"}})
    shown = ft.plan(scene.objects[1], hand="franka_hand")
    np.testing.assert_array_equal(shown.pose_of_hand, ft.plan(scene.objects[1], config=by_setting).pose_of_hand)
    assert {way.hand for way in shown.way} == {"franka_hand"}
