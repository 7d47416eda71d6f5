# SPDX-License-Identifier: Apache-2.0
"""The values of a BioTac SP by `config/sensors/biotac_sp.yaml`, and ranges of the values of any sensor.

P2 predicts four modalities: PDC_TH, PDC_MF (one value each), E_TH and E_MF (24 electrodes each). Their ranges are
settings, not constants: the amount of liquid in a finger shifts its counts, so a range belongs to one pair of fingers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, TactileError
from foretouch.tactile.description import packaged_sensor
from foretouch.types import Bool, Float64, Touch
from foretouch.types.arrays import numbers
from foretouch.types.channels import Channels

BIOTAC_SP: Final = packaged_sensor("biotac_sp")

BIOTAC: Final = BIOTAC_SP.channels
"""The 50 values of a touch of the BioTac SP, which the papers predict."""

FINGER_NAMES: Final = {"TH": "thumb", "MF": "middle finger"}
"""Names of the fingers that touch g1 and g2, for people."""


def finger_label(finger: str) -> str:
    """Return the name of a finger for people; without one, its name in the sensor's description."""
    return FINGER_NAMES.get(finger, finger)


MODALITIES: Final = BIOTAC.modalities
ELECTRODES: Final = BIOTAC_SP.size
TOUCH_SIZE: Final = BIOTAC.size
# The skin: its core is an ellipsoid of revolution about x of the fingertip's frame, under a layer of even thickness.
# The core's semi-axes fit the electrode positions in common use (1 to 20 within 0.03 mm; 21 to 24 sit on a flat up to 0.4 mm inside).
CORE_HALF_LENGTH_M: Final = 0.01237  # along the finger
CORE_RADIUS_M: Final = 0.008  # across the finger
LAYER_M: Final = 0.0014  # thickness of skin and liquid over the core
_NARROWEST: Final = 1e-6  # [counts]
_WIDEST: Final = 1e12  # [counts]


def biotac_touch(values: npt.ArrayLike) -> Touch:
    """Return a reading of the BioTac SP from (50,): PDC_TH, PDC_MF, E_TH, E_MF."""
    return Touch(numbers(values, "touch", TactileError).copy(), BIOTAC)


@dataclass(frozen=True, eq=False)
class Ranges:
    """Lowest and highest number of each modality, for scaling to [0, 1].

    Attributes:
        channels: Of a touch.
        limits: (low, high) of each modality, in their order.
    """

    channels: Channels
    limits: tuple[tuple[float, float], ...]

    @classmethod
    def of_sensor(cls, channels: Channels) -> Self:
        """Make the ranges of a working sensor."""
        return cls(channels, tuple((channel.low, channel.high) for channel in channels.channel_of.values()))

    def of(self, modality: str) -> tuple[float, float]:
        """Return (low, high) of one modality; a `TactileError` if there is no such modality."""
        self.channels.columns([modality])
        return self.limits[self.channels.modalities.index(modality)]

    @cached_property
    def low(self) -> Float64:
        """(D,) float64, lower bounds in the order of a touch; read-only."""
        return self._vector(0)

    @cached_property
    def high(self) -> Float64:
        """(D,) float64, upper bounds in the order of a touch; read-only."""
        return self._vector(1)

    def outside(self, values: npt.ArrayLike) -> Bool:
        """Return which of (..., D) values are outside their range; NaN is outside."""
        numbers = np.asarray(values, np.float64)
        return np.asarray(~((numbers >= self.low) & (numbers <= self.high)), np.bool_)

    def to_mapping(self) -> dict[str, Any]:
        """Return the limits by name of the modality in lower case, for a card."""
        return {name.lower(): list(limits) for name, limits in zip(self.channels.modalities, self.limits, strict=True)}

    @classmethod
    def from_mapping(cls, channels: Channels, mapping: Mapping[str, Any], where: str) -> Self:
        """Read the ranges from a mapping by `to_mapping`; a `ConfigError` names `where` it was read, the modality and the rule."""
        names = [name.lower() for name in channels.modalities]
        for name, limits in mapping.items():
            if name not in names:
                raise ConfigError(f"{where}: {name}: unknown; known: {', '.join(names)}")
            _check_range(f"{where}: {name}", limits)
        if missing := next((name for name in names if name not in mapping), None):
            raise ConfigError(f"{where}: {missing}: is missing")
        return cls(channels, tuple((float(mapping[name][0]), float(mapping[name][1])) for name in names))

    def _vector(self, end: int) -> Float64:
        vector = np.asarray(self.channels.by_modality([limits[end] for limits in self.limits]), np.float64)
        vector.flags.writeable = False  # it is kept
        return vector


def _check_range(name: str, limits: Any) -> None:
    shown = f"{name}: {list(limits) if isinstance(limits, list | tuple) else limits}"
    pair = isinstance(limits, list | tuple) and len(limits) == 2
    usable = pair and all(type(limit) in (int, float) and abs(limit) <= _WIDEST for limit in limits)
    if not usable or limits[0] >= limits[1]:
        raise ConfigError(f"{shown} is not [low, high] with low < high")
    if not _NARROWEST <= limits[1] - limits[0] <= _WIDEST:
        raise ConfigError(f"{shown}: high - low is not between {_NARROWEST:g} and {_WIDEST:g} counts")


@dataclass(frozen=True, kw_only=True)
class TactileRanges(Settings):
    """Lowest and highest count of each modality of the BioTac SP, for scaling to [0, 1].

    Raises:
        ConfigError: If a range is not (low, high) with low < high, or is too narrow or too wide to divide by.
    """

    pdc_th: tuple[float, ...] = setting((2500.0, 3400.0), "Static pressure of the thumb, low and high", unit="counts")
    pdc_mf: tuple[float, ...] = setting((1600.0, 2300.0), "Static pressure of the middle finger", unit="counts")
    e_th: tuple[float, ...] = setting((100.0, 3600.0), "Electrodes of the thumb", unit="counts")
    e_mf: tuple[float, ...] = setting((500.0, 3800.0), "Electrodes of the middle finger", unit="counts")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in MODALITIES:
            _check_range(name.lower(), getattr(self, name.lower()))

    @cached_property
    def ranges(self) -> Ranges:
        """The same as `Ranges`."""
        return Ranges(BIOTAC, tuple(getattr(self, name.lower()) for name in MODALITIES))


P2_RANGES: Final = TactileRanges()  # found empirically for the sensors of P2 (section III-C)


def usual_ranges(channels: Channels) -> Ranges:
    """Return the ranges of a sensor's readings: of the BioTac SP those of P2, of another those of its description."""
    return P2_RANGES.ranges if channels == BIOTAC else Ranges.of_sensor(channels)


#: P1's public code divides the labels by these numbers.
P1_RANGES: Final = TactileRanges(pdc_th=(0.0, 3100.0), pdc_mf=(0.0, 2000.0), e_th=(0.0, 3500.0), e_mf=(0.0, 3800.0))


def skin_axes(layer_m: float = LAYER_M) -> Float64:
    """Return (3,) float64: semi-axes of the skin over a layer of this thickness [m]."""
    across = CORE_RADIUS_M + layer_m
    return np.array([CORE_HALF_LENGTH_M + layer_m, across, across])
