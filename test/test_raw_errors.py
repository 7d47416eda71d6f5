# SPDX-License-Identifier: Apache-2.0
"""Values of any type in any argument of the library: an answer, or one line of its own errors, and never an error of Python."""

import copy
import inspect
import pickle
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from every_case import every_case
from recording_builders import record

import foretouch as ft
from foretouch.cloud.io.depth_files import DepthCamera
from foretouch.types.channels import Channel, Channels

VALUES: dict[str, Any] = {
    "10^400": 10**400, "text": "x", "None": None, "half a pair": "half \ud800", "complex": 1j, "NaN": float("nan"), "list": [],
    "object": object(), "array": np.zeros((2, 2)), "negative": -1, "bytes": b"x", "masked": np.ma.masked, "frame": pd.DataFrame({"a": [1.0]}), "structured": np.zeros(3, [("a", "f4")]), "NaT": np.datetime64("NaT"), "complex numbers": [1j] * 3,
    "large numbers": [10**400] * 3, "matrix of large": [[10**400] * 3] * 3, "Nones": [None] * 3, "fraction": 1.5, "dict": {},
}  # fmt: skip
DEPTH = np.full((120, 160), 0.9, np.float32)
CAMERA = (150.0, 150.0, 79.5, 59.5)


@pytest.fixture(scope="module")
def calls(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Callable[[Any], object]]:
    """A call for each argument, by name."""
    folder, count = tmp_path_factory.mktemp("calls"), iter(range(10**6))
    depth = DEPTH.copy()
    depth[50:70, 70:90] = 0.85
    cloud = ft.Cloud.from_depth(depth, CAMERA)
    scene, model, sample = ft.segment(cloud), ft.load_model(), record()
    target, grasp, touch = scene.objects[0], sample.grasp, sample.touch
    points = np.zeros((4, 3), np.float32)

    def write(one: Any, **options: Any) -> object:
        return ft.write(folder / f"{next(count)}", [one], **options)

    ft.write(folder / "ds", [sample, record(1)])
    samples = ft.open(folder / "ds")
    rows = {name: np.ones((9, 1 if name[0] == "P" else 24)) for name in model.sensor.channels.modalities}
    arrays = {"object": "a", "id": "b", "values": rows, "rate_hz": 100.0}
    tare = ft.History(model).tare
    ft.History(model).save(folder / "hand", "right")
    return {
        **{f"Cloud.{name}": lambda v, name=name: ft.Cloud(**{"xyz": points, name: v}) for name in ("xyz", "rgb", "frame_id", "stamp_ns", "camera")},
        **{f"from_depth.{name}": lambda v, name=name: ft.Cloud.from_depth(**{"depth": depth, "K": CAMERA, name: v}) for name in ("depth", "K", "scale", "distortion", "rgb", "frame_id", "stamp_ns")},
        "segment": ft.segment, "mask": lambda v: ft.segment(cloud, mask=v), "plan": ft.plan, "count": lambda v: ft.plan(target, count=v),
        "near": scene.near, "plane": ft.Plane.from_coefficients, "Plane.offset": lambda v: ft.Plane([0, 0, 1], v),
        **{f"Grasp.{name}": lambda v, name=name: ft.Grasp(**{"g1": [0, 0, 1], "g2": [0, 1, 1], "rotation": np.eye(3), name: v}) for name in ("g1", "g2", "rotation", "score", "id")},
        **{f"Grasps.{name}": lambda v, name=name: ft.Grasps(**{"g1": [[0, 0, 1]], "g2": [[0, 1, 1]], "rotation": [np.eye(3)], name: v}) for name in ("g1", "g2", "rotation", "score")},
        "Touch": lambda v: ft.Touch(v, touch.channels), "channels": lambda v: ft.Touch(touch.values, v), "tare": tare,
        "tare.stamp_ns": lambda v: tare(touch, stamp_ns=v), "tare.tdc": lambda v: tare(touch, stamp_ns=1, tdc=v),
        "predict.grasps": lambda v: model.predict(target, v), "predict.table": lambda v: model.predict(cloud, [grasp], table=v),
        "predict.history": lambda v: model.predict(target, [grasp], history=v), "History": ft.History,
        "History.hand": lambda v: ft.History(model).save(folder / "hand", v), "open": ft.open, "load_model": ft.load_model,
        **{f"Predictions.{name}": lambda v, name=name: ft.Predictions(**{"value": touch.values[None], "grasps": [grasp], "channels": touch.channels, name: v}) for name in ("value", "channels", "lower", "upper")},  # noqa: PD011
        **{name: lambda v, name=name: getattr(ft, name)(**{"predictor": model} if name == "calibrate" else {"models": model} if name == "evaluate" else {}, samples=v) for name in ("fit", "evaluate", "calibrate")},
        "draw.grasps": lambda v: ft.draw(scene, v), "draw.touch": lambda v: ft.draw(scene, touch=v), "fit of one": lambda v: ft.fit([v]),
        "read_cloud.camera": lambda v: ft.read_cloud(folder / "c.ply", v), "write_cloud.path": lambda v: ft.write_cloud(v, cloud), "write_cloud": lambda v: ft.write_cloud(folder / "d.ply", v),
        "read_cloud": ft.read_cloud, "History.load": lambda v: ft.History.load(v, model), "load.model": lambda v: ft.History.load(folder / "x", v),
        "write.samples": lambda v: ft.write(folder / f"{next(count)}", v), "write.sample": write, "write.sensor": lambda v: write(sample, sensor=v),
        "write.missing": lambda v: write(arrays, missing=v), "write.hand": lambda v: write(sample, hand=v),
        "write.hand.name": lambda v: write(sample, hand={"name": v}), "write.min_free_mb": lambda v: write(sample, min_free_mb=v),
        **{f"Sample.{name}": lambda v, name=name: write(replace(sample, **{name: v})) for name in ("id", "object", "cloud", "grasp", "touch", "tare", "stamp_ns", "extra", "candidates", "outcome", "note", "series", "contact_ns", "detector", "pairing_error_ns", "flags")},
        "Sample.flag": lambda v: write(replace(sample, flags=(v,))), "Sample.number": lambda v: write(replace(sample, extra={"a": v})),
        **{f"arrays.{name}": lambda v, name=name: write(arrays | {name: v}) for name in ("id", "object", "cloud", "grasp", "tare", "rate_hz", "start_s", "rest", "others", "outcome", "note", "values")},
        **{f"arrays.{name}": lambda v, name=name: write(arrays | {"rate_hz": None, name: v}) for name in ("stamps_ns", "stamps_s")},
        **{f"arrays.{name}.PDC_TH": lambda v, name=name: write(arrays | {name: {"PDC_TH": v}}) for name in ("tare", "others", "values")},
        "Stream": ft.Stream, "Stream.history": lambda v: ft.Stream(history=v), "Stream.configure": lambda v: ft.Stream().configure(v),
        "Stream.select": lambda v: ft.Stream().select(v), "Stream.find": lambda v: ft.Stream().find(v), "Stream.answer": lambda v: ft.Stream().answer(v),
        "Stream.mask": lambda v: ft.Stream().answer(cloud, mask=v), "Stream.plan": lambda v: ft.Stream().plan(v), "Stream.plan of one": lambda v: ft.Stream().plan([v]),
        "Stream.with_target": lambda v: ft.Stream().with_target(v),
        **{f"touched.{name}": lambda v, name=name: ft.History(model).touched(**{"target": target, "grasp": grasp, "reading": touch, "stamp_ns": 1, name: v}) for name in ("target", "grasp", "reading", "stamp_ns", "same_object", "estimate", "tdc")},
        **{f"History.predict.{name}": lambda v, name=name: ft.History(model).predict(**{"target": target, "grasps": [grasp], name: v}) for name in ("target", "grasps", "stamp_ns", "same_object")},
        "is_current": lambda v: ft.History(model).is_current(v, 0.1), "is_current.same_object_m": lambda v: ft.History(model).is_current(cloud, v),
        "keep_to_clock": lambda v: ft.History(model).keep_to_clock(v), "adapt": lambda v: ft.History(model).at().adapt(v),
        "History.load.hand": lambda v: ft.History.load(folder / "hand", model, v), "from_mapping": ft.PipelineConfig.from_mapping, "updated": ft.PipelineConfig().updated,
        "Pipeline.predict": lambda v: ft.Pipeline().predict(v, [grasp]), "Touch.of": lambda v: ft.Touch.of(v, PDC_TH=1), "Touch.of part": lambda v: ft.Touch.of(touch.channels, PDC_TH=v),
        "subset": samples.subset, "subset of one": lambda v: samples.subset([v]), "filter": samples.filter,
    }  # fmt: skip


def check(_: str, call: Callable[[Any], object], value: Any) -> None:
    """Call a function; its own errors are of one line."""
    with suppress(ft.ForetouchError):
        call(value)


SLOW = ("write", "Sample", "arrays", "fit", "evaluate", "calibrate", "draw")
"""Beginnings of the names of calls that take long, of which the slow test is."""


@pytest.mark.filterwarnings("ignore")
def test_no_value_raises_an_error_of_python(
    calls: dict[str, Callable[[Any], object]], tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    quick = {name: call for name, call in calls.items() if not name.startswith(SLOW)}
    every_case(
        [(f"{name}: {kind}", call, value) for name, call in quick.items() for kind, value in VALUES.items()], check
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_no_value_that_is_written_raises_an_error_of_python(
    calls: dict[str, Callable[[Any], object]], tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    writes = {name: call for name, call in calls.items() if name.startswith(SLOW)}
    every_case(
        [(f"{name}: {kind}", call, value) for name, call in writes.items() for kind, value in VALUES.items()], check
    )


OTHER = ft.Touch(
    np.ones(8), Channels("mine", "0" * 64, ("TH", "MF"), (Channel("P", 4, "N", 0.0, 9.0, 1, True, 1.0, 1.0),))
)

CURES: dict[str, tuple[Callable[[Any], object], str]] = {
    "prediction.PDC": (lambda v: v.touch[0].PDC, 'write prediction["PDC"]'),
    "predictions.E": (lambda v: v.touch.E, 'write predictions["E"]'),
    "touch.E_TH": (lambda v: v.touch[0].value.E_TH, 'write touch["E_TH"]'),
    "predictions.values": (lambda v: v.touch.values, "write predictions.value"),  # noqa: PD011
    "prediction.values": (lambda v: v.touch[0].values, "write prediction.value.values"),  # noqa: PD011
    "prediction.std": (lambda v: v.touch[0].std, "lower"),
    "a channel in small letters": (lambda v: v.touch["pdc"], "PDC_TH"),
    "a grasp too many": (lambda v: v.grasps[10], "they are 0 to 2"),
    "a prediction too many": (lambda v: v.touch[5], "they are 0 to 2"),
    "grasps by name": (lambda v: v.grasps["x"], "Grasps[x]"),
    "grasps by a long mask": (lambda v: v.grasps[np.ones(9, bool)], "selects no rows"),
    **{
        f"grasps[{rows}]": (lambda v, rows=rows: v.grasps[rows], "Grasps[")
        for rows in (True, 1.0, "1", [0.9, 1.9], ["1"], [True, False], [[0]], [0, 3], None, slice("a"), slice(0, 2, 0))
    },
    "predictions by a number that is none": (lambda v: v.touch[[True, False]], "mask of shape (3,)"),
    **{
        f"cloud.take({rows})": (lambda v, rows=rows: v.scene.cloud.take(rows), "selects no rows")
        for rows in (3, [1.5], np.ones((3, 3), bool), [10**9])
    },
    "rows in place of more": (lambda v: v.grasps.put([0, 1], v.grasps[:1]), "1 rows do not take the place of 2"),
    "rows of another type": (lambda v: v.grasps.put([0], v.touch), "other: Predictions is not Grasps"),
    "nothing to join": (lambda _: ft.Grasps.join([]), "takes at least one"),
    "single grasps to join": (lambda v: ft.Grasps.join(list(v.grasps)), "parts: Grasp is not Grasps"),
    **{
        f"{name}={value!r}": (lambda v, name=name, value=value: v.grasps.replace(**{name: value}), f"{name}: ")
        for name, value in (("flags", "late"), ("flags", ["a", "b", "c"]), ("object_id", 3), ("status", None), ("way", "franka"))
    },
    **{
        f"a grasp of {name}={value!r}": (lambda v, name=name, value=value: replace(v.grasps[0], **{name: value}), f"{name}: ")
        for name, value in (("flags", "late"), ("flags", None), ("object_id", 3), ("way", "franka_hand"))
    },
    "predictions with a flag that is a text": (lambda v: v.touch.replace(flags="late"), "such as ('late',)"),
    **{
        f"flagged({flag!r}, {rows!r})": (lambda v, flag=flag, rows=rows: v.touch.flagged(flag, rows), "mask of shape (3,)")
        for flag, rows in ((7, True), ("late", 1), ("late", "E"), ("late", [True]), ("late", [0, 1, 2]))
    },
    "predictions without grasps": (lambda v: ft.Predictions(v.touch.value, None, v.touch.channels), "not Grasps"),
    "predictions without channels": (lambda v: ft.Predictions(v.touch.value, v.grasps), "pass channels"),
    "a status that is none": (lambda v: ft.Predictions.refused(v.grasps, v.touch.channels, None, ""), "status: None"),
    "a prediction of grasps": (lambda v: ft.Prediction(v.grasps), "rows: Grasps is not Predictions"),
    "a prediction of numbers": (lambda v: ft.Prediction.of(v.grasps[0], v.touch.value[0]), "value: ndarray is not a Touch"),
    "rows of unknown number": (lambda _: ft.Grasps.unknown(-1), "count: -1 is not a number of grasps"),
    **{
        f"{name} moved by {pose!r}": (lambda v, name=name, pose=pose: {"plane": v.scene.table, "grasp": v.grasps[0], "grasps": v.grasps}[name].moved(pose), "pose: ")
        for name in ("plane", "grasp", "grasps") for pose in (None, "x", np.eye(3), np.full((4, 4), np.nan))
    },
    "heights of pairs": (lambda v: v.scene.table.height(np.zeros((5, 2))), "xyz: shape (5, 2) is not (..., 3)"),
    "near by a text": (lambda v: v.scene.near([0, 0, 1], tolerance_m="1cm"), "tolerance_m: 1cm is not of numbers"),
    "near by complex numbers": (lambda v: v.scene.near(np.array([1j, 0, 1])), "complex numbers"),
    "a sure object": (lambda v: replace(v.scene.objects[0], confidence=2.0), "confidence: 2 is not between 0 and 1"),
    **{
        f"a sample of {name}={value!r}": (lambda _, name=name, value=value: ft.Sample("1", "mug", **{name: value}), f"{name}: ")
        for name, value in (("cloud", np.zeros((4, 3))), ("grasp", None), ("flags", "late"), ("extra", "x"), ("candidates", 3))
    },
    **{
        f"estimate of {cloud!r}": (lambda v, cloud=cloud: v.model.estimate(cloud, v.grasps), "nor a Cloud of one")
        for cloud in (None, np.zeros((9, 3)))
    },
    "estimate with a list for the table": (lambda v: v.model.estimate(v.scene.objects[0], v.grasps, [0, 0, 1, -1]), "from_coefficients"),
    "estimate without rotations": (lambda v: v.model.estimate(v.scene.objects[0].cloud, v.bare), "pass an object of a scene, or table"),
    "limits of a number": (lambda v: v.model.predict(v.scene.objects[0], v.grasps, limits=0.5), "limits: 0.5 is not ObjectLimits"),
    "reach of a number": (lambda v: v.model.predict(v.scene.objects[0], v.grasps, reach=0.2), "reach: 0.2 is not a ReachConfig"),
    "the same as a name": (lambda v: v.model.is_same("contact-v3"), "other: contact-v3 is not a TouchModel"),
    **{
        f"history at {name}={value!r}": (lambda v, name=name, value=value: v.history.at(**{name: value}), start)
        for name, value, start in (
            *(("stamp_ns", value, "stamp: ") for value in ("x", 1.5, -1, True, 10**40)), ("tared", "no", "tared: "), ("tdc", "warm", "tdc: "), ("tdc", [1, 2, 3], "tdc: "),
        )
    },
    "a second tare that is a text": (lambda v: v.history.tare("x", stamp_ns=2), "tare: str is not a Touch"),
    "a touch with the estimate of all grasps": (
        lambda v: v.history.touched(v.scene.objects[0], v.grasps[0], v.touch[0].value, estimate=v.model.estimate(v.scene.objects[0], v.grasps)), "need (1, 50)",
    ),
    "a touch of another object": (
        lambda v: v.history.touched(replace(v.scene.objects[0], id="7"), v.grasps[0], v.touch[0].value), "grasp: is on object 1, not on 7",
    ),
    "an estimate of another sensor": (lambda v: v.history.at().adapt(ft.Estimate(np.zeros((1, 3)))), "need (1, 50)"),
    "an estimate with a list": (lambda v: v.history.at().adapt(ft.Estimate(np.zeros((1, 50)), familiar=[1.0])), "(1,) of bool"),
    "a history of nothing saved": (lambda v: ft.History.from_tensors(v.model, None), "tensors: None is not arrays by name"),
    "draw of the touch of other grasps": (lambda v: ft.draw(v.scene, v.grasps[1:], v.touch), "touch: predicts another grasp than number 0"),
    "draw with the rest of another sensor": (lambda v: ft.draw(v.scene, v.grasps, v.touch, rest=OTHER), "rest: is of mine"),
    "draw with the name of a sensor": (lambda v: ft.draw(v.scene, v.grasps, v.touch, sensor="biotac_sp"), "sensor: biotac_sp is not a Sensor"),
    **{
        f"draw of number {number!r}": (lambda v, number=number: ft.draw(v.scene, v.grasps, number=number), "is not one of the 3 grasps")
        for number in ("1", None, True, 1.0)
    },
    **{
        f"a message with {fields}": (lambda _, fields=fields: ft.reading(SimpleNamespace(**fields)), "lacks a field")
        for fields in ({"fingers": ["TH"]}, {"predictions": 3}, {"fingers": None, "statuses": None})
    },
    "run with a table and a mask": (lambda v: ft.Pipeline().run(v.scene.cloud, v.scene.table, mask=v.scene.labels), "mask: is of a scene"),
    **{
        f"segment with {options}": (lambda v, options=options: ft.Pipeline().segment(v.scene.cloud, **options), f"{next(iter(options))}: ")
        for options in ({"previous": "x"}, {"previous": np.zeros(2)}, {"identity": "x"})
    },
    **{
        f"plan with {options}": (lambda v, options=options: ft.Pipeline().plan(v.scene.objects[0], **options), f"{next(iter(options))}: ")
        for options in ({"slide_m": "x"}, {"rng": 0}, {"held": "x"})
    },
    "a grasp between contacts without an object": (lambda _: ft.Pipeline().grasp_between(None, None, None), "target: None is not an object"),
    **{
        f"settings with {groups}": (lambda _, groups=groups: ft.PipelineConfig(**groups), "is not a group of settings")
        for groups in ({"grasp": 3}, {"target": None}, {"hand": ft.PipelineConfig().grasp})
    },
    "settings with an unknown one in a group": (lambda _: ft.PipelineConfig().replace(grasp={"counts": 3}), "grasp.counts: unknown setting"),
    **{
        f"samples[{number!r}]": (lambda v, number=number: v.samples[number], "choose some by subset([0, 2])")
        for number in ("can", 1.0, None, True, [0, 1])
    },
    "a camera of a matrix": (lambda _: DepthCamera(intrinsics=np.eye(3)), "--intrinsics: ndarray is not the numbers"),
    "a card without data": (lambda v: ft.TouchModel(v.model.predictor, {**v.model.card, "data": 3}), "card: data: 3 is not a mapping"),
    "a mark without rows": (lambda v: v.touch.marked("late"), "is no name with True"),
    "a touch of several grasps": (lambda v: v.history.touched(v.scene.objects[0], v.grasps, v.touch[0].value), "grasp: Grasps is not a Grasp"),
    "grasps.width": (lambda v: v.grasps.width, "did you mean width_m?"),
    "grasp.width": (lambda v: v.grasps[0].width, "did you mean width_m?"),
    "scene.object": (lambda v: v.scene.object, "did you mean objects?"),
    "scene.target": (lambda v: v.scene.target, "did you mean targets?"),
    "scene[0]": (lambda v: v.scene[0], "write scene.objects"),
    "the elements of a scene": (lambda v: list(v.scene), "write scene.objects"),
    "scene.at of a column": (lambda v: v.scene.at(3), "Scene.at(u, v)"),
    "scene.near of three": (lambda v: v.scene.near(1, 2, 3), "Scene.near(point, tolerance_m=…)"),
    "object.points": (lambda v: v.scene.objects[0].points, "write object.cloud.xyz"),
    "object.center": (lambda v: v.scene.objects[0].center, "write object.centroid"),
    "cloud.points": (lambda v: v.scene.cloud.points, "write cloud.xyz"),
    "a depth image without its camera": (lambda _: ft.Cloud.from_depth(DEPTH), "Cloud.from_depth(depth, K"),
    "intrinsics=": (lambda _: ft.Cloud.from_depth(DEPTH, intrinsics=CAMERA), "from_depth(depth, K"),
    "Touch.of without channels": (lambda _: ft.Touch.of(PDC_TH=1), "Touch.of(channels, **parts)"),
    "History of nothing": (lambda _: ft.History(), "History(model)"),
    "history.touched of two": (lambda v: ft.History(v.model).touched(v.scene.objects[0], v.grasps[0]), "reading"),
    "history.tare of nothing": (lambda v: ft.History(v.model).tare(), "History.tare(reading"),
    "history.append": (lambda v: ft.History(v.model).append(1), "touched"),
    "plan of a scene": (lambda v: ft.plan(v.scene), "segment(cloud).objects[0]"),
    "plan of nothing": (lambda _: ft.plan(), "plan(target"),
    "plan(counts=)": (lambda v: ft.plan(v.scene.objects[0], counts=3), "did you mean count?"),
    "a hand of another name": (lambda v: ft.plan(v.scene.objects[0], hand="franka"), "franka_hand"),
    "segment of a file": (lambda _: ft.segment("table.npz"), "Cloud.from_depth(depth, K)"),
    "a model that is loaded": (lambda v: ft.load_model(v.model), "model: TouchModel is not the name or the path of a model"),
    "a model of another name": (lambda _: ft.load_model("contact_v3"), "did you mean contact-v3?"),
    "a function that is a method": (lambda _: ft.predict, "load_model().predict(object, grasps)"),
    "a name that is not there": (lambda _: ft.segmentation, "did you mean segment?"),
    "draw(file=)": (lambda v: ft.draw(v.scene, file="a.png"), "path=…"),
    "write of nothing": (lambda _: ft.write(), "write(path, samples"),
}  # fmt: skip
"""What users do by mistake, and what the line of foretouch contains that helps them."""


class Values:
    """What mistakes are made with."""

    def __init__(self) -> None:
        depth = DEPTH.copy()
        depth[50:70, 70:90] = 0.85
        self.scene, self.model = ft.segment(ft.Cloud.from_depth(depth, CAMERA)), ft.load_model()
        self.grasps = ft.plan(self.scene.objects[0], count=3)
        self.touch = self.model.predict(self.scene.objects[0], self.grasps)
        self.bare = ft.Grasps(self.grasps.g1, self.grasps.g2)
        self.samples = ft.SampleSet(Path("x"), "k", 2, lambda _: ft.Sample("1", "mug"), str)
        self.history = ft.History(self.model)
        self.history.tare(self.model.rest, stamp_ns=1)


def test_what_users_do_by_mistake_is_answered_with_a_cure() -> None:
    values = Values()
    assert len(values.grasps) == 3

    def answered(mistake: Callable[[Any], object], cure: str) -> None:
        with pytest.raises(ft.ForetouchError) as caught:
            mistake(values)
        assert cure in str(caught.value)
        assert "\n" not in str(caught.value)

    every_case(CURES, answered)


def test_what_python_and_libraries_ask_of_an_object_is_no_mistake() -> None:
    grasps = Values().grasps
    assert not hasattr(grasps, "anything")
    assert not hasattr(grasps, "__array_interface__")
    assert pickle.loads(pickle.dumps(grasps))[1].width_m == copy.deepcopy(grasps)[1].width_m
    assert list(inspect.signature(ft.Grasp).parameters)[:3] == ["g1", "g2", "rotation"]
    with pytest.raises(TypeError):
        ft.History()
    with pytest.raises(IndexError):
        grasps[3]
