# SPDX-License-Identifier: Apache-2.0
"""`view` writes real Rerun files, which are read back by Rerun."""

from __future__ import annotations

import contextlib
import ctypes.util
import importlib.util
import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from PIL import Image
from recording_builders import write_grasps

from foretouch.cli.main import main
from foretouch.dataset.samples import open_samples
from foretouch.dataset.store_writer import build_store
from foretouch.report.rerun_view import _fingertip_pose
from foretouch.report.rerun_viewer import _viewer, _viewer_environment
from foretouch.tactile import electrode_normals, electrode_positions

LAYER_M = 0.0014

Call = Callable[..., Any]
without_rerun = importlib.util.find_spec("rerun") is None
needs_rerun = pytest.mark.skipif(without_rerun, reason="Rerun is not installed: pip install 'foretouch[view]'")


def has_vulkan() -> bool:
    named = any(os.environ.get(name) for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"))
    installed = ctypes.util.find_library("vulkan") and any(Path("/usr/share/vulkan/icd.d").glob("*.json"))
    return bool(named or installed)


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
        return found


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data") / "recording"
    write_grasps(path)
    return path


@pytest.fixture(scope="session")
def dataset(recording: Path) -> Path:
    build_store([recording], recording.with_name("store"))
    return recording.with_name("store")


@pytest.fixture(scope="session")
def dataset_view(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Written:
    path = tmp_path_factory.mktemp("view") / "dataset.rrd"
    if without_rerun:
        pytest.skip("Rerun is not installed: pip install 'foretouch[view]'")
    assert main(["view", str(dataset), "--save", str(path)]) == 0
    return Written(path)


@pytest.fixture(scope="session")
def answers(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Answers of `predict` for the dataset."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        main(["predict", str(dataset), "--json"])
    path = tmp_path_factory.mktemp("answers") / "answers.jsonl"
    path.write_text(printed.getvalue())
    return path


def test_predictions_are_those_of_predict_with_their_intervals(dataset_view: Written, answers: Path) -> None:
    records = [json.loads(line)["predictions"][0] for line in answers.read_text().splitlines()]
    for name in ("PDC_TH", "PDC_MF"):
        for curve, key in (("predicted", "value"), ("lower", "lower"), ("upper", "upper")):
            drawn = dataset_view.rows(f"/touch/{name}/{curve}", "Scalars:scalars")
            assert [drawn[k][0] for k in range(len(records))] == [one[name][key] for one in records]
    eighth = dataset_view.rows("/touch/E_MF/08/predicted", "Scalars:scalars")
    assert [eighth[k][0] for k in range(len(records))] == [one["E_MF"]["value"][7] for one in records]


def test_what_was_read_is_beside_it_and_only_where_it_was_read(dataset_view: Written, dataset: Path) -> None:
    with open_samples(dataset) as samples:
        touches = {k: samples.record(k).sample.touch for k in range(len(samples))}
    drawn = dataset_view.rows("/touch/PDC_TH/read", "Scalars:scalars")
    assert drawn == {k: [touch.pdc_th] for k, touch in touches.items() if touch is not None}
    sizes = dataset_view.rows("/electrodes/TH/read", "Points2D:positions")
    assert {k: len(points) for k, points in sizes.items()} == {k: 24 * (t is not None) for k, t in touches.items()}


def test_clouds_are_complete_and_the_hand_is_where_the_grasp_is(dataset_view: Written, dataset: Path) -> None:
    with open_samples(dataset) as samples:
        first = samples.record(0).sample
    points = np.array(dataset_view.rows("/scene/cloud", "Points3D:positions")[0])
    np.testing.assert_allclose(points, first.cloud.xyz, atol=1e-6)
    (translation,) = dataset_view.rows("/scene/hand", "Transform3D:translation")[0]
    (columns,) = dataset_view.rows("/scene/hand", "Transform3D:mat3x3")[0]
    np.testing.assert_allclose(translation, first.grasp.midpoint, atol=1e-6)
    np.testing.assert_allclose(np.reshape(columns, (3, 3)).T, first.grasp.rotation, atol=1e-6)


@pytest.mark.parametrize(("finger", "contact"), [("thumb", "g1"), ("middle_finger", "g2")])
def test_electrodes_lie_on_the_skin_which_meets_the_contact(
    dataset_view: Written, finger: str, contact: str, dataset: Path
) -> None:
    with open_samples(dataset) as samples:
        grasp = samples.record(0).sample.grasp
    (origin,) = dataset_view.rows(f"/scene/{finger}", "Transform3D:translation")[0]
    (columns,) = dataset_view.rows(f"/scene/{finger}", "Transform3D:mat3x3")[0]
    rotation = np.reshape(columns, (3, 3)).T
    drawn = np.array(dataset_view.rows(f"/scene/{finger}/electrodes", "Points3D:positions")[0])
    (axes,) = dataset_view.rows(f"/scene/{finger}/skin", "Ellipsoids3D:half_sizes")[0]
    np.testing.assert_allclose(drawn, electrode_positions() + LAYER_M * electrode_normals(), atol=1e-6)
    on_skin = ((drawn / axes) ** 2).sum(axis=1)
    assert on_skin == pytest.approx(1.0, abs=0.12)  # 21 to 24 sit on a flat
    lowest = np.array(origin) + rotation @ [0.0, 0.0, -axes[2]]
    np.testing.assert_allclose(lowest, getattr(grasp, contact), atol=1e-6)
    other = grasp.g2 if contact == "g1" else grasp.g1
    assert (rotation @ [0.0, 0.0, -1.0]) @ (other - getattr(grasp, contact)) > 0.0  # the pad faces the other contact
    assert _fingertip_pose(grasp, getattr(grasp, contact))[0] == pytest.approx(origin, abs=1e-6)


def test_predicted_and_read_electrodes_have_one_scale_of_colours(dataset_view: Written, dataset: Path) -> None:
    with open_samples(dataset) as samples:
        sample = next(one.sample for one in samples.records() if one.sample.touch is not None)
    assert sample.touch is not None
    colours: dict[str, set[int]] = {}
    for what in ("predicted", "read"):
        labels = dataset_view.rows("/electrodes/TH/" + what, "Points2D:labels")
        shades = dataset_view.rows("/electrodes/TH/" + what, "Points2D:colors")
        for step, texts in labels.items():
            for text, shade in zip(texts, shades[step], strict=True):
                colours.setdefault(text, set()).add(shade)
    shared = [found for found in colours.values() if len(found) > 1]
    assert len(colours) > 50
    assert max((len(found) for found in shared), default=1) <= 3  # equal after rounding to a count


def test_the_time_line_has_steps_and_a_layout_is_part_of_the_file(dataset_view: Written) -> None:
    assert len(dataset_view.blueprints) == 1
    texts = dataset_view.rows("/answer", "TextDocument:text")
    assert len(texts) == 7
    assert "| PDC of the thumb |" in texts[0][0]


@needs_rerun
def test_a_recorded_dataset_has_its_times_candidates_and_no_discarded_sample(tmp_path: Path, recording: Path) -> None:
    path = tmp_path / "recording.rrd"
    assert main(["view", str(recording), "--save", str(path)]) == 0
    with open_samples(recording) as samples:
        records = list(samples.records())
    written = Written(path)
    times = written.rows("/touch/PDC_TH/predicted", "Scalars:scalars", "time")
    assert list(times) == [one.sample.stamp_ns for one in records]
    assert len(records) == 7
    drawn = written.rows("/scene/candidates", "LineStrips3D:strips")
    assert {k: len(lines) for k, lines in drawn.items()} == {
        k: len(one.candidates) for k, one in enumerate(records) if one.candidates
    }


@needs_rerun
def test_a_recording_that_is_still_written_is_shown_as_far_as_it_is(
    call: Call, tmp_path: Path, recording: Path
) -> None:
    shutil.copytree(recording, tmp_path / "now")
    file = tmp_path / "now" / "session-0002.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert call("view", tmp_path / "now", "--save", tmp_path / "v.rrd").status == 0
    steps = Written(tmp_path / "v.rrd").rows("/answer", "TextDocument:text")
    assert 0 < len(steps) < 7


@needs_rerun
def test_the_other_planned_grasps_are_candidates(call: Call, files: Path, tmp_path: Path) -> None:
    (planned,) = call("grasp", files / "object.pcd", "--count", 10, "--json").records
    assert call("view", files / "object.pcd", "--save", tmp_path / "v.rrd").status == 0
    drawn = Written(tmp_path / "v.rrd").rows("/scene/candidates", "LineStrips3D:strips")[0]
    expected = [[one["g1"], one["g2"]] for one in planned["grasps"][1:]]
    assert expected
    np.testing.assert_allclose(drawn, expected, atol=1e-6)


@needs_rerun
def test_a_scene_has_its_table_and_all_objects(call: Call, files: Path, tmp_path: Path) -> None:
    answer = call("view", files / "scene.npz", "--save", tmp_path / "v.rrd")
    assert (answer.status, answer.out) == (0, "")
    written = Written(tmp_path / "v.rrd")
    (record,) = call("segment", files / "scene.npz", "--json").records
    boxes = written.rows("/scene/objects", "Boxes3D:half_sizes")[0]
    assert len(boxes) == len(record["objects"]) == 2
    corners = np.array(written.rows("/scene/table", "Mesh3D:vertex_positions")[0])
    a, b, c, d = record["plane"]
    np.testing.assert_allclose(corners @ [a, b, c], -d, atol=1e-6)


@needs_rerun
def test_answers_are_shown_as_given_with_the_clouds_of_their_data(
    call: Call, answers: Path, tmp_path: Path, dataset: Path
) -> None:
    changed = tmp_path / "answers.jsonl"
    records = [json.loads(line) for line in answers.read_text().splitlines()[:3]]
    records[1]["predictions"][0]["PDC_TH"]["value"] = 1234.5
    changed.write_text("".join(json.dumps(record) + "\n" for record in records))
    assert call("view", changed, "--data", dataset, "--save", tmp_path / "v.rrd").status == 0
    written = Written(tmp_path / "v.rrd")
    assert [row[0] for row in written.rows("/touch/PDC_TH/predicted", "Scalars:scalars").values()][1] == 1234.5
    assert len(written.rows("/scene/cloud", "Points3D:positions")) == 3


@needs_rerun
def test_answers_without_clouds_and_refused_ones_are_shown(call: Call, files: Path, tmp_path: Path) -> None:
    printed = call("predict", files / "scene.npz", files / "empty.npz", files / "object.pcd", "--json")
    path = tmp_path / "a.jsonl"
    path.write_text(printed.out)
    assert call("view", path, "--save", tmp_path / "v.rrd").status == 0
    written = Written(tmp_path / "v.rrd")
    texts = [text for (text,) in written.rows("/answer", "TextDocument:text").values()]
    assert sum("not predicted: " in text for text in texts) == 1
    assert len(written.rows("/scene/cloud", "Points3D:positions")) == len(texts) - 1


@needs_rerun
def test_a_hand_disappears_where_there_is_no_grasp(call: Call, files: Path, tmp_path: Path) -> None:
    for name in ("1.npz", "3.npz"):
        (tmp_path / name).write_bytes((files / "scene.npz").read_bytes())
    (tmp_path / "2.npz").write_bytes((files / "empty.npz").read_bytes())
    assert call("view", tmp_path, "--save", tmp_path / "v.rrd").status == 0
    written = Written(tmp_path / "v.rrd")
    electrodes = written.rows("/scene/thumb/electrodes", "Points3D:positions")
    assert {step: len(points) for step, points in electrodes.items()} == {0: 24, 1: 0, 2: 24}
    assert [len(row) for row in written.rows("/scene/thumb/skin", "Ellipsoids3D:half_sizes").values()] == [1, 0, 1]
    assert written.rows("/scene/hand", "TransformAxes3D:axis_length")[1] == [0.0]
    assert 1 in written.rows("/scene/objects", "Clear:is_recursive")


@needs_rerun
def test_a_bad_file_of_answers_is_refused_in_one_line(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "a.json"

    def check(content: str, message: str) -> None:
        path.write_text(content)
        answer = call("view", path, "--save", tmp_path / "v.rrd")
        assert (answer.status, answer.out, answer.err.count("\n")) == (1, "", 1)
        assert message in answer.err
        assert [one.name for one in tmp_path.iterdir()] == ["a.json"]

    every_case(
        [
            ("{", "line 1: is no JSON"),
            ("[1]", "line 1: is no JSON object"),
            ("", "holds no answers"),
            ('{"played": 3}', "holds no answers"),
        ],
        check,
    )


@needs_rerun
def test_a_prediction_that_is_not_complete_names_its_field(call: Call, answers: Path, tmp_path: Path) -> None:
    record = json.loads(answers.read_text().splitlines()[0])
    del record["predictions"][0]["E_TH"]["lower"]
    (tmp_path / "a.jsonl").write_text(json.dumps(record))
    answer = call("view", tmp_path / "a.jsonl", "--save", tmp_path / "v.rrd")
    assert answer.status == 1
    assert "predictions: E_TH: is not as `predict --json` writes it" in answer.err


def test_paths_that_cannot_be_read_or_written_are_refused(call: Call, files: Path, tmp_path: Path) -> None:
    missing = call("view", tmp_path / "none.pcd", "--save", tmp_path / "v.rrd")
    assert (missing.status, missing.err) == (1, f"foretouch: {tmp_path / 'none.pcd'}: does not exist\n")
    if not without_rerun:
        unwritable = call("view", files / "object.pcd", "--save", tmp_path / "none" / "v.rrd")
        assert unwritable.status == 1
        assert "No such file or directory" in unwritable.err


def test_without_rerun_the_line_names_the_extra(call: Call, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    answer = call("view", files / "object.pcd", "--save", files / "v.rrd")
    assert (answer.status, answer.out) == (1, "")
    assert answer.err == "foretouch: Rerun is not installed: pip install 'foretouch[view]'\n"


@needs_rerun
def test_a_screenshot_is_drawn_or_the_missing_driver_is_named(call: Call, tmp_path: Path, dataset: Path) -> None:
    picture = tmp_path / "v.png"
    answer = call("view", dataset, "--count", 5, "--screenshot", picture)
    if not has_vulkan():
        assert answer.status == 1
        assert "graphics driver (Vulkan): apt install libvulkan1 mesa-vulkan-drivers" in answer.err
        assert not picture.exists()
        pytest.skip("no Vulkan driver: apt install libvulkan1 mesa-vulkan-drivers")
    assert answer.status == 0
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    assert len(np.unique(pixels, axis=0)) > 1000  # a view, not an empty window


@needs_rerun
def test_the_viewer_sends_no_statistics_and_listens_on_this_machine_alone() -> None:
    assert _viewer(9)[1:] == ["--bind", "127.0.0.1", "--port", "9"]
    with _viewer_environment() as environment:
        shown = subprocess.run(
            [_viewer()[0], "analytics", "config"], env=environment, capture_output=True, text=True, check=True
        )
        assert json.loads(shown.stdout)["analytics_enabled"] is False
        folder = Path(environment["XDG_CONFIG_HOME"])
    assert not folder.exists()
