# SPDX-License-Identifier: Apache-2.0
"""Preparation of clouds and grasps as inputs of a network: the same code in training and in prediction.

The cloud is sampled to a fixed number of points and mapped to the unit sphere at its centroid, and the contacts with
it. The rotation of the hand is the same in both frames. Five lengths of a cloud and a grasp show whether they are within
their ranges in training.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from foretouch.cloud.geometry.pcl_filters import normals_and_curvature
from foretouch.cloud.geometry.sampling import UnitSphereFrame, sample_indices
from foretouch.errors import CloudError, ModelError
from foretouch.kernels import Kernel
from foretouch.models.network.config import ModelConfig
from foretouch.types import Bool, Cloud, Float32, Float64, Grasp, Grasps, Integer

_MINIMUM_POINTS = 32
"""Fewer points do not represent a shape; the sparsest of the public clouds holds 814."""

SAMPLER_SEED = 0
"""Of the points that prediction chooses."""
_nearest_squares = Kernel("nearest_squares")

LENGTHS: Final = ("range_m", "radius_m", "width_m", "offset_m", "gap_m")
"""Distance of the cloud from the camera, its radius about its centroid, the distance of the contacts from each
other, of their midpoint from the centroid, and of the farther contact from the nearest point that the model uses."""

_MARGIN: Final = 0.1  # of a length's range, by which a grasp may leave it

_DM_PER_M = 10.0


@dataclass(frozen=True, eq=False)
class PreparedCloud:
    """One cloud in the frame of the network."""

    points: Float32  # (N, C) float32: x, y, z in the unit sphere, then colour or normal
    frame: UnitSphereFrame  # from the cloud's frame to the unit sphere


def finite_points(cloud: Cloud, config: ModelConfig) -> Cloud:
    """Return the points that have a depth, unorganised.

    Raises:
        CloudError: If fewer than `_MINIMUM_POINTS` remain, or all are at one position.
        ModelError: If the network needs a colour that the cloud lacks.
    """
    if config.channels == "xyz+rgb" and cloud.rgb is None:
        raise ModelError("channels: the model needs xyz+rgb and the cloud has no rgb")
    finite = np.isfinite(cloud.xyz)
    usable = cloud.take(np.arange(cloud.size) if finite.all() else np.asarray(finite.all(axis=-1), np.bool_))
    if usable.size < _MINIMUM_POINTS:
        raise CloudError(f"cloud: {usable.size} finite points of {cloud.size} are fewer than {_MINIMUM_POINTS}")
    if (usable.xyz == usable.xyz[0]).all():
        raise CloudError(f"cloud: all {usable.size} finite points are in one place")
    return usable


def prepare_cloud(cloud: Cloud, config: ModelConfig) -> PreparedCloud:
    """Sample a cloud [m] in any frame, with `SAMPLER_SEED`, and map it to the unit sphere; raises as `finite_points`."""
    usable = finite_points(cloud, config)
    rng = np.random.default_rng(SAMPLER_SEED)  # so that one cloud always gives the same input
    frame = UnitSphereFrame.fit(usable.xyz)
    index = sample_indices(usable.size, config.n_points, rng)
    return PreparedCloud(sample_channels(usable, index, frame, config), frame)


def sample_channels(cloud: Cloud, index: Integer, frame: UnitSphereFrame, config: ModelConfig) -> Float32:
    """Return (n, C) float32: the chosen points as inputs of the network.

    Colour is scaled to [-1, 1], the range of P2's generator. Normals are of unit length.

    Args:
        cloud: (N, 3), finite.
        index: (n,) indices into the cloud.
        frame: Fitted to the cloud.
        config: Of the network.
    """
    xyz = frame.apply_points(cloud.xyz[index])
    if config.channels == "xyz":
        return np.ascontiguousarray(xyz, np.float32)
    if config.channels == "xyz+rgb":
        if cloud.rgb is None:
            raise ModelError("channels: the model needs xyz+rgb and the cloud has no rgb")
        other = cloud.rgb[index].astype(np.float32) / 127.5 - 1.0
    else:
        other = _normals(cloud.xyz, index)
    return np.concatenate([xyz, other], axis=1, dtype=np.float32)


def prepare_grasps(grasps: Sequence[Grasp], frame: UnitSphereFrame, config: ModelConfig) -> Float32:
    """Return (K, G) float32: g1, g2 in the unit sphere, R row by row, then radius and width [dm] if configured.

    Args:
        grasps: In the cloud's frame.
        frame: Of the cloud.
        config: Of the network; G is 0 without grasp inputs.
    """
    count = len(grasps)
    if not config.use_grasp or count == 0:
        return np.zeros((count, config.grasp_size), np.float32)
    columns = Grasps.of(grasps)
    g1 = columns.g1
    g2 = columns.g2
    rotations = columns.rotation
    parts = [frame.apply_points(g1), frame.apply_points(g2), rotations.reshape(count, 9)]
    if config.metric_inputs:
        width = np.linalg.norm(g1 - g2, axis=1)
        parts += [np.full((count, 1), frame.scale * _DM_PER_M), width[:, None] * _DM_PER_M]
    return np.concatenate(parts, axis=1).astype(np.float32)


def _normals(xyz: Float32, index: Integer) -> Float64:
    """Return (n, 3) unit normals towards the camera; zero where fewer than three points are near."""
    return np.nan_to_num(normals_and_curvature(xyz, index)[0], nan=0.0)


@dataclass(frozen=True, eq=False)
class LengthRangeCheck:
    """Ranges of the five lengths over the training samples, widened by a tenth on both sides."""

    low: Float64  # (5,) float64 [m], in the order of `LENGTHS`
    high: Float64  # (5,) float64 [m], in the order of `LENGTHS`

    @classmethod
    def fit(cls, lengths: Float64) -> Self:
        """Fit to (S, 5) lengths of the training samples."""
        return cls(lengths.min(axis=0), lengths.max(axis=0))

    @classmethod
    def from_card(cls, ranges: Mapping[str, Sequence[float]]) -> Self:
        """Read the plain data of `to_card`.

        Raises:
            ModelError: If a length is missing or its range is not [low, high].
        """
        try:
            low, high = np.array([ranges[name] for name in LENGTHS], np.float64).T
            if not (low <= high).all():
                raise ValueError("a low end is above the high one")
        except (KeyError, TypeError, ValueError) as err:
            raise ModelError(f"familiar: must give [low, high] for each of {', '.join(LENGTHS)}") from err
        return cls(low, high)

    def to_card(self) -> dict[str, list[float]]:
        """Return plain data for the card's field `familiar`."""
        return {name: [float(a), float(b)] for name, a, b in zip(LENGTHS, self.low, self.high, strict=True)}

    def within(self, lengths: Float64) -> Bool:
        """Return (K,) whether all five of each of (K, 5) lengths are in their ranges."""
        margin = _MARGIN * (self.high - self.low)
        inside = (lengths >= self.low - margin) & (lengths <= self.high + margin)
        return np.asarray(inside.all(axis=1), np.bool_)


def grasp_lengths(prepared: PreparedCloud, grasps: Sequence[Grasp]) -> Float64:
    """Return (K, 5) float64 [m]: the `LENGTHS` of each grasp on a cloud."""
    if not grasps:
        return np.empty((0, len(LENGTHS)))
    frame = prepared.frame
    columns = Grasps.of(grasps)
    g1, g2 = columns.g1, columns.g2
    offset = np.linalg.norm((g1 + g2) / 2.0 - frame.centre, axis=1)
    width = np.linalg.norm(g1 - g2, axis=1)
    cloud = [float(np.linalg.norm(frame.centre)), frame.scale]
    gap = np.maximum(_nearest(prepared, g1), _nearest(prepared, g2))
    return np.column_stack([np.tile(cloud, (len(grasps), 1)), width, offset, gap])


def _nearest(prepared: PreparedCloud, targets: Float64) -> Float64:
    """Return (T,) distance of (T, 3) points from the nearest sampled point [m]."""
    moved, points = prepared.frame.apply_points(targets).astype(np.float32), prepared.points[:, :3]
    squared = np.empty(len(moved), np.float32)
    _nearest_squares(moved, len(moved), points.T.copy(), len(points), squared)
    return np.asarray(np.sqrt(squared) * prepared.frame.scale, np.float64)
