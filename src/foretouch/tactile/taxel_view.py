# SPDX-License-Identifier: Apache-2.0
"""What markers, figures and Rerun show of a touch of any described sensor: one channel of the taxels, and the scalars as text."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from foretouch.tactile import Ranges
from foretouch.tactile.channels import finger_label
from foretouch.tactile.description import Sensor
from foretouch.types import Float64, Index, Prediction, Touch
from foretouch.types.channels import Channel


@dataclass(frozen=True, eq=False)
class TaxelView:
    """The view of a sensor; its fingers are numbered in the order of `Channels.fingers`: at g1, at g2."""

    sensor: Sensor

    @cached_property
    def fingers(self) -> list[str]:
        """Names of the fingers for people."""
        return [finger_label(name) for name in self.sensor.channels.fingers]

    @cached_property
    def channel(self) -> Channel:
        """The channel of the taxels that is shown: the last one that contact moves in one direction, else the last."""
        channels = self.sensor.taxel_channels
        return next((channel for channel in reversed(channels) if channel.contact), channels[-1])

    @cached_property
    def modalities(self) -> list[str]:
        """Those of the scalars and of the shown channel."""
        shown = (*self.sensor.scalar_channels, self.channel)
        return [name for name, channel in self.sensor.channels.channel_of.items() if channel in shown]

    def columns(self, finger: int) -> Index:
        """Return (N,) columns of a touch: the values of the shown channel."""
        taxels: Index = self.sensor.taxel_columns[finger, :, self.sensor.taxel_channels.index(self.channel)]
        return taxels

    def has_rest(self, rest: Touch | None) -> bool:
        """Return whether changes from rest are known: with a reading at rest, or where that is zero."""
        return rest is not None or not self.channel.tared

    def levels(self, values: Float64, rest: Touch | None, finger: int) -> Float64:
        """Return (..., N) float64 of (..., D) values: the change of each taxel from rest, positive as by contact; its value where rest is not known."""
        values = values[..., self.columns(finger)]
        if not self.has_rest(rest):
            return values
        change: Float64 = values - self._at_rest(rest, finger)
        return -change if self.channel.contact < 0 else change

    def _at_rest(self, rest: Touch | None, finger: int) -> Float64:
        if rest is None or not self.channel.tared:
            return np.zeros(self.sensor.size)
        return rest.values[self.columns(finger)]

    def label(self, *, from_rest: bool) -> str:
        """Return what `levels` are, with their unit."""
        channel = self.channel
        if not from_rest:
            return f"{channel.name} [{channel.unit}]"
        words = {
            -1: f"fall of {channel.name} below rest",
            0: f"change of {channel.name} from rest",
            1: f"rise of {channel.name} above rest",
        }
        return f"{words[channel.contact]} [{channel.unit}]{', + pressed' if channel.contact else ''}"

    def shares(self, values: Float64, rest: Touch | None, ranges: Ranges, finger: int) -> Float64:
        """Return (..., N) float64 in [0, 1]: how far contact has moved each taxel, of (..., D) values of touches.

        Through its range where contact moves it in one direction from a measured rest level; else from rest, of the way to the farther
        end of its range.
        """
        columns, sign = self.columns(finger), self.channel.contact
        low, high = ranges.low[columns], ranges.high[columns]
        if self.channel.tared and (sign or rest is None):
            shown = values[..., columns]
            moved, span = high - shown if sign < 0 else shown - low, high - low
        else:
            at_rest = self._at_rest(rest, finger)
            moved = np.abs(self.levels(values, rest, finger))
            span = np.maximum(np.abs(high - at_rest), np.abs(low - at_rest))
        share: Float64 = np.clip(moved / np.maximum(span, 1e-12), 0.0, 1.0)
        return share

    def pressures(self, values: Float64, rest: Touch | None, ranges: Ranges) -> Float64:
        """Return (..., F) float64: how hard each finger presses, 0 lowest, 1 highest of the range, of (..., D) values of touches.

        By the first scalar that contact raises or lowers; without one, by the mean of the shares of the valid taxels.
        """
        for k, channel in enumerate(self.sensor.scalar_channels):
            if channel.contact:
                columns = self.sensor.scalar_columns[:, k]
                low, high = ranges.low[columns], ranges.high[columns]
                moved = values[..., columns] - low if channel.contact > 0 else high - values[..., columns]
                return np.asarray(moved / (high - low), np.float64)
        fingers = range(len(self.fingers))
        shares = [self.shares(values, rest, ranges, k)[..., self.sensor.valid[k]] for k in fingers]
        none = np.full(values.shape[:-1], np.nan)
        return np.stack([share.mean(axis=-1) if share.shape[-1] else none for share in shares], axis=-1)

    def scalars(self, finger: int, value: Touch, around: Prediction | None = None) -> str:
        """Return the scalars of a finger, such as `PDC 2779 ± 60`, with half widths of a prediction; "" without scalars."""
        return scalars_text(self.sensor.scalar_channels, finger, value, around)


def scalars_text(channels: Sequence[Channel], finger: int, value: Touch, around: Prediction | None = None) -> str:
    """Return numbers of a finger, such as `PDC 2779 ± 60`.

    Args:
        channels: With one number a finger each.
        finger: Number of the finger.
        value: The touch.
        around: Prediction whose half widths are added, where it is calibrated.
    """
    texts = []
    for channel in channels:
        half = ""
        if around is not None and around.calibrated:
            _, lower, upper = around[channel.name]
            half = f" ± {channel.text((upper[finger] - lower[finger]) / 2.0)}"
        texts.append(f"{channel.name} {channel.text(value[channel.name][finger])}{half}")
    return ", ".join(texts)
