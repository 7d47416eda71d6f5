# SPDX-License-Identifier: Apache-2.0
"""What many groups of a scene share: ranges (low, high) to draw from, and groups without settings."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from foretouch.config import Settings, setting_infos
from foretouch.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Switch(Settings):
    """A group without settings: `{}` switches its effect on."""


@dataclass(frozen=True, kw_only=True)
class RangedSettings(Settings):
    """Settings whose lists of numbers are ranges (low, high) to draw from.

    Raises:
        ConfigError: If one is not; names the field.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in _ranges(type(self)):  # type: ignore[arg-type]  # a class is hashable
            value = getattr(self, name)
            if value is not None and (len(value) != 2 or value[0] > value[1]):
                raise ConfigError(f"{name}: {list(value)} is not [low, high] with low <= high")


@cache
def _ranges(cls: type[Settings]) -> list[str]:
    infos = setting_infos(cls)
    return [info.name for info in infos if info.is_list and info.type is float and "." not in info.name]


def draw(rng: np.random.Generator, limits: tuple[float, ...]) -> float:
    """Return a number from (low, high), uniformly."""
    return float(rng.uniform(limits[0], limits[1]))
