# SPDX-License-Identifier: Apache-2.0
"""The depth range of a cloud, as of PCL's PassThrough."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.kernels import Kernel
from foretouch.types import Float32

_count_range = Kernel("count_range", np.float32, int, float, float, np.int64)


@dataclass(frozen=True, kw_only=True)
class CropConfig(Settings):
    """Depth range along the optical axis."""

    min_range_m: float = setting(0.16, "Points nearer than this are ignored", minimum=0.0, maximum=10.0, unit="m")
    max_range_m: float = setting(2.0, "Points farther than this are ignored", minimum=0.01, maximum=16.0, unit="m")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_range_m >= self.max_range_m:
            raise ConfigError(f"CropConfig.min_range_m: {self.min_range_m} is not below max_range_m {self.max_range_m}")


def in_range(z: npt.NDArray[np.float32], config: CropConfig) -> npt.NDArray[np.bool_]:
    """Whether depths of any shape, float32 [m], are within the range, its ends included; false without depth."""
    return (z >= np.float32(config.min_range_m)) & (z <= np.float32(config.max_range_m))


def count_range(xyz: Float32, config: CropConfig) -> tuple[int, int]:
    """Number of points with a finite depth, and of those in range; xyz is (N, 3) or (H, W, 3) float32, contiguous [m].

    Only z is checked: a pixel without depth has no z, and reading one number takes a third of the time of three.
    """
    counts = np.empty(2, np.int64)
    _count_range(xyz, xyz.size // 3, config.min_range_m, config.max_range_m, counts)
    return int(counts[0]), int(counts[1])
