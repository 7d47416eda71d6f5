# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from foretouch.cloud.segmentation.clusters import CropConfig, in_range
from foretouch.cloud.segmentation.segment import _count_depths
from foretouch.errors import ConfigError


def test_the_range_includes_its_ends() -> None:
    z = np.array([0.1, 0.16, 1.0, 2.0, 2.1, np.nan, np.inf, -np.inf, -1.0], np.float32)
    np.testing.assert_array_equal(np.flatnonzero(in_range(z, CropConfig())), [1, 2, 3])
    xyz = np.zeros((len(z), 3), np.float32)
    xyz[:, 2] = z
    assert _count_depths(xyz, CropConfig()) == (6, 3)
    with pytest.raises(ConfigError, match=r"min_range_m: 1\.5 is not below max_range_m 1\.0"):
        CropConfig(min_range_m=1.5, max_range_m=1.0)
