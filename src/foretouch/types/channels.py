# SPDX-License-Identifier: Apache-2.0
"""The values of a touch: what each number of a tactile sensor is, in the order in which models predict them.

A modality is one channel of one finger, such as `PDC_TH` (one value) or `E_MF` (24 electrodes). The values of a touch are
modalities one after the other: by channel, first channels of the whole finger, then channels of its taxels; in a channel by finger.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from foretouch.errors import TactileError, none_of, shown
from foretouch.types.summary import Summarised, counted, names_of

LARGEST: Final = 1e9
"""Of a number without a range, such as a force as float32."""

_Floats = npt.NDArray[np.float64]
_Index = npt.NDArray[np.intp]
_Array = TypeVar("_Array", bound=npt.NDArray[Any])


@dataclass(frozen=True)
class Channel:
    """One kind of number that a finger sends: once (a pressure), or of each taxel.

    Attributes:
        name: Such as PDC.
        size: Numbers of a finger.
        unit: Such as counts or N.
        low, high: Range of a working sensor.
        contact: 1 if contact raises the number, -1 if it lowers it, 0 if it may do both.
        tared: Whether its rest level is measured; else it is zero.
        noise: Standard deviation at rest; 0 if it is not known.
        resolution: Smallest difference that means anything: 1 of whole numbers.
    """

    name: str
    size: int
    unit: str
    low: float
    high: float
    contact: int
    tared: bool
    noise: float
    resolution: float

    def text(self, value: float) -> str:
        """Return a number for people: a whole one where the numbers are, else with three digits."""
        return f"{value:.0f}" if self.resolution == 1.0 else f"{value:.3g}"


@dataclass(frozen=True, repr=False)
class Channels(Summarised):
    """The values of a touch of two fingers that carry the same sensor.

    Attributes:
        sensor: Name of the sensor.
        sha256: Hash of its description.
        fingers: Names of the fingers that touch g1 and g2.
        channels: Of each finger.
    """

    sensor: str
    sha256: str
    fingers: tuple[str, ...]
    channels: tuple[Channel, ...]

    def _summary(self) -> tuple[str, dict[str, str]]:
        of_finger = ", ".join(f"{channel.size} x {channel.name} [{channel.unit}]" for channel in self.channels)
        return f"{shown(self.sensor, 40)}, {counted(self.size, 'value')}", {
            "fingers": names_of(self.fingers), "of a finger": of_finger, "modalities": names_of(self.modalities)
        }  # fmt: skip

    @cached_property
    def modalities(self) -> tuple[str, ...]:
        """Names of the modalities in the order of their values, such as PDC_TH, PDC_MF, E_TH, E_MF."""
        return tuple(f"{channel.name}_{finger}" for channel in self.channels for finger in self.fingers)

    @cached_property
    def size(self) -> int:
        """Number of values of a touch."""
        return len(self.fingers) * sum(channel.size for channel in self.channels)

    @cached_property
    def channel_of(self) -> dict[str, Channel]:
        """Channel of each modality, by name."""
        return dict(zip(self.modalities, (channel for channel in self.channels for _ in self.fingers), strict=True))

    @cached_property
    def modality_of_value(self) -> _Index:
        """(D,) index in `modalities` of each value; read-only."""
        return _kept(np.repeat(np.arange(len(self.modalities)), [channel.size for channel in self.channel_of.values()]))

    @cached_property
    def finger_of_value(self) -> _Index:
        """(D,) index in `fingers` of each value; read-only."""
        return _kept(self.modality_of_value % len(self.fingers))

    @cached_property
    def finger_columns(self) -> dict[str, _Index]:
        """Columns of the values of each finger, in order."""
        return {name: np.flatnonzero(self.finger_of_value == k) for k, name in enumerate(self.fingers)}

    @cached_property
    def modality_columns(self) -> dict[str, _Index]:
        """Columns of the values of each modality, in order."""
        return {name: np.flatnonzero(self.modality_of_value == k) for k, name in enumerate(self.modalities)}

    def columns(self, modalities: Sequence[str]) -> _Index:
        """Return (M,) columns of some modalities, in this order; a `TactileError` names an unknown one."""
        unknown = [name for name in modalities if name not in self.modality_columns]
        if unknown:
            raise TactileError(f"modality: {none_of(unknown[0], self.modalities)}")
        return np.concatenate([np.empty(0, np.intp), *(self.modality_columns[name] for name in modalities)])

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of channels and modalities, which `part` takes."""
        return (*(channel.name for channel in self.channels), *self.modalities)

    def part(self, values: _Floats, name: str) -> _Floats:
        """Return values of a channel or of a modality, from (..., D) values of a touch.

        Args:
            values: (..., D) float64.
            name: Of a channel, such as E, or of a modality, such as E_TH.

        Returns:
            Of a channel (..., F, N), or (..., F) if it has one value a finger; of a modality (..., M).

        Raises:
            TactileError: If no channel has that name.
        """
        if isinstance(name, str) and name in self.modality_columns:
            return values[..., self.modality_columns[name]]
        names = [channel.name for channel in self.channels]
        if name not in names:
            raise TactileError(f"channel: {none_of(name, self.part_names)}")
        columns = self.columns([f"{name}_{finger}" for finger in self.fingers])
        part = values[..., columns].reshape(*values.shape[:-1], len(self.fingers), len(columns) // len(self.fingers))
        return part[..., 0] if self.channels[names.index(name)].size == 1 else part

    def by_modality(self, values: npt.ArrayLike) -> Any:
        """Return (D, ...) numbers of the values, from (M, ...) of the modalities."""
        return np.asarray(values)[self.modality_of_value]

    @cached_property
    def low(self) -> _Floats:
        """(D,) float64, lowest number of a working sensor; read-only."""
        return self._of_values("low")

    @cached_property
    def high(self) -> _Floats:
        """(D,) float64, highest number of a working sensor; read-only."""
        return self._of_values("high")

    @cached_property
    def resolution(self) -> _Floats:
        """(D,) float64, smallest difference that means anything; read-only."""
        return self._of_values("resolution")

    @cached_property
    def most(self) -> _Floats:
        """(D,) float64, ten times the largest number of a working sensor, beyond which a prediction is an error; read-only."""
        return _kept(10.0 * np.maximum(np.abs(self.low), np.abs(self.high)))

    @cached_property
    def of_taxels(self) -> npt.NDArray[np.bool_]:
        """(D,) which values are of a taxel, and not of the whole finger; read-only."""
        return _kept(self._of_values("size") > 1.0)

    @cached_property
    def tared(self) -> npt.NDArray[np.bool_]:
        """(D,) whether the rest level is measured, else it is zero; read-only."""
        return _kept(self._of_values("tared") > 0.0)

    @cached_property
    def finger_means(self) -> _Floats:
        """(F, D) float64 matrix that takes the mean of the values of each finger; read-only."""
        return _mean_rows(self.finger_columns, self.size)

    @cached_property
    def modality_means(self) -> _Floats:
        """(M, D) float64 matrix that takes the mean of the values of each modality; read-only."""
        return _mean_rows(self.modality_columns, self.size)

    def _of_values(self, name: str) -> _Floats:
        values = [getattr(channel, name) for channel in self.channel_of.values()]
        return _kept(self.by_modality(np.array(values, np.float64)))


NO_CHANNELS: Final = Channels("", "", (), ())
"""Of a touch whose sensor is not known: it has no values."""


def _mean_rows(groups: Mapping[str, _Index], size: int) -> _Floats:
    rows = np.zeros((len(groups), size))
    for row, values in zip(rows, groups.values(), strict=True):
        row[values] = 1.0 / len(values)
    return _kept(rows)


def _kept(array: _Array) -> _Array:
    array.flags.writeable = False
    return array
