# SPDX-License-Identifier: Apache-2.0
"""How public types print themselves: short, whatever they hold."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from experiment_samples import make_samples

import foretouch as ft
from foretouch import types
from foretouch.dataset.samples import SampleSet
from foretouch.tactile import BIOTAC
from foretouch.types.scene import Obstacles

LONG = "a\nname <b> " * 300
TABLE = Path(__file__).parents[2] / "examples" / "data" / "table.npz"


def _everything() -> list[Any]:
    """Return values of every public type, small ones and ones that hold much, with names that are too long for a line."""
    scene = ft.segment(ft.read_cloud(TABLE))
    target, model = scene.objects[0], ft.load_model()
    grasps = ft.plan(target, count=4, hand="shadow_thumb_middle")
    touch = model.predict(target, grasps)
    history = ft.History(model)
    history.touched(target, grasps[0], touch[0].value, stamp_ns=1_000_000_000)
    history.restarts = {LONG: 3}
    many = grasps.take(np.zeros(5000, int)).replace(id=LONG, object_id=[LONG] * 5000, reason=LONG)
    refused = ft.Predictions.refused(many, touch.channels, LONG, LONG).flagged(LONG)
    sample = make_samples(1, 1)[0]
    named = replace(sample, id=LONG, object=LONG, note=LONG, flags=(LONG,) * 50, tare=sample.touch)
    opened = SampleSet(Path(LONG), LONG, 10**9, make_samples, str, edits=(LONG,) * 50, unfinished=(Path(LONG),))
    depth = np.full((480, 640), 1000, np.uint16)
    camera = ft.CameraModel.of([600, 600, 319.5, 239.5], 640, 480, np.full(8, 0.0123456789))
    result = ft.Pipeline().run(scene.cloud)
    changed = {"grasp": {"count": 3}, "hand": {"name": "franka_hand"}, "target": {"mode": "all"}, "model": LONG}
    changed |= {"limits": {"max_range_m": 3.0}}
    unlike = replace(scene, status=LONG, reason=LONG, objects=(replace(target, id=LONG, flags=(LONG,) * 9),) * 300)
    channels = replace(BIOTAC, sensor=LONG, fingers=tuple(f"{LONG}{k}" for k in range(40)))
    return [
        *(scene, unlike, replace(scene, table=None, cloud=ft.Cloud(np.zeros((0, 3))), labels=np.zeros(0, np.int32)), *unlike.objects[:1], target),
        *(scene.table, scene.obstacles, scene.cloud, ft.Cloud(np.zeros((9, 3)), frame_id=LONG), types.NO_CLOUD),
        *(ft.Cloud.from_depth(depth, camera), camera, grasps, many, grasps[0], grasps[:0], ft.Grasps(grasps.g1, grasps.g2)),
        *(grasps.way[0], touch, touch[0], touch["E"], touch[0].value, touch[0].evidence, refused, refused[0]),
        *(ft.Touch.unknown(channels), channels, touch.channels, history, history.at(2), ft.History(model), model, model.sensor),
        *(model.estimate(target.cloud, grasps), sample, named, named.series or sample.readings, opened),
        *(ft.Stream(), ft.Stream(history=history), ft.StreamConfig(grasp_hold=1.0), ft.Pipeline(), ft.PipelineConfig(), ft.PipelineConfig.from_mapping(changed), ft.ForetouchError(LONG)),
        *(result, result.targets[0], ft.Pipeline().plan(target), Obstacles(np.zeros((0, 3)), np.zeros(0))),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def everything() -> list[Any]:
    return _everything()


def test_every_public_type_prints_a_few_short_lines(everything: list[Any]) -> None:
    for value in everything:
        lines = repr(value).splitlines()
        assert 1 <= len(lines) <= 12, repr(value)
        assert max(map(len, lines)) <= 100, repr(value)
        assert lines[0].startswith(type(value).__name__)
        shown = value._repr_html_() if hasattr(value, "_repr_html_") else ""
        assert "<b> " not in shown.replace("</b> ", "")
        assert "\n" not in shown
    public = [getattr(module, name) for module in (ft, types) for name in module.__all__]
    kinds = {kind for kind in public if isinstance(kind, type) and hasattr(kind, "__mro__")}
    kinds -= {types.Columns}  # the base of columns, which nobody makes
    unseen = {kind.__name__ for kind in kinds if not any(isinstance(value, kind) for value in everything)}
    assert not unseen


def test_summaries_say_what_matters(everything: list[Any]) -> None:
    scene = everything[0]
    assert repr(scene).splitlines()[0] == "Scene(ok, 4 objects)"
    assert "offset 1.25 m" in repr(scene)
    touch = next(value for value in everything if isinstance(value, ft.Predictions))
    assert "counts" in repr(touch)
    half = (touch["PDC_TH"].upper - touch["PDC_TH"].lower).mean() / 2
    assert f"± {half:.0f} counts" in repr(touch)
    assert "<th>PDC_TH</th>" in touch._repr_html_()
    assert "90 %" in repr(ft.load_model())
    assert "contact-v3" in repr(ft.load_model())
    unturned = ft.Grasps(np.zeros((2, 3)), np.ones((2, 3)))
    assert "not given for 2" in repr(unturned)
    assert "grasp.count" in repr(ft.PipelineConfig.from_mapping({"grasp": {"count": 3}}))


def test_no_summary_reads_what_is_read_on_demand() -> None:
    def read(number: int) -> ft.Sample:
        raise AssertionError(number)

    assert "1,000,000 samples" in repr(SampleSet(Path("day"), "store", 10**6, read, str))
    cloud = ft.Cloud.from_depth(np.full((480, 640), 1000, np.uint16), [600.0, 600.0, 319.5, 239.5])
    assert "depth image of 480 x 640" in repr(cloud)
    assert "xyz" not in vars(cloud)
    kept = make_samples(1, 1)[0]
    vars(kept).pop("cloud")  # as the samples of a store
    assert "is read when it is used" in repr(kept)
