# SPDX-License-Identifier: Apache-2.0
"""Measures the cost of durability: appends under each policy, a recorder under load, and random reads.

    OMP_NUM_THREADS=1 python benchmarks/durability/speed.py [--folder DIR] [--seconds 20]

Everything that is timed is also read back and compared.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from kill import IDENTITY, made_sample

from foretouch.dataset.bag_writer import serialize_cloud
from foretouch.dataset.recording import RecordedDataset, RecordingConfig, RecordingWriter, SampleRecord, verify_dataset
from foretouch.dataset.store import Store
from foretouch.dataset.store_writer import build_store
from foretouch.types import Cloud

POLICIES = {"left to the system": 0, "every 10th sample": 10, "every sample (default)": 1}
CLOUD = "sensor_msgs/msg/PointCloud2"


def appends(root: Path, count: int = 200) -> None:
    print("append of a sample with 5000 coloured points: wall time [ms]")
    for name, fsync in POLICIES.items():
        folder = root / f"fsync-{fsync}"
        times = []
        with RecordingWriter(folder, IDENTITY, RecordingConfig(fsync_samples=fsync)) as writer:
            records = [SampleRecord(sample=made_sample(k)) for k in range(count)]
            for record in records:
                began = time.perf_counter()
                writer.append(record)
                times.append(1e3 * (time.perf_counter() - began))
        p50, p99 = np.quantile(times, [0.5, 0.99])
        print(f"  fsync {name:24s} median {p50:6.2f}  p99 {p99:6.2f}")
        assert all(report.clean for report in verify_dataset(folder))


def load(root: Path, seconds: float, raw_hz: int) -> None:
    """At the rates of the sensors: object clouds 30 Hz, tactile 100 Hz, raw clouds at `raw_hz`, a sample each 2 s."""
    folder = root / f"load-{raw_hz}"
    rng = np.random.default_rng(0)
    small = serialize_cloud(Cloud(rng.normal(size=(5000, 3)).astype(np.float32), None, "camera", 1))
    big = serialize_cloud(Cloud(rng.normal(size=(480, 848, 3)).astype(np.float32), None, "camera", 1))
    streams = [("/object_cloud", CLOUD, small, 30), ("/rh/tactile", "foretouch_msgs/msg/BiotacAll", bytes(600), 100)]
    streams += [("/points", CLOUD, big, raw_hz)] if raw_hz else []
    lateness = []
    with RecordingWriter(folder, IDENTITY) as writer:
        for topic, kind, _, _ in streams:
            writer.add_topic(topic, kind)
        due = sorted((k / rate, topic, data) for topic, _, data, rate in streams for k in range(int(seconds * rate)))
        cpu, began, sample_at = time.process_time(), time.perf_counter(), 0.0
        for at, topic, data in due:
            wait = at - (time.perf_counter() - began)
            if wait > 0:
                time.sleep(wait)
            lateness.append(time.perf_counter() - began - at)
            writer.receive(topic)
            writer.write(topic, data, time.time_ns())
            if at >= sample_at:
                writer.append(SampleRecord(sample=made_sample(int(at))))
                sample_at += 2.0
        cpu = time.process_time() - cpu
    counts = writer.counts.topics.values()
    dropped = sum(topic.dropped.total() for topic in counts)
    written = sum(topic.written for topic in counts)
    rate = writer.bytes_written / seconds / 1e6
    print(
        f"load with raw clouds at {raw_hz} Hz, {seconds:g} s: {written} messages, {rate:.1f} MB/s, dropped {dropped}, "
        f"CPU {100 * cpu / seconds:.0f} % of one core, worst delay of a message {1e3 * max(lateness):.0f} ms"
    )
    assert all(report.clean for report in verify_dataset(folder))
    shutil.rmtree(folder)


def reads(root: Path, count: int = 600) -> None:
    folder = root / "reads"
    with RecordingWriter(folder, IDENTITY, RecordingConfig(fsync_samples=0)) as writer:
        for k in range(count):
            made = made_sample(k)
            writer.append(SampleRecord(sample=replace(made, tare=made.touch, extra={"TDC_TH": 2000.0})))
    build_store([folder], root / "store")
    order = np.random.default_rng(1).permutation(count)
    with RecordedDataset(folder) as recorded:
        store = Store(root / "store")
        for k in order[:20]:
            sample = recorded[int(k)].record.sample
            assert np.array_equal(store[int(k)].cloud.xyz, sample.cloud.xyz)
            assert np.array_equal(store[int(k)].grasp.g1, sample.grasp.g1)
        print(f"random read of one of {count} samples of 5000 coloured points, all bytes copied: wall time [us]")
        _timed("training store (Arrow IPC)", lambda k: store[k].cloud, order)
        _timed("recording (MCAP, SHA-256 checked)", lambda k: recorded[k].record.sample.cloud, order)


def _timed(name: str, read: Callable[[int], Cloud], order: np.ndarray) -> None:
    times = []
    for k in order:
        began = time.perf_counter()
        cloud = read(int(k))
        cloud.xyz.copy()
        if cloud.rgb is not None:
            cloud.rgb.copy()
        times.append(1e6 * (time.perf_counter() - began))
    p50, p95 = np.quantile(times, [0.5, 0.95])
    print(f"  {name:36s} median {p50:6.0f}  p95 {p95:6.0f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, help="where to write: the disk that is measured")
    parser.add_argument("--seconds", type=float, default=20.0)
    arguments = parser.parse_args()
    root = Path(tempfile.mkdtemp(prefix="foretouch-speed-", dir=arguments.folder))
    try:
        appends(root)
        reads(root)
        load(root, arguments.seconds, 0)
        load(root, arguments.seconds, 10)
    finally:
        shutil.rmtree(root, ignore_errors=True)


if __name__ == "__main__":
    main()
