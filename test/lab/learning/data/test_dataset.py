# SPDX-License-Identifier: Apache-2.0
"""Datasets of stores that may be larger than memory: clouds are read as they are used, and nothing else changes."""

import dataclasses
import pickle

import numpy as np
import pytest

from foretouch.dataset.store import content_sha256
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
