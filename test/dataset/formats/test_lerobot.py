# SPDX-License-Identifier: Apache-2.0
"""LeRobotDataset v3 by pyarrow alone, read by pyarrow, by Rerun, and by `lerobot` in an environment of its own."""

import io
import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from other_sensor import USKIN, write_readings
from other_tools import run_rerun
from PIL import Image
from recording_builders import IDENTITY, QUICK, record

from foretouch.dataset.formats import export_samples, open_samples
from foretouch.dataset.formats.lerobot import recognise
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.errors import ConfigError, FileError
from foretouch.tactile.channels import BIOTAC_SP, finger_label
from foretouch.types import DISCARDED, Cloud

OWN = ["timestamp", "frame_index", "episode_index", "index", "task_index", "stamp_ns"]


@pytest.fixture
def exported(tmp_path: Path) -> Path:
    """Four grasps of two objects, of six frames each; others without a touch, dropped, or without a point."""
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        for number, name in enumerate(("ball", "ball", "cup", "ball")):
            writer.append(with_all_channels(number, name))
        writer.append(record(4, "cup", labelled=False))
        writer.append(replace(with_all_channels(5, "cup"), flags=(DISCARDED,)))
        hollow = with_all_channels(6, "cup")
        unseen = Cloud(np.full((3, 3), np.nan, np.float32))
        writer.append(replace(hollow, cloud=unseen))
    result = export_samples(tmp_path / "ds", tmp_path / "out", "lerobot")
    assert (result.samples, dict(result.left_out)) == (4, {"unlabelled": 1, "discarded": 1, "no points": 1})
    return tmp_path / "out"


def with_all_channels(number: int, name: str) -> Any:
    """A record whose fingers have the same channels, and whose cloud has more points than an export keeps."""
    made = record(number, name, 1500 + 100 * number)
    assert made.series is not None
    others = {f"TDC_{finger}": np.arange(6, dtype=np.float32) + number for finger in ("TH", "MF")}
    return replace(made, series=replace(made.series, others=others))


def expected_frames() -> dict[str, np.ndarray]:
    """What the frames of `exported` must hold, computed from the records."""
    made = [with_all_channels(number, name) for number, name in enumerate(("ball", "ball", "cup", "ball"))]
    rows: dict[str, list[np.ndarray]] = {}
    for number, one in enumerate(made):
        counts, sample = one.series.counts, one
        cloud = sample.cloud.xyz[[k * len(sample.cloud.xyz) // 1024 for k in range(1024)]]
        own = {
            "observation.tactile.thumb": np.c_[counts[:, 0], counts[:, 2:26], one.series.others["TDC_TH"]],
            "observation.tactile.middle_finger": np.c_[counts[:, 1], counts[:, 26:], one.series.others["TDC_MF"]],
            "observation.tactile.thumb.electrode": counts[:, 2:26, None],
            "observation.tactile.thumb.pdc": counts[:, :1, None],
            "observation.tactile.middle_finger.electrode": counts[:, 26:, None],
            "observation.tactile.middle_finger.pdc": counts[:, 1:2, None],
            "action": np.tile(np.r_[sample.grasp.g1, sample.grasp.g2, sample.grasp.rotation.ravel()], (6, 1)),
            "observation.pointcloud": np.tile(cloud.ravel(), (6, 1)),
            "timestamp": np.arange(6) / 100_000_000,
            "frame_index": np.arange(6),
            "episode_index": np.full(6, number),
            "index": 6 * number + np.arange(6),
            "task_index": np.full(6, int(sample.object == "cup")),
            "stamp_ns": one.series.stamps_ns,
        }
        for name, values in own.items():
            rows.setdefault(name, []).append(values if name in OWN[1:] else values.astype(np.float32))
    return {name: np.concatenate(values) for name, values in rows.items()}


def test_frames_and_episodes_have_the_layout_of_version_3(exported: Path) -> None:
    info = json.loads((exported / "meta/info.json").read_text())
    known = {"codebase_version": "v3.0", "total_episodes": 4, "total_frames": 24, "total_tasks": 2, "chunks_size": 1000}
    assert known.items() <= info.items()
    assert info["splits"] == {"train": "0:4"}
    assert info["data_path"] == "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    assert [name for name, one in info["features"].items() if one["shape"] == [1]] == OWN
    assert not [name for name in info["features"] if "image" in name]
    frames = pq.read_table(exported / "data/chunk-000/file-000.parquet")
    for name, expected in expected_frames().items():
        found = np.array(frames[name].to_pylist())
        np.testing.assert_array_equal(found.astype(expected.dtype), expected, err_msg=name)
        assert info["features"][name]["shape"] == ([1] if expected.ndim == 1 else list(expected.shape[1:]))
        assert info["features"][name]["dtype"] == expected.dtype.name
    names = info["features"]["observation.tactile.thumb"]["names"]
    assert (names[0], names[1], names[24], names[25]) == ("pdc", "electrode_1", "electrode_24", "tdc")
    episodes = pq.read_table(exported / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [episode["episode_index"] for episode in episodes] == [0, 1, 2, 3]
    assert [(episode["dataset_from_index"], episode["dataset_to_index"]) for episode in episodes] == [
        (6 * k, 6 * k + 6) for k in range(4)
    ]
    assert [episode["tasks"] for episode in episodes] == [["grasp the ball"]] * 2 + [["grasp the cup"]] + [
        ["grasp the ball"]
    ]
    assert [episode["sample_id"] for episode in episodes] == ["ball/000001", "ball/000002", "cup/000003", "ball/000004"]


def test_statistics_are_those_of_the_frames(exported: Path) -> None:
    stats = json.loads((exported / "meta/stats.json").read_text())
    for name, values in expected_frames().items():
        wide = values.reshape(24, -1).astype(np.float64)
        for what, value in (("min", wide.min(0)), ("max", wide.max(0)), ("mean", wide.mean(0)), ("std", wide.std(0))):
            # Stamps of 1.7e18 ns have 61 bits, float64 has 53: a quarter of a microsecond.
            np.testing.assert_allclose(
                np.ravel(stats[name][what]), value, rtol=1e-9, atol=2000.0 if name == "stamp_ns" else 1e-9
            )
        assert stats[name]["count"] == [24]
        episodes = np.quantile(wide.reshape(4, 6, -1), 0.9, axis=1)
        np.testing.assert_allclose(np.ravel(stats[name]["q90"]), episodes.mean(axis=0), rtol=1e-9, atol=1e-9)


def test_what_cannot_be_exported_or_read_is_refused_and_leaves_nothing(exported: Path, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="exists already"):
        export_samples(tmp_path / "ds", exported, "lerobot")
    with RecordingWriter(tmp_path / "untouched", IDENTITY, QUICK) as writer:
        writer.append(record(0, labelled=False))
    with pytest.raises(FileError, match="untouched: holds no executed grasp with a touch to export"):
        export_samples(tmp_path / "untouched", tmp_path / "none", "lerobot")
    assert not (tmp_path / "none").exists()
    shutil.rmtree(exported / "foretouch")
    with pytest.raises(FileError, match="is a LeRobot dataset without the folder foretouch"):
        open_samples(exported)
    assert recognise(exported)


def test_each_channel_states_where_its_taxels_are_and_what_they_mean(exported: Path, tmp_path: Path) -> None:
    features = json.loads((exported / "meta/info.json").read_text())["features"]
    info = features["observation.tactile.thumb.electrode"]["info"]
    assert (info["axes"], info["unit"], info["range"], info["contact"]) == (["E"], "counts", [[1.0, 4095.0]], ["fall"])
    assert (info["sensor"], info["sensor_sha256"], info["rate_hz"]) == ("biotac_sp", BIOTAC_SP.sha256, 100.0)
    np.testing.assert_array_equal(info["positions"], BIOTAC_SP.layout.positions)
    np.testing.assert_array_equal(info["normals"], BIOTAC_SP.layout.normals)
    assert info["valid"] == [True] * 24
    assert "positions" not in features["observation.tactile.thumb.pdc"]["info"]  # of the whole finger
    store = write_readings(tmp_path / "store", USKIN.with_dead(np.arange(16) == np.array([[3], [17]])), 2, 2)
    export_samples(store, tmp_path / "uskin", "lerobot")
    features = json.loads((tmp_path / "uskin/meta/info.json").read_text())["features"]
    first = USKIN.channels.fingers[0]
    name = f"observation.tactile.{finger_label(first).replace(' ', '_')}.taxel"
    assert (features[name]["shape"], features[name]["info"]["axes"]) == ([16, 3], ["X", "Y", "Z"])
    assert np.flatnonzero(~np.array(features[name]["info"]["valid"])).tolist() == [3]
    frame = pq.read_table(tmp_path / "uskin/data/chunk-000/file-000.parquet").to_pylist()[0]
    sample = next(iter(open_samples(store)))
    assert sample.touch is not None
    expected = np.stack([sample.touch[f"{axis}_{first}"] for axis in "XYZ"], axis=1)
    np.testing.assert_array_equal(frame[name], expected.astype(np.float32))


def test_at_the_rate_of_a_camera_a_frame_has_the_newest_readings_and_their_stamps(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    made = record(0)
    assert made.series is not None
    start, count = 1_700_000_000_000_000_000, 130
    stamps = start + np.sort(np.arange(count) * 10_000_000 + rng.integers(-3_000_000, 3_000_000, count))
    counts = rng.integers(1, 4096, (count, 50)).astype(np.float32)
    series = replace(made.series, stamps_ns=stamps, counts=counts, phases=np.zeros(count, np.uint8), others={})
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.append(replace(made, series=series))
    export_samples(tmp_path / "ds", tmp_path / "out", "lerobot", fps=15)
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert info["fps"] == 15
    assert info["features"]["observation.tactile.thumb.electrode"]["shape"] == [7, 24, 1]
    frames = pq.read_table(tmp_path / "out/data/chunk-000/file-000.parquet").to_pylist()
    assert len(frames) == info["total_frames"] == 1 + int((stamps[-1] - stamps[0]) // (1_000_000_000 // 15))
    for number, frame in enumerate(frames):
        now = stamps[0] + number * (1_000_000_000 // 15)
        read = [k for k in range(count) if stamps[k] <= now][-7:]
        read = [read[0]] * (7 - len(read)) + read
        np.testing.assert_array_equal(frame["observation.tactile.stamps_ns"], stamps[read])
        np.testing.assert_array_equal(
            np.array(frame["observation.tactile.thumb.electrode"])[..., 0], counts[read, 2:26]
        )
        np.testing.assert_array_equal(np.ravel(frame["observation.tactile.middle_finger.pdc"]), counts[read, 1])
        assert frame["observation.tactile.thumb"][0] == counts[read[-1], 0]
        assert frame["timestamp"] == np.float32(number / 15)
    export_samples(tmp_path / "ds", tmp_path / "fast", "lerobot", fps=200)  # faster than the sensor: one reading each
    fast = pq.read_table(tmp_path / "fast/data/chunk-000/file-000.parquet")["observation.tactile.stamps_ns"].to_pylist()
    latest = [max(k for k in range(count) if stamps[k] <= stamps[0] + 5_000_000 * n) for n in range(len(fast))]
    assert fast == stamps[latest].tolist()
    with pytest.raises(ConfigError, match="fps: 2000 exceeds 10 times the rate of the readings"):
        export_samples(tmp_path / "ds", tmp_path / "faster", "lerobot", fps=2000)
    for one, other in zip(open_samples(tmp_path / "out"), open_samples(tmp_path / "ds"), strict=True):
        assert one.series is not None
        assert other.series is not None
        np.testing.assert_array_equal(one.series.counts, other.series.counts)


def test_clouds_that_are_images_are_depth_maps_in_millimetres_with_their_intrinsics(tmp_path: Path) -> None:
    depth = 0.8 + 0.1 * np.random.default_rng(1).random((12, 16))
    depth[3, 4] = np.nan
    row, column = np.indices(depth.shape)
    fx, fy, cx, cy = 610.25, 609.5, 7.75, 6.125
    xyz = np.dstack([(column - cx) * depth / fx, (row - cy) * depth / fy, depth]).astype(np.float32)
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        for number in range(2):
            made = record(number)
            writer.append(replace(made, cloud=Cloud(xyz)))
    export_samples(tmp_path / "ds", tmp_path / "out", "lerobot")
    feature = json.loads((tmp_path / "out/meta/info.json").read_text())["features"]["observation.images.depth"]
    assert (feature["dtype"], feature["shape"]) == ("image", [12, 16, 1])
    info = feature["info"]
    assert (info["is_depth_map"], info["depth_unit"]) == (True, "mm")
    np.testing.assert_allclose(
        [info["intrinsics"][name] for name in ("fx", "fy", "cx", "cy")], [fx, fy, cx, cy], atol=0.01
    )
    frame = pq.read_table(tmp_path / "out/data/chunk-000/file-000.parquet").to_pylist()[-1]
    with Image.open(io.BytesIO(frame["observation.images.depth"]["bytes"])) as image:
        found = np.asarray(image)
    np.testing.assert_array_equal(found, np.nan_to_num(np.rint(1000.0 * xyz[..., 2])))
    stats = json.loads((tmp_path / "out/meta/stats.json").read_text())["observation.images.depth"]
    np.testing.assert_allclose(np.ravel(stats["max"]), found.max())


def test_rerun_shows_every_episode(exported: Path, tmp_path: Path) -> None:
    rerun = pytest.importorskip("rerun", reason="Rerun is not installed: pip install 'foretouch[view]'")
    out, recording = tmp_path / "imported.rrd", rerun.RecordingStream("import")
    recording.save(out)
    recording.log_file_from_path(exported)
    recording.flush()
    recording.disconnect()
    printed = run_rerun(tmp_path, "rrd", "print", out).splitlines()
    for name in ("observation.tactile.thumb", "observation.pointcloud", "action", "task"):
        assert len([line for line in printed if "with 6 rows" in line and f" - /{name} - " in line]) == 4, name


_READ = """
import json, sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
data = LeRobotDataset("local/foretouch", root=sys.argv[1])
frames = [data[k] for k in range(len(data))]
tables = {name: np.stack([np.asarray(one[name]) for one in frames]) for name in data.features}
np.savez(sys.argv[2], **tables)
print(json.dumps([data.num_frames, data.num_episodes, [one["task"] for one in frames]]))
"""


@pytest.mark.slow
def test_the_newest_lerobot_reads_equal_frames_windows_and_depth(exported: Path, tmp_path: Path) -> None:
    facts, found = read_by_lerobot(exported, tmp_path)
    assert facts == [24, 4, ["grasp the ball"] * 12 + ["grasp the cup"] * 6 + ["grasp the ball"] * 6]
    assert set(found) == set(expected_frames())
    for name, expected in expected_frames().items():
        np.testing.assert_array_equal(found[name], expected, err_msg=name)
    row, column = np.indices((8, 10))
    xyz = np.dstack([(column - 4.5) / 600.0, (row - 3.5) / 600.0, np.ones((8, 10))]).astype(np.float32)
    with RecordingWriter(tmp_path / "images", IDENTITY, QUICK) as writer:
        writer.append(replace(record(0), cloud=Cloud(xyz)))
    export_samples(tmp_path / "images", tmp_path / "depth", "lerobot", fps=40_000_000)
    _, found = read_by_lerobot(tmp_path / "depth", tmp_path)
    stored = pq.read_table(tmp_path / "depth/data/chunk-000/file-000.parquet").to_pylist()
    windows = np.array([one["observation.tactile.thumb.electrode"] for one in stored], np.float32)
    np.testing.assert_array_equal(found["observation.tactile.thumb.electrode"], windows)
    assert windows.shape[1:] == (3, 24, 1)
    np.testing.assert_array_equal(found["observation.images.depth"][:, 0], 1000.0)  # [mm]


def read_by_lerobot(root: Path, tmp_path: Path) -> tuple[list[Any], dict[str, np.ndarray]]:
    """Numbers of frames and episodes with the task of each frame, and all frames by feature."""
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "cache"), "PYTHONPATH": ""}
    command = [lerobot_python(), "-c", _READ, str(root), str(tmp_path / "frames.npz")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    with np.load(tmp_path / "frames.npz") as found:
        return json.loads(done.stdout.splitlines()[-1]), dict(found)


def lerobot_python() -> str:
    """A Python that has `lerobot`, whose environment takes 5 GB and is not made here."""
    python = os.environ.get("FORETOUCH_LEROBOT_PYTHON")
    if not python:
        pytest.skip("lerobot: set FORETOUCH_LEROBOT_PYTHON to a Python 3.12 or newer with lerobot[dataset]")
    return python
