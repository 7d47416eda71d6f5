# SPDX-License-Identifier: Apache-2.0
"""Export to LeRobotDataset v3, written with pyarrow alone; every executed grasp is an episode, every reading a frame.

The frames hold what policies train on: both fingers, the grasp as the action, and the cloud with a fixed number of points.
LeRobot assumes a constant rate, so that `timestamp` is frame_index / fps, and `stamp_ns` is the sensor's own time. What the
tables cannot hold (all points, colours, candidates, notes, samples without a touch) is in the folder `foretouch` beside them,
a recorded dataset, from which an export is imported again.

Statistics are as LeRobot combines them: those of the whole dataset follow from those of the episodes, quantiles as their
means weighted by frames.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from foretouch.dataset.record import DISCARDED, SampleRecord, readings
from foretouch.dataset.recording.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import DatasetFormat, ExportResult, SampleSet, open_samples
from foretouch.dataset.taxels import channel_key, finger_key
from foretouch.errors import FileError
from foretouch.tactile.description import Sensor
from foretouch.types import SECOND_NS, AnyArray, Cloud, Float32

_SAMPLES: Final = "foretouch"  # folder of the recorded dataset
_POINTS: Final = 1024  # of each cloud
_FILES_A_CHUNK: Final = 1000
_FILE_MB: Final = 100
_PATH: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_INFO: Final = "meta/info.json"
_QUANTILES: Final = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_OWN: Final = ("timestamp", "frame_index", "episode_index", "index", "task_index", "stamp_ns")
_ACTION: Final = [f"{contact}_{axis}" for contact in ("g1", "g2") for axis in "xyz"] + [
    f"rotation_{row}{column}" for row in range(3) for column in range(3)
]


def _export(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    out.mkdir(parents=True)
    others, period_ns = _survey(samples)
    tables = _Tables(out, samples.sensor, others, max(1, round(SECOND_NS / period_ns)) if period_ns else 1)
    config = RecordingConfig(fsync_samples=0, fsync_s=0.0, min_free_mb=0.0)
    with RecordingWriter(out / _SAMPLES, samples.identity, config, sensor=samples.sensor) as writer, closing(tables):
        for record in samples.records(discarded=True):
            progress()
            writer.append(record)
            if reason := _no_episode(record):
                result.left_out[reason] += 1
            else:
                tables.add(record)
                result.written += 1
    if not result.written:
        raise FileError(samples.path, "holds no executed grasp with a touch to export")
    tables.finish(samples.identity.hand.get("model", ""))


def _no_episode(record: SampleRecord) -> str:
    """Why a sample is not an episode, or "" if it is one."""
    if DISCARDED in record.flags or record.sample.touch is None:
        return "discarded" if DISCARDED in record.flags else "unlabelled"
    return "" if np.isfinite(record.sample.cloud.xyz).all(axis=-1).any() else "no points"


def _survey(samples: SampleSet) -> tuple[list[str], float]:
    """What all samples have of both fingers besides their touches, and the median period of their readings [ns], or 0."""
    others: list[set[str]] = []
    periods = []
    for record in samples.records():
        if (series := readings(record)) is not None:
            suffixes = [f"_{finger}" for finger in samples.sensor.channels.fingers]
            both = [{name.removesuffix(one) for name in series.others if name.endswith(one)} for one in suffixes]
            others = [set.intersection(*both, *others)]
            periods += np.diff(series.stamps_ns)[:100].tolist()
    return sorted(set().union(*others)), float(np.median(periods or [0]))


class _Rows:
    """Writes the rows of a table to numbered files of about 100 MB."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._number = 0  # of the current file
        self._path = folder
        self._writer: pq.ParquetWriter | None = None

    def place(self) -> tuple[int, int]:
        """Numbers of the chunk and the file that the next rows are written to."""
        if self._writer is not None and self._path.stat().st_size >= _FILE_MB * 1_000_000:
            self.close()
            self._writer, self._number = None, self._number + 1
        return divmod(self._number, _FILES_A_CHUNK)

    def write(self, rows: Any) -> None:
        """Append a table, as one group of rows."""
        chunk, file = self.place()
        if self._writer is None:
            self._path = self._folder / _PATH.format(chunk_index=chunk, file_index=file)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(self._path, rows.schema, compression="zstd")
        self._writer.write_table(rows)

    def close(self) -> None:
        """End the current file."""
        if self._writer is not None:
            self._writer.close()


class _Tables:
    """The tables of a dataset: adds episodes, and writes what describes them at the end."""

    def __init__(self, root: Path, sensor: Sensor, others: Sequence[str], fps: int) -> None:
        names = [*_value_names(sensor), *(name.lower() for name in others)]
        self._fingers = {finger: finger_key(finger) for finger in sensor.channels.fingers}
        vectors = {f"observation.tactile.{finger}": names for finger in self._fingers.values()}
        vectors |= {"action": _ACTION, "observation.pointcloud": [f"{xyz}{k}" for k in range(_POINTS) for xyz in "xyz"]}
        self._features = {
            name: {"dtype": "float32", "shape": [len(one)], "names": one} for name, one in vectors.items()
        } | {
            name: {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None} for name in _OWN
        }
        self._root, self._columns, self._others, self._fps = root, sensor.channels.finger_columns, others, fps
        self._tasks: dict[str, int] = {}
        self._stats: dict[str, dict[str, AnyArray]] = {}  # of all frames so far
        self._frames = self._episodes = 0  # written so far
        self._data, self._meta = _Rows(root / "data"), _Rows(root / "meta/episodes")

    def add(self, record: SampleRecord) -> None:
        """Write the frames of a grasp."""
        series, sample = readings(record), record.sample
        assert series is not None  # noqa: S101  it has a touch
        count, task = len(series.stamps_ns), f"grasp the {sample.object}"
        numbers = np.arange(count)
        action = np.concatenate([sample.grasp.g1, sample.grasp.g2, sample.grasp.rotation.ravel()]).astype(np.float32)
        frames: dict[str, AnyArray] = {
            "action": np.tile(action, (count, 1)),
            "observation.pointcloud": np.tile(_points(sample.cloud), (count, 1)),
            "timestamp": (numbers / self._fps).astype(np.float32),
            "frame_index": numbers,
            "episode_index": np.full(count, self._episodes),
            "index": self._frames + numbers,
            "task_index": np.full(count, self._tasks.setdefault(task, len(self._tasks))),
            "stamp_ns": series.stamps_ns,
        }
        for finger, name in self._fingers.items():
            own = series.counts[:, self._columns[finger]]
            others = [series.others[f"{channel}_{finger}"] for channel in self._others]
            frames[f"observation.tactile.{name}"] = np.column_stack([own, *others]).astype(np.float32)
        chunk, file = self._data.place()
        self._data.write(pa.table({name: _arrow(frames[name], one) for name, one in self._features.items()}))
        stats = {name: _statistics(values.reshape(count, -1)) for name, values in frames.items()}
        self._stats = {name: _combined([self._stats[name], one]) if self._stats else one for name, one in stats.items()}
        meta_chunk, meta_file = self._meta.place()
        episode = {
            "episode_index": self._episodes,
            "tasks": [task],
            "length": count,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + count,
            "sample_id": sample.id,
            "outcome": record.outcome,
            "meta/episodes/chunk_index": meta_chunk,
            "meta/episodes/file_index": meta_file,
            **{f"stats/{name}/{what}": value.tolist() for name, one in stats.items() for what, value in one.items()},
        }
        self._meta.write(pa.Table.from_pylist([episode]))
        self._frames += count
        self._episodes += 1

    def close(self) -> None:
        """End the files of frames and episodes."""
        self._data.close()
        self._meta.close()

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
            file.write_text(json.dumps(content, indent=1), encoding="utf-8")


def _value_names(sensor: Sensor) -> list[str]:
    """Names of the values of a finger, such as `pdc` and `electrode_1`, or `taxel_x_1`."""
    names = []
    for one in sensor.channels.channels:
        key = channel_key(one.name)
        names += [key] if one.size == 1 else [f"{key}_{k}" for k in range(1, one.size + 1)]
    return names


def _arrow(values: AnyArray, feature: Mapping[str, Any]) -> Any:
    if feature["shape"] == [1]:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(values.ravel(), feature["shape"][0])


def _points(cloud: Cloud) -> Float32:
    """The coordinates of so many points with depth, evenly spaced in their order; some are repeated if there are fewer."""
    finite = cloud.xyz.reshape(-1, 3)[np.isfinite(cloud.xyz).all(axis=-1).ravel()]
    return np.asarray(finite[np.arange(_POINTS) * len(finite) // _POINTS].ravel(), np.float32)


def _statistics(values: AnyArray) -> dict[str, AnyArray]:
    """Statistics of (T, D) values by column."""
    wide = values.astype(np.float64)
    found = {"min": values.min(axis=0), "max": values.max(axis=0), "mean": wide.mean(axis=0), "std": wide.std(axis=0)}
    quantiles = np.quantile(wide, list(_QUANTILES.values()), axis=0)
    return {**found, "count": np.array([len(values)]), **dict(zip(_QUANTILES, quantiles, strict=True))}


def _combined(episodes: Sequence[Mapping[str, AnyArray]]) -> dict[str, AnyArray]:
    stacked = {what: np.stack([one[what] for one in episodes]) for what in episodes[0]}
    weights = stacked["count"] / stacked["count"].sum()
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


def _open(path: Path, unfinished: bool) -> SampleSet:
    if not (path / _SAMPLES).is_dir():
        raise FileError(path, f"is a LeRobot dataset without the folder {_SAMPLES}, which an export of foretouch has")
    return replace(open_samples(path / _SAMPLES, unfinished=unfinished), path=path, kind="lerobot")


DATASET_FORMAT = DatasetFormat(recognise=lambda path: (path / _INFO).is_file(), open=_open, export=_export)
