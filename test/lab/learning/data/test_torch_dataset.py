# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from experiment_samples import make_samples
from torch.utils.data import DataLoader

from foretouch.errors import DatasetError
from foretouch.types import NO_CLOUD
from foretouch_lab.learning.data.torch_dataset import TouchDataset


def test_samples_are_tensors_of_fixed_sizes_that_a_loader_stacks():
    samples = make_samples(2, 3)
    data = TouchDataset([*samples, replace(samples[0], touch=None)], points=64)
    points, grasp, touch = next(iter(DataLoader(data, batch_size=6)))
    assert (points.shape, grasp.shape, touch.shape) == ((6, 64, 3), (6, 15), (6, 50))
    for k, sample in enumerate(samples):
        np.testing.assert_array_equal(touch[k], sample.touch.values.astype(np.float32))
        np.testing.assert_array_equal(grasp[k, :3], sample.grasp.g1.astype(np.float32))
        assert {tuple(row) for row in points[k].tolist()} <= {tuple(row) for row in sample.cloud.xyz.tolist()}


def test_what_cannot_be_used_is_named():
    with pytest.raises(DatasetError, match="none is labelled"):
        TouchDataset([])
    with pytest.raises(DatasetError, match="campbells/0: cloud: has no finite point"):
        TouchDataset([replace(make_samples(1, 1)[0], cloud=NO_CLOUD)])
