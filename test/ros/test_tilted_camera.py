# SPDX-License-Identifier: Apache-2.0
"""What a tilted camera sees is recorded with its table, and a model that is fitted to it knows its own objects."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("libusb_package", reason="the camera's libraries are not installed")

from robot_builders import QUICK
from sim_builders import CAN, SHORT, scene

import foretouch as ft
from foretouch.cloud.messages import decode_plane
from foretouch.pipeline import Pipeline
from foretouch.types import stamp_ns
from foretouch_lab.simulation.scene_camera import FrameMaker
from foretouch_msgs.msg import TablePlane

pytestmark = [pytest.mark.ros, pytest.mark.slow]

GRASPS, NEW = 20, 24
BOX = {"name": "box", "shape": "box", "size_m": [0.06, 0.08, 0.1], "pose": {"rest": "upright"}}


def unfamiliar(model, frames):
    """The share of images of a camera in which the best grasp is flagged."""
    pipeline, flagged = Pipeline(), 0
    for frame in frames:
        (target,) = pipeline.segment(frame.cloud()).targets
        (flags,) = model.predict(target, pipeline.plan(target).grasps[:1]).flags
        flagged += "unfamiliar" in flags
    return flagged / len(frames)


def test_a_model_fitted_to_what_a_tilted_camera_recorded_knows_its_own_objects(graph, tmp_path):
    config = scene(CAN, BOX, camera={"width": 424, "height": 320, "tilt_deg": 40.0}, fingers={"noise": {}})
    (tmp_path / "scene.yaml").write_text(json.dumps(config.to_mapping()), encoding="utf-8")
    shown = {"path": str(tmp_path / "scene.yaml"), "dwell_s": 1.2, "origin_ns": time.time_ns()}
    shown = {f"scene__{name}": value for name, value in shown.items()}
    tables = graph.listen(TablePlane, "table")
    (recorder,) = graph.add("recorder", record=str(tmp_path / "grasps"), folder=str(tmp_path), **QUICK)
    graph.add("perception")
    graph.add("hand", **shown, **SHORT)
    graph.add("camera", source="scene", camera__fps=5, **shown)
    graph.until(lambda: recorder.status().samples >= GRASPS, timeout_s=120.0)
    graph.remove(*graph.nodes)

    seen = {stamp_ns(message.header.stamp): decode_plane(message.plane) for message in tables}
    samples = [sample for sample in ft.open(tmp_path / "grasps") if sample.touch is not None]
    for sample in samples:
        np.testing.assert_array_equal(sample.table.coefficients, seen[sample.cloud.stamp_ns].coefficients)
    frames = [FrameMaker(config).frame(1000 + number) for number in range(NEW)]
    shares = [
        unfamiliar(ft.fit(chosen), frames) for chosen in (samples, [replace(sample, table=None) for sample in samples])
    ]
    assert shares[0] <= 0.25
    assert shares[1] >= shares[0] + 0.2, "samples without a table would do as well"
