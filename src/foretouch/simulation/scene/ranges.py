# SPDX-License-Identifier: Apache-2.0
"""What many groups of a scene share: ranges (low, high) to draw from, and groups without settings."""

from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings
from foretouch.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Switch(Settings):
    """A group without settings: `{}` switches its effect on."""


def require_range(settings: Settings, *names: str, lowest: float | None = None) -> None:
    """Refuse tuples that are not (low, high) with low <= high.

    Raises:
        ConfigError: Names the field.
    """
    for name in names:
        value = getattr(settings, name)
        place = f"{type(settings).__name__}.{name}"
        if len(value) != 2 or value[0] > value[1]:
            raise ConfigError(f"{place}: {list(value)} is not [low, high] with low <= high")
        if lowest is not None and value[0] < lowest:
            raise ConfigError(f"{place}: {value[0]} is below {lowest}")


def draw(rng: np.random.Generator, limits: tuple[float, ...]) -> float:
    """A number from (low, high), uniformly."""
    return float(rng.uniform(limits[0], limits[1]))
