# SPDX-License-Identifier: Apache-2.0
"""Small recorded samples and datasets for the tests of recording, reading and conversion."""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from experiment_samples import make_samples

from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.formats import open_samples
from foretouch.dataset.formats.vision2tactile import CLOUD_FILE, GRASP_FILE, TOUCH_FILE
from foretouch.dataset.identity import Identity
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.source import Source
from foretouch.errors import ForetouchError
from foretouch.grasp.pose import hand_rotation
from foretouch.tactile import biotac_touch
from foretouch.types import APPROACH, DISCARDED, HOLD, REST, Cloud, Grasp, Plane, Sample, Touch, TouchSeries

IDENTITY = Identity(
    hand={"name": "shadow-rh", "serial": "1234", "thumb": "TH", "middle": "MF"},
    camera={"name": "D415", "serial": "777"},
)
QUICK = RecordingConfig(fsync_samples=0, min_free_mb=0.0)
TACTILE = "/rh/tactile"
TACTILE_TYPE = "foretouch_msgs/msg/BiotacAll"
MESSAGE = b"\0\1\0\0" + bytes(200)
MF = [*range(3000, 3024), 2048, 2052, 1894, 2257, 2636]
TH = [*range(2000, 2024), 2060, 2055, 2876, 2058, 2459]


def touch(rng: np.random.Generator) -> Touch:
    """A plausible reading of a working sensor."""
    return biotac_touch(rng.integers(500, 3500, 50).astype(np.float64))


def record(number: int = 0, name: str = "ball", points: int = 30, *, labelled: bool = True) -> Sample:
    """A record with every field set, and different for each number."""
    rng = np.random.default_rng([number, points])
    xyz = (0.03 * rng.normal(size=(points, 3)) + [0.0, 0.0, 1.0]).astype(np.float32)
    rgb = rng.integers(0, 256, (points, 3), dtype=np.uint8)
    g1, g2 = xyz[:2].astype(float)
    length = 6
    series = TouchSeries(
        stamps_ns=np.array([0, 10, 20, 20, 30, 40], np.int64) + 1_700_000_000_000_000_000 + number,
        counts=rng.integers(0, 4096, (length, 50)).astype(np.float32),
        phases=np.array([REST, REST, APPROACH, APPROACH, HOLD, HOLD], np.uint8),
        others={"PAC0_TH": rng.integers(0, 4096, length).astype(np.float32), "TDC_MF": np.ones(length, np.float32)},
    )
    cloud = Cloud(xyz, rgb, "camera", 1_700_000_000_000_000_000 + number)
    sample = Sample(
        id="",
        object=name,
        cloud=cloud,
        grasp=Grasp(g1, g2, hand_rotation(g1, g2, np.array([0.0, 1.0, 0.0])), 0.1 * number, f"grasp-{number}", name),
        touch=touch(rng) if labelled else None,
        tare=touch(rng) if labelled else None,
        stamp_ns=1_700_000_001_000_000_000 * 1 + 7_000_000_000 * number,
        extra={"TDC_MF": 2000.0, "TDC_TH": 2100.5},
        table=Plane.from_coefficients([0.1, 0.2 + 0.01 * number, -1.0, 1.1]),
    )
    plain = replace(sample, candidates=(replace(sample.grasp, id=f"other-{number}", score=float("nan")),))
    if not labelled:
        return plain
    return replace(
        plain,
        outcome="success",
        note="a note",
        series=series,
        contact_ns=1_700_000_000_000_000_030 + number,
        detector="PDC slope",
        pairing_error_ns=3_000_000,
        flags=("arrival_stamped",),
    )


def write_dataset(
    path: Path, count: int = 5, *, points: int = 30, messages: int = 2, name: str = "ball", first: int = 0
) -> Path:
    """Record a session into a dataset; returns its file."""
    with RecordingWriter(path, IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        for number in range(first, first + count):
            for k in range(messages):
                writer.receive(TACTILE)
                writer.write(TACTILE, MESSAGE, 1000 * number + k)
            writer.append(record(number, name, points))
    return writer.file


def write_grasps(path: Path) -> None:
    """Record two sessions of grasps on two boxes: 8 samples with candidates, 6 of them with a touch, 1 discarded."""
    samples = [replace(one, tare=biotac_touch(one.touch.values - 7.0)) for one in make_samples(2, 4)]
    for session in (samples[:4], samples[4:]):
        with RecordingWriter(path, IDENTITY, QUICK) as writer:
            for number, one in enumerate(session):
                rotation = hand_rotation(one.grasp.g1, one.grasp.g2, np.array([0.0, 0.0, 1.0]))
                other = Grasp(one.grasp.g1 + 0.01, one.grasp.g2 + 0.01, rotation, 0.5, "other", one.object)
                sample = replace(one, grasp=replace(one.grasp, rotation=rotation))
                if number == 2:
                    sample = replace(sample, touch=None, tare=None)
                flags = (DISCARDED,) if one is samples[5] else ()
                writer.append(replace(sample, candidates=(other,), flags=flags))


def write_sample(folder: Path, rng: np.random.Generator) -> None:
    """A folder of vision2tactile: half a cylinder with a grasp across it."""
    folder.mkdir(parents=True)
    angle, along = rng.uniform(0, np.pi, 800), rng.uniform(-0.06, 0.06, 800)
    xyz = np.column_stack([0.03 * np.cos(angle), along, 1.2 - 0.03 * np.sin(angle)]).astype(np.float32)
    write_cloud(folder / CLOUD_FILE, Cloud(xyz, np.zeros((800, 3), np.uint8)))
    (folder / GRASP_FILE).write_text("0.03,0,1.2,-0.03,0,1.2")
    (folder / TOUCH_FILE).write_text("," + ",".join(map(str, MF + TH)))


def ids(path: Path) -> list[str]:
    """Of the samples of a recorded dataset."""
    return [sample.id for sample in RecordedDataset(path)]


def read_folder(path: Path) -> list[Sample]:
    """All samples of a dataset, such as folders of vision2tactile."""
    return list(open_samples(path))


def readable(source: Source, refuse: Callable[[str, ForetouchError], Any]) -> Iterator[tuple[str, Cloud | Sample]]:
    """The clouds or samples that can be read, with their names; `refuse` is called with name and error of each other."""
    items = iter(source)
    while True:
        name = str(source.path)
        try:
            item = next(items, None)
            if item is None:
                return
            name = item.name
            value = item.sample or item.cloud
        except ForetouchError as err:
            refuse(name, err)
            continue
        yield name, value


def assert_same_sample(a: Sample, b: Sample) -> None:
    """Compare everything except the ids."""
    assert (a.object, a.stamp_ns, dict(a.extra)) == (b.object, b.stamp_ns, dict(b.extra))
    np.testing.assert_array_equal(a.cloud.xyz, b.cloud.xyz)
    assert (a.cloud.rgb is None) == (b.cloud.rgb is None)
    if a.cloud.rgb is not None and b.cloud.rgb is not None:
        np.testing.assert_array_equal(a.cloud.rgb, b.cloud.rgb)
    for name in ("g1", "g2", "rotation"):
        np.testing.assert_array_equal(getattr(a.grasp, name), getattr(b.grasp, name))
    np.testing.assert_array_equal(a.grasp.score, b.grasp.score)
    for name in ("touch", "tare"):
        one, other = getattr(a, name), getattr(b, name)
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_array_equal(one.values, other.values)
    planes = [None if one.table is None else one.table.coefficients.tolist() for one in (a, b)]
    assert planes[0] == planes[1]


def fail_writes(monkeypatch: pytest.MonkeyPatch, number: int, code: int, part: int | None = None) -> None:
    """Let one write to a recording fail, after `part` bytes got through in the write before it."""
    real, calls = os.write, []

    def failing(fd: int, data: memoryview) -> int:
        if Path(f"/proc/self/fd/{fd}").readlink().suffix != ".mcap":
            return real(fd, data)
        calls.append(fd)
        if len(calls) == number:
            raise OSError(code, os.strerror(code))
        return real(fd, data[:part] if len(calls) < number else data)

    monkeypatch.setattr(os, "write", failing)
