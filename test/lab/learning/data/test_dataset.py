# SPDX-License-Identifier: Apache-2.0
"""Datasets of stores that may be larger than memory: clouds are read as they are used, and nothing else changes."""

import dataclasses
import pickle
import tracemalloc

import numpy as np
import pytest
from run_builders import run_config, write_store

from foretouch.dataset.store import content_sha256
from foretouch.types import Cloud
from foretouch_lab.learning.data import load_dataset
from foretouch_lab.learning.data.dataset import LazySample
from foretouch_lab.learning.training.learners import make_learner


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


@pytest.mark.slow
def test_an_epoch_takes_a_fraction_of_the_memory_of_the_clouds(samples, store, tmp_path, rng) -> None:
    cloud = Cloud(rng.uniform(-0.05, 0.05, (3600, 3)).astype(np.float32) + np.float32([0.0, 0.0, 1.2]))
    many = [dataclasses.replace(samples[k % 60], id=f"box/{k}", cloud=cloud) for k in range(1000)]
    path = write_store(tmp_path / "large", many)
    chosen = run_config(train={"epochs": 1, "batch_size": 16})
    make_learner(chosen, load_dataset(store)).fit()  # loads what is needed
    tracemalloc.start()
    make_learner(chosen, load_dataset(path)).fit()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < sum(file.stat().st_size for file in path.iterdir()) / 2
