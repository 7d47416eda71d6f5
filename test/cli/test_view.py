# SPDX-License-Identifier: Apache-2.0
"""`view` writes real Rerun files, which are read back by Rerun."""

import ctypes.util
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from constant_models import sensor_with_dead
from PIL import Image
from recording_builders import IDENTITY, QUICK, record, write_grasps

from foretouch.dataset.formats import open_samples
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.report.rerun_view import ViewStep, _viewer, _viewer_environment, write_view
from foretouch.tactile import BIOTAC_SP
from foretouch.types import Cloud, Prediction, Sample, Touch

LAYER_M = 0.0014


class Written:
    """The content of a Rerun file."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        self.blueprints = RrdReader(path).blueprints()
        self.chunks: dict[str, list[Any]] = {}
        for chunk in RrdReader(path).stream():
            self.chunks.setdefault(chunk.entity_path, []).append(chunk)

    def rows(self, path: str, component: str, timeline: str = "step") -> dict[Any, Any]:
        """Values by step."""
        found = {}
        for chunk in self.chunks[path]:
            batch = chunk.to_record_batch()
            if component in batch.schema.names and timeline in batch.schema.names:
                times = batch[timeline].cast("int64").to_pylist()
                pairs = zip(times, batch[component].to_pylist(), strict=True)
                found |= {time: value for time, value in pairs if value is not None}
        return dict(sorted(found.items()))


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    pytest.importorskip("rerun", reason="Rerun is not installed: pip install 'foretouch[view]'")
    path = tmp_path_factory.mktemp("data") / "recording"
    write_grasps(path)
    return path


@pytest.fixture
def view(call, tmp_path) -> Callable[..., Written]:
    def run(*words: object) -> Written:
        answer = call("view", *words, "--save", tmp_path / "v.rrd")
        assert (answer.status, answer.out) == (0, ""), answer.err
        return Written(tmp_path / "v.rrd")

    return run


def records_of(path: Path) -> list[Sample]:
    return list(open_samples(path))


def test_predictions_are_those_of_predict_and_readings_are_beside_them_by_one_scale(call, view, recording) -> None:
    written, records = view(recording), records_of(recording)
    answers = {one["sample"]: one["predictions"][0] for one in call("predict", recording, "--json").records}
    assert len(records) == 7, "none that was discarded"
    for curve, key in (("predicted", "value"), ("lower", "lower"), ("upper", "upper")):
        for name in ("PDC_TH", "E_MF"):
            drawn = written.rows(f"/touch/{name}/{curve}", "Scalars:scalars")
            expected = [np.mean(answers[one.id][name][key]) for one in records]
            np.testing.assert_allclose([drawn[k][0] for k in range(7)], expected)
    times = written.rows("/touch/PDC_TH/predicted", "Scalars:scalars", "time")
    assert list(times) == [one.stamp_ns for one in records]
    touches = {k: one.touch for k, one in enumerate(records)}
    drawn = written.rows("/touch/PDC_TH/read", "Scalars:scalars")
    assert drawn == {k: [touch["PDC_TH"][0]] for k, touch in touches.items() if touch is not None}
    colours: dict[str, set[int]] = {}
    for what in ("predicted", "read"):
        labels, shades = (written.rows(f"/taxels/TH/{what}", f"Points2D:{name}") for name in ("labels", "colors"))
        assert {len(label) for label in labels.values()} == {24}
        for step, texts in labels.items():
            for text, shade in zip(texts, shades[step], strict=True):
                colours.setdefault(text, set()).add(shade)
    assert len(colours) > 50
    assert max(map(len, colours.values())) <= 3, "one scale: equal after rounding to a count"
    assert len(written.blueprints) == 1
    assert "thumb predicted: PDC" in written.rows("/answer", "TextDocument:text")[0][0]
    candidates = written.rows("/scene/candidates", "LineStrips3D:strips")
    assert {k: len(lines) for k, lines in candidates.items()} == {
        k: len(one.candidates) for k, one in enumerate(records)
    }


def test_cloud_hand_and_fingertips_are_where_they_are(view, recording) -> None:
    written, first = view(recording, "--count", 1), records_of(recording)[0]

    def pose(path: str) -> tuple[np.ndarray, np.ndarray]:
        (translation,) = written.rows(path, "Transform3D:translation")[0]
        (columns,) = written.rows(path, "Transform3D:mat3x3")[0]
        return np.array(translation), np.reshape(columns, (3, 3)).T

    points = np.array(written.rows("/scene/cloud", "Points3D:positions")[0])
    np.testing.assert_allclose(points, first.cloud.xyz, atol=1e-6)
    for part, wanted in zip(pose("/scene/hand"), (first.grasp.midpoint, first.grasp.rotation), strict=True):
        np.testing.assert_allclose(part, wanted, atol=1e-6)
    ends = (first.grasp.g1, first.grasp.g2)
    for finger, contact, other in (("thumb", *ends), ("middle_finger", *ends[::-1])):
        origin, rotation = pose(f"/scene/{finger}")
        drawn = np.array(written.rows(f"/scene/{finger}/taxels", "Points3D:positions")[0])
        (axes,) = written.rows(f"/scene/{finger}/skin", "Ellipsoids3D:half_sizes")[0]
        np.testing.assert_allclose(drawn, BIOTAC_SP.layout.positions + LAYER_M * BIOTAC_SP.layout.normals, atol=1e-6)
        np.testing.assert_allclose(origin + rotation @ [0.0, 0.0, -axes[2]], contact, atol=1e-6)
        assert (rotation @ [0.0, 0.0, -1.0]) @ (other - contact) > 0.0, "the pad faces the other contact"


@pytest.mark.usefixtures("recording")
def test_clouds_have_tables_objects_and_planned_grasps_and_no_hand_without_one(call, view, files, tmp_path) -> None:
    (planned,) = call("grasp", files / "object.pcd", "--count", 10, "--json").records
    drawn = view(files / "object.pcd").rows("/scene/candidates", "LineStrips3D:strips")[0]
    expected = [[one["g1"], one["g2"]] for one in planned["grasps"][1:]]
    assert expected
    np.testing.assert_allclose(drawn, expected, atol=1e-6)
    (record,) = call("segment", files / "scene.npz", "--json").records
    for number, name in enumerate(("scene.npz", "empty.npz", "scene.npz")):
        (tmp_path / f"{number}.npz").write_bytes((files / name).read_bytes())
    written = view(tmp_path)
    assert len(written.rows("/scene/objects", "Boxes3D:half_sizes")[0]) == len(record["objects"]) == 2
    corners = np.array(written.rows("/scene/table", "Mesh3D:vertex_positions")[0])
    a, b, c, d = record["plane"]
    np.testing.assert_allclose(corners @ [a, b, c], -d, atol=1e-6)
    np.testing.assert_allclose(corners, record["outline"], atol=1e-6)
    photos = written.rows("/image", "EncodedImage:blob")
    with Image.open(io.BytesIO(bytes(photos[0][0]))) as photo:
        assert photo.size[0] > photo.size[1] > 100
    outlines = written.rows("/image/objects", "LineStrips2D:strips")[0]
    assert len(outlines) >= len(record["objects"])
    assert min(map(len, outlines)) > 10
    assert list(written.rows("/image/grasp", "Points2D:positions")) == [0, 2]  # none in the empty scene
    assert list(written.rows("/scene/thumb/taxels", "Points3D:positions")) == [0, 2]
    for path in ("/scene/thumb", "/scene/hand", "/scene/objects"):
        assert 1 in written.rows(path, "Clear:is_recursive")


def test_what_cannot_be_shown_is_refused_in_one_line(call, files, tmp_path, monkeypatch) -> None:
    call("view", tmp_path / "none.pcd", "--save", tmp_path / "v.rrd").check_refused("none.pcd: does not exist\n")
    call("view", files / "object.pcd", "--save", tmp_path / "v.txt").check_refused("v.txt: the extension is not one of")
    monkeypatch.setitem(sys.modules, "rerun", None)
    line = "foretouch: Rerun is not installed: pip install 'foretouch[view]'\n"
    call("view", files / "object.pcd", "--save", files / "v.rrd").check_refused(line)


def test_a_screenshot_is_drawn_or_the_missing_driver_is_named(call, tmp_path, recording) -> None:
    picture = tmp_path / "v.png"
    answer = call("view", recording, "--count", 5, "--screenshot", picture)
    named = any(os.environ.get(name) for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"))
    if not named and not (ctypes.util.find_library("vulkan") and any(Path("/usr/share/vulkan/icd.d").glob("*.json"))):
        assert answer.status == 1
        assert "graphics driver (Vulkan): apt install libvulkan1 mesa-vulkan-drivers" in answer.err
        assert not picture.exists()
        pytest.skip("no Vulkan driver: apt install libvulkan1 mesa-vulkan-drivers")
    assert answer.status == 0
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    assert len(np.unique(pixels, axis=0)) > 1000  # a view, not an empty window


@pytest.mark.usefixtures("recording")
def test_the_viewer_sends_no_statistics_and_listens_on_this_machine_alone() -> None:
    assert _viewer(9)[1:] == ["--bind", "127.0.0.1", "--port", "9"]
    with _viewer_environment() as environment:
        words = [_viewer()[0], "analytics", "config"]
        shown = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
        assert json.loads(shown.stdout)["analytics_enabled"] is False
        folder = Path(environment["XDG_CONFIG_HOME"])
    assert not folder.exists()


def test_a_sensor_of_any_layout_is_on_its_pad_and_its_dead_taxels_are_grey(recording, tmp_path) -> None:
    grasp, sensor = records_of(recording)[0].grasp, sensor_with_dead("xela_uskin_4x4", 1)
    rest = Touch(np.where(sensor.channels.tared, 1000.0, 0.0), sensor.channels)
    values = rest.values.copy()
    values[sensor.taxel_columns[:, 7, -1]] += 20.0
    read = Touch(values, sensor.channels)
    step = ViewStep(name="a", grasp=grasp, prediction=Prediction.of(grasp, read), read=read, tare=rest)
    assert write_view(tmp_path / "a.rrd", [step], "a", sensor) == 1
    written = Written(tmp_path / "a.rrd")
    placed = np.array(written.rows("/scene/FF/taxels", "Points3D:positions")[0])
    assert placed.shape == (16, 3)
    np.testing.assert_allclose(placed[:, 2], 0.0, atol=1e-9)  # at the contact
    labels, shades = (written.rows("/taxels/TH/read", f"Points2D:{name}")[0] for name in ("labels", "colors"))
    assert [text for text in labels if text != labels[0]] == ["20"]
    assert [k for k, shade in enumerate(shades) if shade == shades[1]] == [1]
    np.testing.assert_allclose(written.rows("/touch/Z_TH/read", "Scalars:scalars")[0], 1000.0 + 20.0 / 15)


def test_readings_without_a_camera_are_steps_of_their_own(view, recording) -> None:
    path = recording.with_name("no_camera")
    with RecordingWriter(path, IDENTITY, QUICK) as writer:
        for number in range(2):
            writer.append(replace(record(number), cloud=Cloud(np.empty((0, 3), np.float32))))
    written = view(path)
    assert len(written.rows("/taxels/TH/read", "Points2D:colors")) == 12
    assert not written.rows("/scene/cloud", "Points3D:positions")
    assert written.rows("/answer", "TextDocument:text")[7][0].startswith("**ball/000002: success**")
