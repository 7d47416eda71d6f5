# SPDX-License-Identifier: Apache-2.0
"""Export to LeRobotDataset v3, written with pyarrow alone; every executed grasp is an episode, every reading a frame.

The frames hold what policies train on: both fingers, the grasp as the action, and the cloud with a fixed number of points. Each channel
of a finger is also its own feature, `observation.tactile.FINGER.CHANNEL`, taxels x axes, whose `info` states where the taxels are and
what their numbers mean (`_described`). At a chosen rate, such as a camera's, a frame holds a window: the newest readings at its time,
oldest first, with their stamps. Clouds that are images are depth maps in millimetres, with their intrinsics.
LeRobot assumes a constant rate, so that `timestamp` is frame_index / fps, and `stamp_ns` is the sensor's own time. What the
tables cannot hold (all points, colours, candidates, notes, samples without a touch) is in the folder `foretouch` beside them,
a recorded dataset, from which an export is imported again.

Statistics are as LeRobot combines them: statistics of the whole dataset follow from the episodes', quantiles as their
means weighted by frames.
"""

import io
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from foretouch.base.files import write_text
from foretouch.dataset.recordings import reader
from foretouch.dataset.recordings.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import ExportResult, SampleSet
from foretouch.errors import ConfigError, FileError
from foretouch.tactile.channels import finger_label
from foretouch.tactile.description import Sensor
from foretouch.types import DISCARDED, SECOND_NS, AnyArray, Cloud, Float32, Index, Int64, Sample

_SAMPLES: Final = "foretouch"  # folder of the recorded dataset
_POINTS: Final = 1024  # of each cloud
_FILES_A_CHUNK: Final = 1000
_FILE_MB: Final = 100
_PATH: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_INFO: Final = "meta/info.json"
_QUANTILES: Final = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_STAMPS: Final = "observation.tactile.stamps_ns"  # of the readings of a window
_DEPTH: Final = "observation.images.depth"
_AXES: Final = ("X", "Y", "Z")  # channels that are the axes of one feature
_SIDES: Final = ["height", "width", "channels"]
_SAME_PIXELS: Final = 0.5  # between intrinsics of one camera, as its clouds have them
_FASTEST: Final = 10  # frames per reading
_ACTION: Final = [f"{contact}_{axis}" for contact in ("g1", "g2") for axis in "xyz"] + [
    f"rotation_{row}{column}" for row in range(3) for column in range(3)
]


def export(
    samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None], fps: int | None = None
) -> None:
    """Write samples in this format (arguments: `export` in `foretouch.dataset.formats`).

    With `fps`, frames hold windows of readings.
    """
    out.mkdir(parents=True)
    tables = _Tables(out, samples, fps)
    config = RecordingConfig(fsync_samples=0, min_free_mb=0.0)
    with RecordingWriter(out / _SAMPLES, samples.identity, config, sensor=samples.sensor) as writer, closing(tables):
        for sample in samples.with_discarded():
            progress()
            writer.append(sample)
            if reason := _no_episode(sample, tables.seen):
                result.left_out[reason] += 1
            else:
                tables.add(sample)
                result.samples += 1
    if not result.samples:
        raise FileError(samples.path, "holds no executed grasp with a touch to export")
    tables.finish(samples.identity.hand.get("model", ""))


def _no_episode(sample: Sample, seen: bool) -> str:
    """Return why a sample is not an episode, or "" if it is one."""
    if DISCARDED in sample.flags or sample.touch is None:
        return "discarded" if DISCARDED in sample.flags else "unlabelled"
    return "" if len(sample.cloud.finite) or not seen else "no points"


def _survey(samples: SampleSet) -> tuple[list[str], int, set[tuple[int, ...]]]:
    """Return what the episodes have in common: channels of both fingers besides their touches, readings per second, shapes of clouds."""
    others: list[set[str]] = []
    periods: list[float] = []
    shapes: set[tuple[int, ...]] = set()
    for sample in samples:
        if (series := sample.readings) is None:
            continue
        suffixes = [f"_{finger}" for finger in samples.sensor.channels.fingers]
        both = [{name.removesuffix(suffix) for name in series.others if name.endswith(suffix)} for suffix in suffixes]
        others = [set.intersection(*both, *others)]
        periods += np.diff(series.stamps_ns)[:100].tolist()
        if len(sample.cloud.finite):
            shapes.add(sample.cloud.xyz.shape[:-1])
    period_ns = float(np.median(periods or [0]))
    rate = max(1, round(SECOND_NS / period_ns)) if period_ns else 1
    return sorted(set().union(*others)), rate, shapes


class _Tables:
    """The tables of a dataset: adds episodes, and writes what describes them at the end.

    Attributes:
        seen: Whether an episode has points; else it was recorded without a camera, and its grasp is not known.
    """

    def __init__(self, root: Path, samples: SampleSet, fps: int | None) -> None:
        self._others, rate, shapes = _survey(samples)
        if fps and fps > _FASTEST * rate:
            raise ConfigError(f"fps: {fps} exceeds {_FASTEST} times the rate of the readings, {rate} Hz")
        sensor, self.seen = samples.sensor, bool(shapes)
        self._window = window = -(-rate // fps) if fps else 0
        self._fingers = {finger: _finger_key(finger) for finger in sensor.channels.fingers}
        self._parts = _described(sensor, self._fingers)
        names = [*_value_names(sensor), *(name.lower() for name in self._others)]
        outer = ["readings"] if window else []
        # Names of the values of features, and further facts; the rest follows from the first episode.
        self._stated = {
            name: {"names": [*outer, "taxels", "axes"], "info": part[1]} for name, part in self._parts.items()
        }
        self._stated |= {f"observation.tactile.{finger}": {"names": names} for finger in self._fingers.values()}
        self._stated |= {_STAMPS: {"names": outer}, "action": {"names": _ACTION}}
        self._stated["observation.pointcloud"] = {"names": [f"{xyz}{k}" for k in range(_POINTS) for xyz in "xyz"]}
        self._features: dict[str, dict[str, Any]] = {}
        image = next(iter(shapes)) if len(shapes) == 1 else ()
        if len(image) == 2:
            info = {"is_depth_map": True, "depth_unit": "mm", "intrinsics": None}
            self._features[_DEPTH] = {"dtype": "image", "shape": [*image, 1], "names": _SIDES, "info": info}
        self._root = root
        self._columns = sensor.channels.finger_columns
        self._fps = fps or rate
        self._tasks: dict[str, int] = {}
        self._stats: dict[str, dict[str, AnyArray]] = {}  # of all frames so far
        self._frames = self._episodes = 0  # written so far
        self._writers: dict[str, pq.ParquetWriter] = {}  # of the one file of frames, and of the file of episodes

    def add(self, sample: Sample) -> None:
        """Write the frames of a grasp that has a touch."""
        task = f"grasp the {sample.object}"
        frames = self._frames_of(sample, self._tasks.setdefault(task, len(self._tasks)))
        count, stats = len(frames["index"]), {}
        for name, values in frames.items():
            feature = {"dtype": values.dtype.name, "shape": [*values.shape[1:]] or [1], "names": None}
            shape = self._features.setdefault(name, feature | self._stated.get(name, {}))["shape"]
            stats[name] = _statistics(values.reshape(count, -1), shape)
        if _DEPTH in self._features:
            image = self._depth_of(sample)
            frames[_DEPTH] = np.full(count, _tiff(image), object)
            stats[_DEPTH] = _statistics(image.reshape(-1, 1), [1, 1, 1])
        self._write(
            "data", pa.table({name: _arrow(frames[name], description) for name, description in self._features.items()})
        )
        self._stats = {name: _combined([self._stats[name], own]) if self._stats else own for name, own in stats.items()}
        episode = {
            "episode_index": self._episodes,
            "tasks": [task],
            "length": count,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + count,
            "sample_id": sample.id,
            "outcome": sample.outcome,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            **{f"stats/{name}/{what}": value.tolist() for name, own in stats.items() for what, value in own.items()},
        }
        self._write("meta/episodes", pa.Table.from_pylist([episode]))
        self._frames += count
        self._episodes += 1

    def _frames_of(self, sample: Sample, task: int) -> dict[str, AnyArray]:
        """Return the columns of a grasp's frames by feature, without its depth image."""
        series = sample.readings
        assert series is not None  # noqa: S101  it has a touch
        newest, window = _frames(series.stamps_ns, self._fps, self._window)
        count = len(newest)
        numbers = np.arange(count)
        frames: dict[str, AnyArray] = {
            "timestamp": (numbers / self._fps).astype(np.float32),
            "frame_index": numbers,
            "episode_index": np.full(count, self._episodes),
            "index": self._frames + numbers,
            "task_index": np.full(count, task),
            "stamp_ns": series.stamps_ns[newest],
        }
        if self.seen:
            action = np.concatenate([sample.grasp.g1, sample.grasp.g2, sample.grasp.rotation.ravel()])
            frames["action"] = np.tile(action.astype(np.float32), (count, 1))
            frames["observation.pointcloud"] = np.tile(_points(sample.cloud), (count, 1))
        for name, (columns, _) in self._parts.items():
            frames[name] = series.counts[window][..., columns].astype(np.float32)
        if self._window:
            frames[_STAMPS] = series.stamps_ns[window]
        for finger, name in self._fingers.items():
            own = series.counts[:, self._columns[finger]]
            others = [series.others[f"{channel}_{finger}"] for channel in self._others]
            frames[f"observation.tactile.{name}"] = np.column_stack([own, *others]).astype(np.float32)[newest]
        return frames

    def _depth_of(self, sample: Sample) -> AnyArray:
        """Return the depth image of a sample, whose camera must have the intrinsics of the samples before it."""
        image, intrinsics = _depth(sample.cloud)
        info = self._features[_DEPTH]["info"]
        known = info["intrinsics"] or intrinsics
        if any(abs(known[name] - value) > _SAME_PIXELS for name, value in intrinsics.items()):
            raise FileError(self._root, f"{sample.id}: its camera has other intrinsics: {intrinsics}")
        info["intrinsics"] = known
        return image

    def close(self) -> None:
        """End the files of frames and episodes."""
        for writer in self._writers.values():
            writer.close()

    def _write(self, folder: str, rows: Any) -> None:
        """Append a table to the file of a folder, as one group of rows."""
        if folder not in self._writers:
            path = self._root / folder / _PATH.format(chunk_index=0, file_index=0)
            path.parent.mkdir(parents=True)
            self._writers[folder] = pq.ParquetWriter(path, rows.schema, compression="zstd")
        self._writers[folder].write_table(rows)

    def finish(self, robot_type: str) -> None:
        """Write the descriptions of features and tasks."""
        meta = self._root / "meta"
        tasks = pa.table({"task_index": list(self._tasks.values()), "task": list(self._tasks)})
        # Readers take the column `task` as the index of the rows, as pandas notes it.
        described = [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": "object", "metadata": None}
            for name, kind in (("task_index", "int64"), ("task", "unicode"))
        ]
        index = {"index_columns": ["task"], "columns": described, "column_indexes": []}
        pq.write_table(tasks.replace_schema_metadata({"pandas": json.dumps(index)}), meta / "tasks.parquet")
        stats = {name: {what: value.tolist() for what, value in self._stats[name].items()} for name in self._features}
        info = {
            "codebase_version": "v3.0",
            "robot_type": robot_type or None,
            "total_episodes": self._episodes,
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": _FILES_A_CHUNK,
            "data_files_size_in_mb": _FILE_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{self._episodes}"},
            "data_path": f"data/{_PATH}",
            "video_path": None,
            "features": self._features,
        }
        for file, content in ((meta / "stats.json", stats), (self._root / _INFO, info)):
            write_text(file, json.dumps(content, indent=1))


def _value_names(sensor: Sensor) -> list[str]:
    """Return the names of the values of a finger, such as `pdc` and `electrode_1`, or `taxel_x_1`."""
    names = []
    for channel in sensor.channels.channels:
        key = _channel_key(channel.name)
        names += [key] if channel.size == 1 else [f"{key}_{k}" for k in range(1, channel.size + 1)]
    return names


def _described(sensor: Sensor, fingers: Mapping[str, str]) -> dict[str, tuple[Index, dict[str, Any]]]:
    """Return (N, C) columns of a touch, and what they are, of each channel of each finger; x, y and z are the axes of one.

    Positions and normals of the taxels are in the frame of the sensor [m]; values of a whole finger have none.
    """
    described: dict[str, tuple[Index, dict[str, Any]]] = {}
    layout, own = sensor.layout, {finger.name: finger for finger in sensor.config.fingers}
    stated = {config.name: config for config, _ in sensor.predicted}
    groups: dict[str, list[int]] = {}
    for k, channel in enumerate(sensor.taxel_channels):
        groups.setdefault("taxel" if channel.name in _AXES else _channel_key(channel.name), []).append(k)
    places = {"positions": layout.positions.tolist(), "normals": layout.normals.tolist()}
    for number, (name, key) in enumerate(fingers.items()):
        parts = [
            (group, sensor.taxel_columns[number][:, axes], [sensor.taxel_channels[k] for k in axes])
            for group, axes in groups.items()
        ]
        parts += [
            (_channel_key(channel.name), sensor.scalar_columns[number : number + 1, [k]], [channel])
            for k, channel in enumerate(sensor.scalar_channels)
        ]
        for group, columns, channels in parts:
            info: dict[str, Any] = {
                "sensor": sensor.config.name,
                "sensor_sha256": sensor.sha256,
                "axes": [channel.name for channel in channels],
                "unit": channels[0].unit,
                "range": [[channel.low, channel.high] for channel in channels],
                "contact": [stated[channel.name].contact for channel in channels],
                "rest": "tare" if channels[0].tared else "zero",
                "rate_hz": sensor.config.update_rate,
                "frame": own[name].parent if name in own else "",
            }
            if channels[0] in sensor.taxel_channels:
                info |= {**places, "valid": sensor.valid[number].tolist()}
            described[f"observation.tactile.{key}.{group}"] = columns, info
    return described


def _frames(stamps_ns: Int64, fps: int, window: int) -> tuple[Index, Index]:
    """Return (F,) newest reading of each frame, and (F,) or (F, W) readings of its window; each is a frame without a window.

    Before W readings there are, the first is repeated.
    """
    newest = np.arange(len(stamps_ns))
    if not window:
        return newest, newest
    times = np.arange(stamps_ns[0], stamps_ns[-1] + 1, SECOND_NS // fps)
    newest = np.searchsorted(stamps_ns, times, side="right") - 1
    return newest, np.maximum(newest[:, None] - np.arange(window)[::-1], 0)


def _depth(cloud: Cloud) -> tuple[AnyArray, dict[str, float]]:
    """Return (H, W) uint16 depth of an organised cloud [mm], 0 without, and the intrinsics that its points have [pixels]."""
    z = np.nan_to_num(cloud.xyz[..., 2].astype(np.float64))
    rows, columns = np.nonzero(z > 0.0)
    rays = cloud.xyz[rows, columns, :2] / z[rows, columns, None]
    intrinsics = []
    for ray, pixel in ((rays[:, 0], columns), (rays[:, 1], rows)):
        intrinsics.append([round(float(number), 2) for number in np.polyfit(ray, pixel, 1)])
    (fx, cx), (fy, cy) = intrinsics
    image = np.clip(np.rint(1000.0 * z), 0, 65535).astype(np.uint16)
    return image, {"fx": fx, "fy": fy, "cx": cx, "cy": cy}


def _tiff(image: AnyArray) -> bytes:
    """Return a depth map as an uncompressed TIFF file, as LeRobot stores it."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, "TIFF")
    return file.getvalue()


def _arrow(values: AnyArray, feature: Mapping[str, Any]) -> Any:
    if feature["dtype"] == "image":
        return pa.array([{"bytes": value, "path": None} for value in values])
    if feature["shape"] == [1]:
        return pa.array(values.ravel())
    array = pa.array(values.ravel())
    if len(feature["shape"]) == 1:
        return pa.FixedSizeListArray.from_arrays(array, feature["shape"][0])
    for size in feature["shape"][::-1]:  # as `datasets` stores arrays of two dimensions or more
        array = pa.ListArray.from_arrays(pa.array(np.arange(0, len(array) + 1, size), pa.int32()), array)
    return array


def _points(cloud: Cloud) -> Float32:
    """Return the coordinates of `_POINTS` points with depth, evenly spaced in their order; some are repeated if there are fewer."""
    finite = cloud.finite
    return np.asarray(finite[np.arange(_POINTS) * len(finite) // _POINTS].ravel(), np.float32)


def _statistics(values: AnyArray, shape: Sequence[int]) -> dict[str, AnyArray]:
    """Return the statistics of (T, D) values by column, in the shape of a feature."""
    wide = values.astype(np.float64)
    statistics = {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": wide.mean(axis=0),
        "std": wide.std(axis=0),
    }
    quantiles = np.quantile(wide, list(_QUANTILES.values()), axis=0)
    statistics |= dict(zip(_QUANTILES, quantiles, strict=True))
    return {"count": np.array([len(values)]), **{name: value.reshape(shape) for name, value in statistics.items()}}


def _combined(episodes: Sequence[Mapping[str, AnyArray]]) -> dict[str, AnyArray]:
    stacked = {what: np.stack([episode[what] for episode in episodes]) for what in episodes[0]}
    share = stacked["count"] / stacked["count"].sum()
    weights = share.reshape(-1, *[1] * (stacked["mean"].ndim - 1))
    mean = (weights * stacked["mean"]).sum(axis=0)
    variance = (weights * (stacked["std"] ** 2 + (stacked["mean"] - mean) ** 2)).sum(axis=0)
    return {
        "min": stacked["min"].min(axis=0),
        "max": stacked["max"].max(axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": stacked["count"].sum(axis=0),
        **{what: (weights * stacked[what]).sum(axis=0) for what in _QUANTILES},
    }


def recognise(path: Path) -> bool:
    """Return whether a folder is a LeRobot dataset."""
    return (path / _INFO).is_file()


def open_set(path: Path, unfinished: bool) -> SampleSet:
    """Return the samples of an export from the recorded dataset in it (raises a `FileError` for other LeRobot datasets)."""
    if not (path / _SAMPLES).is_dir():
        rule = f"is a LeRobot dataset without the folder {_SAMPLES}, which an export of foretouch has"
        raise FileError(path, f"{rule}: write its taxels with foretouch.write, as examples/import_lerobot.py does")
    return replace(reader.open_set(path / _SAMPLES, unfinished), path=path, kind="lerobot")


def _finger_key(finger: str) -> str:
    """Return the name of a finger in columns, such as middle_finger."""
    return finger_label(finger).replace(" ", "_")


def _channel_key(channel: str) -> str:
    """Return the name of a channel in columns, such as pdc and electrode; x, y and z are the coordinates of a taxel."""
    name = channel.lower()
    return {"e": "electrode", **{axis: f"taxel_{axis}" for axis in "xyz"}}.get(name, name)
