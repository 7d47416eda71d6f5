# SPDX-License-Identifier: Apache-2.0
"""Datasets of stores that may be larger than memory: clouds are read as they are used, and nothing else changes."""

import dataclasses
import pickle
import shutil
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from run_builders import write_store

from foretouch.dataset.store import content_sha256
from foretouch.errors import FileError
from foretouch.types import Cloud, GraspSample
from foretouch_lab.learning.data import load_dataset
from foretouch_lab.learning.data.dataset import LazySample


def test_a_store_gives_the_samples_that_were_written(samples, store) -> None:
    data = load_dataset(store)
    assert data.sha256 == content_sha256(samples) == content_sha256(data.samples)
    for given, found in zip(samples, pickle.loads(pickle.dumps(data.samples)), strict=True):
        assert isinstance(found, LazySample)
        assert "cloud" not in vars(found)
        np.testing.assert_array_equal(found.cloud.xyz, given.cloud.xyz)
        assert "cloud" not in vars(found)
        np.testing.assert_array_equal(found.touch.values, given.touch.values)
        np.testing.assert_array_equal(found.grasp.g1, given.grasp.g1)
        assert (found.id, found.object, found.stamp_ns) == (given.id, given.object, given.stamp_ns)
    renamed = dataclasses.replace(data.samples[5], id="other")
    np.testing.assert_array_equal(renamed.cloud.xyz, samples[5].cloud.xyz)
    assert renamed.id == "other"
    with pytest.raises(AttributeError, match="LazySample has no attribute 'clouds'"):
        _ = data.samples[0].clouds


def test_a_store_that_is_removed_or_changed_while_it_is_used_is_named(samples, tmp_path) -> None:
    many = [
        dataclasses.replace(samples[k % 60], id=f"box/{k}") for k in range(400)
    ]  # more than a store keeps in memory
    data = load_dataset(write_store(tmp_path / "store", many))
    (shard,) = (tmp_path / "store").glob("*.arrow")
    content = bytearray(shard.read_bytes())
    content[len(content) // 20] ^= 1
    shard.write_bytes(content)
    with pytest.raises(FileError, match=rf"{shard.name}: .*was changed after it was opened"):
        _ = data.samples[0].cloud
    shutil.rmtree(tmp_path / "store")
    with pytest.raises(FileError, match=rf"{shard.name}: No such file"):
        _ = data.samples[0].cloud


_SAMPLES, _POINTS, _MOST_MB = 3072, 3600, 40

_EPOCH = """
import sys
from run_builders import run_config
from foretouch_lab.learning.data import load_dataset
from foretouch_lab.learning.training.run import make_learner

def peak_mb():
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024

def train(path):
    make_learner(run_config(train={"epochs": 1, "batch_size": 16}), load_dataset(path)).fit()

train(sys.argv[1])
before = peak_mb()
train(sys.argv[2])
print(peak_mb() - before)
"""


@pytest.mark.slow
def test_an_epoch_takes_a_fraction_of_the_memory_of_the_clouds(samples, tmp_path, rng) -> None:
    """Measured beyond what a small training takes, in a process of its own."""
    cloud = Cloud(rng.uniform(-0.05, 0.05, (_POINTS, 3)).astype(np.float32) + np.float32([0.0, 0.0, 1.2]))

    def made() -> Iterator[GraspSample]:
        for k in range(_SAMPLES):
            base = samples[k % len(samples)]
            yield dataclasses.replace(base, id=f"{base.object}/{k + 1000}", cloud=cloud)

    paths = [write_store(tmp_path / "small", samples), write_store(tmp_path / "large", made())]
    size_mb = sum(file.stat().st_size for file in paths[1].iterdir()) / 2**20
    environment = {"PYTHONPATH": ":".join(sys.path), "OMP_NUM_THREADS": "1", "TMPDIR": str(tmp_path)}
    script = [sys.executable, "-c", _EPOCH, *map(str, paths)]
    done = subprocess.run(script, check=True, capture_output=True, text=True, env=environment)
    assert float(done.stdout) < _MOST_MB < size_mb / 3
