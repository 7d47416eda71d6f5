# SPDX-License-Identifier: Apache-2.0
"""The depth range of a cloud, as of PCL's PassThrough."""

from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.types import Bool, Float32


@dataclass(frozen=True, kw_only=True)
class CropConfig(Settings):
    """Depth range along the optical axis."""

    min_range_m: float = setting(0.16, "Points nearer than this are ignored", minimum=0.0, maximum=10.0, unit="m")
    max_range_m: float = setting(2.0, "Points farther than this are ignored", minimum=0.01, maximum=16.0, unit="m")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_range_m >= self.max_range_m:
            raise ConfigError(f"CropConfig.min_range_m: {self.min_range_m} is not below max_range_m {self.max_range_m}")


def in_range(z: Float32, config: CropConfig) -> Bool:
    """Whether depths of any shape, float32 [m], are within the range, its ends included; false without depth."""
    return (z >= np.float32(config.min_range_m)) & (z <= np.float32(config.max_range_m))
