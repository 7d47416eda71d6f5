# SPDX-License-Identifier: Apache-2.0
"""Taxels that have failed: where their numbers are, and what takes their place.

A reading of a taxel cannot be used if its taxel is declared dead, or if it was not read (NaN) or is out of its range. A taxel is found
to be dead in the samples of a dataset if one of its numbers is, over all of them, constant, at a limit of its range, or not usable.
"""

from typing import Final

import numpy as np

from foretouch.tactile.description import Sensor
from foretouch.types import AnyArray, Bool, Float64
from foretouch.types.channels import Channels

_FEWEST_READINGS: Final = 5
"""Of which a taxel may be found to be dead."""


def usable(readings: Float64, channels: Channels, valid: Bool | None = None) -> Float64:
    """Return (..., D) readings with NaN for numbers of taxels that cannot be used; `valid` are (D,) those not declared dead."""
    inside = (readings >= channels.low) & (readings <= channels.high)
    return np.where(channels.of_taxels & ~(inside if valid is None else inside & valid), np.nan, readings)


def is_storable(readings: AnyArray, channels: Channels) -> bool:
    """Return whether (..., D) readings are finite, but for NaN of taxels that were not read."""
    return bool((np.isfinite(readings) | (np.isnan(readings) & channels.of_taxels)).all())


def dead_taxels(sensor: Sensor, readings: Float64) -> Bool:
    """Return (F, N) taxels that (S, D) readings show to be dead; none of fewer than five readings.

    A number that is zero at rest and has no noise, such as a force that no contact reached, may be constant. Of a finger of which half of the taxels or
    more would be dead none is: it was not read.
    """
    if len(readings) < _FEWEST_READINGS:
        return np.zeros(sensor.valid.shape, np.bool_)
    channels, values = sensor.channels, usable(readings, sensor.channels)
    spread = np.fmax.reduce(values) - np.fmin.reduce(values)  # NaN where none is usable
    at_limit = ~((values > channels.low) & (values < channels.high)).any(axis=0)
    noisy = channels.tared | channels.by_modality([channel.noise > 0.0 for channel in channels.channel_of.values()])
    failed = np.isnan(spread) | (noisy & ((spread == 0.0) | at_limit))
    dead: Bool = failed[sensor.taxel_columns].any(axis=-1)
    dead[2 * dead.sum(axis=1) >= sensor.size] = False
    return dead


def with_dead_taxels(sensor: Sensor, readings: Float64) -> Sensor:
    """Return the sensor, with the taxels declared dead that (S, D) readings show to be dead."""
    dead = dead_taxels(sensor, readings)
    return sensor.with_dead(dead) if (dead & sensor.valid).any() else sensor


def filled(readings: Float64, sensor: Sensor) -> Float64:
    """Return (S, D) readings with numbers for those that cannot be used, so that a model can be fitted to all taxels.

    A dead taxel has the mean of the nearest valid ones, as a dead pixel of a camera has. One that was not read once has its mean over the
    other readings, moved as the valid taxels of its finger are.
    """
    result = usable(readings, sensor.channels, sensor.valid_values)
    if not np.isnan(result).any():
        return result
    count = (~np.isnan(result)).sum(axis=0)
    mean = np.nansum(result, axis=0) / np.maximum(count, 1)
    for own in sensor.channels.modality_columns.values():
        moved = result[:, own] - mean[own]
        shift = np.nansum(moved, axis=1) / np.maximum((~np.isnan(moved)).sum(axis=1), 1)
        result[:, own] = np.where(np.isnan(moved), mean[own] + shift[:, None], result[:, own])
    for columns, valid in zip(sensor.taxel_columns, sensor.valid, strict=True):
        part = result.T[columns]  # (N, C, S)
        sensor.layout.fill(part, valid)
        result.T[columns] = part
    return result
