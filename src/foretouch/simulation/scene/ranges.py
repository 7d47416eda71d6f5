# SPDX-License-Identifier: Apache-2.0
"""A rule that many fields of a scene share: (low, high) to draw from."""

import numpy as np

from foretouch.config import Settings
from foretouch.errors import ConfigError


def require_range(settings: Settings, name: str, lowest: float | None = None) -> None:
    """Refuse a tuple that is not (low, high) with low <= high.

    Raises:
        ConfigError: Names the field.
    """
    value = getattr(settings, name)
    place = f"{type(settings).__name__}.{name}"
    if len(value) != 2 or value[0] > value[1]:
        raise ConfigError(f"{place}: {list(value)} is not [low, high] with low <= high")
    if lowest is not None and value[0] < lowest:
        raise ConfigError(f"{place}: {value[0]} is below {lowest}")


def draw(rng: np.random.Generator, limits: tuple[float, ...]) -> float:
    """A number from (low, high), uniformly."""
    return float(rng.uniform(limits[0], limits[1]))
