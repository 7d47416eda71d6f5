# SPDX-License-Identifier: Apache-2.0
"""Taxel arrays on a flat or curved pad: from the forces on the skin to the values of the channels.

The pad is described (`foretouch.tactile.description`): its surface goes through the taxels, z along their mean
normal and x along the x of the sensor's frame, which points along the finger to its tip. With q the place across z,

    z = -½ qᵀ K q,       K by least squares of K q = (n_x, n_y) / n_z over the taxels; 0 of a flat one

and it ends where the outer taxels end. The elastomer spreads a force by a Gaussian; each taxel takes the part of it that
falls on its area, so that an array without gaps takes all but what is spread over its rim. A channel is the force along an
axis of the taxel, by its name: X, Y or Z as the last letter; P, N, F or `normal` is Z, as is the only channel of a taxel.
X and Y are along the skin; Z is against the outward normal, so that pressure is positive.

Values in N are forces. Others start at a rest level and reach the end of their range at 1.8 N; rest levels and
gains differ from taxel to taxel. XELA states of the uSkin that it is not calibrated, that a cell bears no more than 3 N, and that
magnets and neighbouring modules disturb it (manual of the XR1944, 2020); Tomo et al. (2016) report 1 gf as the least force, and
taxels 4.7 mm apart with little crosstalk. Full scale, spread, noise, drift and crosstalk here are assumptions of that size.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, TactileError
from foretouch.tactile.description import ChannelConfig, Sensor
from foretouch.types import Float64
from foretouch_lab.simulation.contact.pad import ContactFrame, PadConfig, PadWindow, pad_direction
from foretouch_lab.simulation.fingertip import GAIN_SPREAD

FULL_SCALE_N: Final = 1.8  # force on a taxel at which values that are not in newtons leave their range
# Share of a force that each neighbour, and X and Y of the taxel, read.
CROSSTALK: Final = {"neighbours": 0.03, "axes": 0.03}
REST_SPREAD: Final = 0.02  # standard deviation of the rest level from taxel to taxel, of the range
NOISE_N: Final = 0.001  # standard deviation of the noise of a channel whose description states none [N]: 0.1 gf
SESSION_N: Final = 0.02  # standard deviation of the rest level from session to session [N]
KELVIN_N: Final = 0.005  # standard deviation of the drift with the temperature [N/K]

_AXES: Final = {**dict.fromkeys(("p", "n", "f", "normal", "force", "pressure"), 2), "x": 0, "y": 1, "z": 2}
_LEVELS: Final = {"rise": 0.1, "fall": 0.9}  # rest level by what contact does, of the range; else 0.5
_STEEPEST: Final = 0.2  # least part of a taxel's normal along the pad's normal
_FLAT_1_M: Final = 0.1  # curvature below which a pad is flat [1/m]
_NEIGHBOURS: Final = 1.2  # taxels within this many times the least distance are neighbours


@dataclass(frozen=True, kw_only=True)
class TaxelConfig(Settings):
    """What a description does not state of a taxel array; the defaults are assumptions."""

    spread_m: float = setting(0.0015, "Standard deviation by which the elastomer spreads a force", bounds=(1e-5, 0.05))
    alignment: float = setting(
        0.9,
        "Share of the angle between pad and object by which fingertip or object give way, so that flat pads lie on faces",
        bounds=(0.0, 1.0),
    )


@dataclass(frozen=True, eq=False)
class TaxelArray:
    """Both fingertips of a hand with taxel arrays; the V values of a finger are in the order of the channels."""

    sensor: Sensor
    config: TaxelConfig
    pad: PadConfig  # its window is as wide as the array
    middle: ContactFrame  # of the pad, in the sensor's frame
    curvature: Float64  # (2, 2) float64 K [1/m]
    half_m: Float64  # (2,) float64, half of the pad's extent along its x and y [m]
    window: PadWindow  # the whole pad, in which contacts are solved
    axes: Float64  # (N, 3, 3) float64, rows: x, y and outward normal of each taxel in the sensor's frame
    weights: Float64  # (N, cells) float64, the share of a cell's force that each taxel takes
    rest: Float64  # (2, V) float64, values without contact
    gain: Float64  # (2, V) float64, per newton
    kelvin: Float64  # (2, V) float64, change per kelvin

    @classmethod
    def of(cls, sensor: Sensor, config: TaxelConfig, pad: PadConfig, rng: np.random.Generator) -> Self:
        """Return the fingertips of one hand; a `ConfigError` as of `require_channels`.

        Args:
            sensor: The description.
            config: What it does not state.
            pad: Layer and grid.
            rng: Draws what differs from taxel to taxel.
        """
        size = _sizes(sensor)
        middle, curvature, half = _shape(sensor, size)
        pad = pad.replace(window_m=2.0 * float(half.max()))
        x = _tangents(sensor.layout.normals, middle.rotation[:, 0])
        axes = np.stack([x, np.cross(sensor.layout.normals, x), sensor.layout.normals], axis=1)
        window = _window(pad, middle, curvature, half)
        weights = _weights(window.points.reshape(-1, 3), sensor.layout.positions, axes, size, config.spread_m)
        channels, area_m2 = sensor.predicted, float(size.prod(axis=1).mean())
        levels = [_rest_and_gain(channel, area_m2 * sensor.size / count) for channel, count in channels]
        rest, spread, nominal, gain_spread = _each(levels, channels).T
        drawn = rng.standard_normal((3, 2, len(rest)))
        gain, kelvin = nominal * np.exp(gain_spread * drawn[1]), KELVIN_N * nominal * drawn[2]
        return cls(
            sensor, config, pad, middle, curvature, half, window, axes, weights, rest + spread * drawn[0], gain, kelvin
        )

    def aimed(self, pitch_rad: float, roll_rad: float) -> ContactFrame:
        """Return the frame that a finger aims with: where the pad has this normal, of a flat one its middle.

        Args:
            pitch_rad: From the normal of the middle towards the tip [rad].
            roll_rad: Towards +y [rad].
        """
        normal = pad_direction(pitch_rad, roll_rad) * (1.0, 1.0, -1.0)
        place = np.linalg.pinv(self.curvature) @ (normal[:2] / normal[2])
        x, y = np.clip(place, -self.half_m, self.half_m)
        along = _tangents(normal[None], np.array([1.0, 0.0, 0.0]))[0]
        rotation = self.middle.rotation @ np.column_stack([along, np.cross(normal, along), normal])
        return ContactFrame(self.middle.points(x, y, -_depth(self.curvature, x, y)), rotation)

    def aligned(self, frame: ContactFrame, point: Float64, normal: Float64) -> ContactFrame:
        """Return the pad's frame after it has turned about the point where it touches a surface of this outward normal.

        Args:
            frame: Of the pad, in the world.
            point: (3,) where it touches the surface [m].
            normal: (3,) outward normal of the surface there.
        """
        share = self.config.alignment
        towards = (1.0 - share) * frame.normal - share * normal
        towards /= np.linalg.norm(towards)
        x, y, z = np.cross(frame.normal, towards)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + cross + cross @ cross / (1.0 + float(frame.normal @ towards))  # Rodrigues
        return ContactFrame(point + turn @ (frame.origin - point), turn @ frame.rotation)

    def read(self, finger: int, tractions: Float64) -> Float64:
        """Return (V,) values of a finger, 0 or 1, by the tractions (N, N, 3) on its window [Pa], before noise and rounding.

        Args:
            finger: 0 or 1.
            tractions: (N, N, 3) on the window of the pad [Pa].
        """
        forces = self.weights @ (tractions.reshape(-1, 3) * self.pad.step_m**2) @ self.middle.rotation.T
        along = np.einsum("ni,nai->an", forces, self.axes) * [[1.0], [1.0], [-1.0]]
        parts = [along[axis] if of_taxels else along[axis, :].sum(keepdims=True) for axis, _, of_taxels in self._parts]
        return np.asarray(self.rest[finger] + self.gain[finger] * np.concatenate(parts))

    def press(self, finger: int) -> Float64:
        """Return (V,) what a person adds to the values of a finger by pressing every taxel with half of its full scale."""
        force = np.concatenate([np.full(part.stop - part.start, float(axis == 2)) for axis, part, _ in self._parts])
        return np.asarray(0.5 * FULL_SCALE_N * self.gain[finger] * force)

    def with_crosstalk(self, series: Float64) -> Float64:
        """Return a series (T, 2, V) in which neighbours, and the other axes, read a part of each force."""
        force = (series - self.rest) / self.gain
        mixed, taxels = force.copy(), [(axis, part) for axis, part, of_taxels in self._parts if of_taxels]
        normal = dict(taxels).get(2)
        for axis, part in taxels:
            mixed[..., part] += CROSSTALK["neighbours"] * force[..., part] @ self._neighbours
            if axis != 2 and normal is not None:
                mixed[..., part] += CROSSTALK["axes"] * force[..., normal]
        return np.asarray(self.rest + self.gain * mixed)

    def session(self, rng: np.random.Generator) -> Float64:
        """Return (2, V): how far rest levels of one session are from the mean; those that are zero stay."""
        tared = _each([channel.rest == "tare" for channel, _ in self.sensor.predicted], self.sensor.predicted)
        return np.asarray(SESSION_N * self.gain * tared * rng.standard_normal(self.gain.shape))

    def noise(self, rows: int, rng: np.random.Generator) -> Float64:
        """Return (T, 2, V) white noise, of the standard deviation that the description states."""
        stated = _each([channel.noise or 0.0 for channel, _ in self.sensor.predicted], self.sensor.predicted)
        deviation = np.where(stated > 0.0, stated, NOISE_N * np.abs(self.gain))
        return deviation * rng.standard_normal((rows, *deviation.shape))

    def quantise(self, series: Float64) -> Float64:
        """Return a series (T, 2, V) as messages hold it: within saturation and range, and rounded as the type of the channel.

        Dead taxels have the mean of their nearest neighbours, as in recordings. A `TactileError` if a value is not finite.
        """
        if not np.isfinite(series).all():
            raise TactileError(
                f"{self.sensor.config.name}: {np.count_nonzero(~np.isfinite(series))} values are not finite"
            )
        channels = self.sensor.predicted
        low, high = _each([channel.saturation or channel.limits for channel, _ in channels], channels).T
        whole = _each(["int" in channel.dtype for channel, _ in channels], channels)
        quantised = np.clip(np.where(whole, np.rint(series), series.astype(np.float32)), low, high)
        for finger, valid in enumerate(self.sensor.valid):
            for _, part, of_taxels in self._parts:
                if of_taxels:
                    self.sensor.layout.fill(quantised[:, finger, part].T, valid)
        return quantised

    @cached_property
    def _parts(self) -> list[tuple[int, slice, bool]]:
        """Axis and values of each channel, and whether it is of the taxels."""
        channels, values = self.sensor.predicted, self.sensor.config.values
        ends = np.cumsum([count for _, count in channels]).tolist()
        return [
            (_axis(channel, self.sensor), slice(end - count, end), channel in values)
            for (channel, count), end in zip(channels, ends, strict=True)
        ]

    @cached_property
    def _neighbours(self) -> Float64:
        """(N, N) float64: 1 of taxels that are neighbours."""
        distance = _distances(self.sensor.layout.positions)
        nearest = distance.min(axis=1)
        near = np.isfinite(distance) & (distance <= _NEIGHBOURS * np.minimum(nearest, nearest[:, None]))
        return np.asarray(near, np.float64)


def require_channels(sensor: Sensor) -> None:
    """Refuse a sensor that cannot be simulated.

    Raises:
        ConfigError: If a channel is not a force along an axis, or has neither a known unit nor a range; or if half of the taxels
            of a finger are dead, which then counts as not read.
    """
    if (2 * sensor.valid.sum(axis=1) <= sensor.size).any():
        raise ConfigError(f"{sensor.config.name}: dead: half of the taxels of a finger or more")
    for channel, _ in sensor.predicted:
        _axis(channel, sensor)
        _rest_and_gain(channel, 1.0)


def _each(numbers: Sequence[Any], channels: list[tuple[ChannelConfig, int]]) -> Float64:
    """Return (V, ...) numbers of the values, from numbers of the channels."""
    return np.repeat(np.array(numbers, np.float64), [count for _, count in channels], axis=0)


def _axis(channel: ChannelConfig, sensor: Sensor) -> int:
    """0, 1 or 2 for a force along x, y or the normal."""
    name = channel.name.lower()
    axis = _AXES.get(name[-1] if name[-1] in "xyz" else name)
    if axis is None and sum(value.predicted for value in sensor.config.values) == 1:
        axis = 2
    if axis is None:
        raise ConfigError(
            f"{sensor.config.name}: {channel.name}: is not a force that can be simulated; its name must end with X, Y or Z"
        )
    return axis


def _rest_and_gain(channel: ChannelConfig, area_m2: float) -> tuple[float, float, float, float]:
    """Return the mean and spread of the rest level, gain per newton and spread of its logarithm."""
    sign = -1.0 if channel.contact == "fall" else 1.0
    if channel.unit in ("N", "Pa"):
        gain = 1.0 if channel.unit == "N" else 1.0 / area_m2
        return 0.0, SESSION_N * gain * (channel.rest == "tare"), sign * gain, 0.0
    low, high = channel.saturation or channel.limits
    if not math.isfinite(high - low):
        raise ConfigError(
            f"{channel.name}: has neither the unit N or Pa nor a range, by which its gain could be chosen"
        )
    zero = channel.rest == "zero"
    rest = 0.0 if zero else low + _LEVELS.get(channel.contact, 0.5) * (high - low)
    gain = sign * max(high - rest, rest - low) / FULL_SCALE_N
    return rest, 0.0 if zero else REST_SPREAD * (high - low), gain, GAIN_SPREAD


def _sizes(sensor: Sensor) -> Float64:
    """Return (N, 2) extent of the taxels [m]: as stated, else as far as to the next one."""
    stated = np.broadcast_to(sensor.config.array.size if sensor.config.array else 0.0, (sensor.size, 2))
    size = np.where(stated > 0.0, stated, _distances(sensor.layout.positions).min(axis=1)[:, None])
    if not np.isfinite(size).all():
        raise ConfigError(f"{sensor.config.name}: array.size: is needed of a single taxel")
    return size


def _shape(sensor: Sensor, size: Float64) -> tuple[ContactFrame, Float64, Float64]:
    """Return the frame of the pad's middle, K, and half of its extent."""
    positions, normals = sensor.layout.positions, sensor.layout.normals
    mean = normals.mean(axis=0)
    if np.linalg.norm(mean) < _STEEPEST:
        raise ConfigError(f"{sensor.config.name}: its taxels look to all sides, which is not a pad")
    normal = mean / np.linalg.norm(mean)
    x = _tangents(normal[None], np.array([1.0, 0.0, 0.0]))[0]
    rotation = np.column_stack([x, np.cross(normal, x), normal])
    points, directions = positions @ rotation, normals @ rotation
    centre = (points[:, :2].min(axis=0) + points[:, :2].max(axis=0)) / 2.0
    across = points[:, :2] - centre
    slopes = directions[:, :2] / np.maximum(directions[:, 2:], _STEEPEST)
    fitted = np.linalg.lstsq(across, slopes, rcond=1e-9)[0]
    bends, along = np.linalg.eigh((fitted + fitted.T) / 2.0)
    curvature = along @ np.diag(np.where(bends > _FLAT_1_M, bends, 0.0)) @ along.T  # a hollow pad counts as flat
    top = float((points[:, 2] + _depth(curvature, *across.T)).mean())
    half = np.abs(across).max(axis=0) + size.max(axis=0) / 2.0
    return ContactFrame(rotation @ [*centre, top], rotation), curvature, half


def _window(pad: PadConfig, middle: ContactFrame, curvature: Float64, half_m: Float64) -> PadWindow:
    x, y = pad.grid()
    on_pad = (np.abs(x) <= half_m[0]) & (np.abs(y) <= half_m[1])
    return PadWindow(middle, x, y, np.where(on_pad, _depth(curvature, x, y), np.inf))


def _depth(curvature: Float64, x: Any, y: Any) -> Any:
    """Return the depth of the pad below its middle [m] at places x, y."""
    return 0.5 * (curvature[0, 0] * x * x + 2.0 * curvature[0, 1] * x * y + curvature[1, 1] * y * y)


def _weights(cells: Float64, positions: Float64, axes: Float64, size: Float64, spread_m: float) -> Float64:
    """Return (N, cells): the part of a force on each cell that is spread onto each taxel; 0 beside the pad, where cells are NaN."""
    from scipy.special import erf

    offset = np.nan_to_num(cells) - positions[:, None]
    weights = np.tile(np.isfinite(cells).all(axis=1).astype(np.float64), (len(positions), 1))
    for k in range(2):
        along, half = np.einsum("nci,ni->nc", offset, axes[:, k]), size[:, k, None] / 2.0
        scale = math.sqrt(2.0) * spread_m
        weights *= 0.5 * (erf((along + half) / scale) - erf((along - half) / scale))
    return np.asarray(weights / np.maximum(weights.sum(axis=0), 1.0))  # where taxels overlap, they share


def _tangents(normals: Float64, x: Float64) -> Float64:
    """Return (N, 3) unit vectors across normals, as near to x as they allow; where x is a normal, to y of the same frame."""
    along = x - (normals @ x)[:, None] * normals
    other = np.roll(x, 1) - (normals @ np.roll(x, 1))[:, None] * normals
    along = np.where(np.linalg.norm(along, axis=1, keepdims=True) < 1e-6, other, along)
    return np.asarray(along / np.linalg.norm(along, axis=1, keepdims=True))


def _distances(positions: Float64) -> Float64:
    """Return (N, N) from each taxel to each other [m]; infinite to itself."""
    distance = np.asarray(np.linalg.norm(positions[:, None] - positions, axis=2))
    np.fill_diagonal(distance, np.inf)
    return distance
