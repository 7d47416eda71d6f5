# SPDX-License-Identifier: Apache-2.0
"""From a depth cloud to the objects on the table.

Crop by depth, find the dominant plane, keep what stands out from it, and label it. An organised cloud is
worked on as an image, which is many times faster than a search for neighbours; an unordered one in voxels.
Every outcome has a status and a reason, and every point is counted: received = used + dropped(reason).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.clusters import ClusterConfig, HeightCut, label_points
from foretouch.cloud.segmentation.crop import CropConfig, count_range, in_range
from foretouch.cloud.segmentation.image_clusters import label_image
from foretouch.cloud.segmentation.objects import ObjectSegment, gather_objects
from foretouch.cloud.segmentation.plane import PlaneConfig, fit_plane
from foretouch.cloud.segmentation.targets import TargetConfig, choose_targets
from foretouch.config import Settings, setting
from foretouch.types import Cloud, Float32, Plane

__all__ = [
    "ObjectSegment",
    "Segmentation",
    "SegmentationConfig",
    "SegmentationStatus",
    "TargetConfig",
    "choose_targets",
    "segment",
]

SegmentationStatus = Literal["ok", "empty_cloud", "too_few_points", "no_plane", "no_object"]
Int32 = npt.NDArray[np.int32]

_GRID_ROWS = 120  # coarse rows that suffice to find an object: 848x480 is then looked at every fourth pixel
_PLANE_POINTS = 2048  # that decide on the plane
_SPARSE = 4000  # with fewer points on the coarse grid every pixel counts


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig(Settings):
    """Settings of each step."""

    crop: CropConfig = CropConfig()
    plane: PlaneConfig = PlaneConfig()
    clusters: ClusterConfig = ClusterConfig()
    min_points: int = setting(
        100, "With fewer points in range there is nothing to segment", minimum=3, maximum=10_000_000
    )


@dataclass(frozen=True, eq=False)
class Segmentation:
    """What is on the table.

    Attributes:
        status: "ok" with one object or more, else what is missing.
        reason: Why, in words; "" where ok.
        plane: The table, its normal towards the camera; None without one.
        objects: Nearest centroid first; ids 1, 2, ...
        labels: (H, W) or (N,) int32, the id of each point's object, 0 for none. An object's outline of flying
            pixels is labelled, but their depth is not its own, so they are not in its cloud.
        counts: received = not_finite + out_of_range + background + rejected + flying + objects; background is the
            table, what is below it and what stands alone; rejected are clusters of a wrong size, `n_rejected` of them.
        ms: Time of each stage and `total` [ms].
    """

    status: SegmentationStatus
    reason: str
    plane: Plane | None
    objects: tuple[ObjectSegment, ...]
    labels: Int32
    counts: dict[str, int]
    ms: dict[str, float]


@dataclass(eq=False)
class _Ledger:
    """Counts and times while a cloud is on its way."""

    counts: dict[str, int] = field(default_factory=dict)
    ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.ms[name] = (time.perf_counter() - start) * 1e3


def segment(cloud: Cloud, config: SegmentationConfig | None = None) -> Segmentation:
    """Find the table and the objects on it.

    Args:
        cloud: Camera optical frame [m], organised or not; points without depth are counted and ignored.
        config: Of each step; the defaults if None. The same input gives the same bits.

    Returns:
        The segmentation; it never raises for what a cloud holds.
    """
    config = SegmentationConfig() if config is None else config
    ledger = _Ledger()
    with ledger.stage("total"):
        status, reason, plane, objects, labels = _segment(cloud, config, ledger)
    counts = {"received": cloud.size, "not_finite": 0, "out_of_range": 0, "background": 0}
    counts |= {"rejected": 0, "n_rejected": 0, "flying": 0, "objects": 0} | ledger.counts
    dropped = sum(counts[name] for name in ("not_finite", "out_of_range", "rejected", "flying", "objects"))
    counts["background"] = counts["received"] - dropped
    return Segmentation(status, reason, plane, objects, labels, counts, ledger.ms)


_Outcome = tuple[SegmentationStatus, str, Plane | None, tuple[ObjectSegment, ...], Int32]


def _segment(cloud: Cloud, config: SegmentationConfig, ledger: _Ledger) -> _Outcome:
    xyz = cloud.xyz
    labels = np.zeros(xyz.shape[:-1], np.int32)
    with ledger.stage("crop"):
        finite, usable = count_range(xyz, config.crop)
        ledger.counts |= {"not_finite": cloud.size - finite, "out_of_range": finite - usable}
    if usable == 0:
        return "empty_cloud", _why_empty(xyz[..., 2], config.crop), None, (), labels
    if usable < config.min_points:
        return "too_few_points", f"{usable} points in range, fewer than {config.min_points}", None, (), labels
    with ledger.stage("plane"):
        coarse, stride = _coarse(xyz, config.crop)
        fit = fit_plane(_sample(coarse, config.crop), config.plane)
    if fit.plane is None:
        return "no_plane", fit.reason, None, (), labels
    with ledger.stage("clusters"):
        cut = _height_cut(fit.plane, fit.noise_per_m, config.clusters)
        if cloud.organised:
            windows = label_image(xyz, coarse, stride, config.crop, cut, config.clusters)
        else:
            windows = label_points(xyz, config.crop, cut, config.clusters)
    with ledger.stage("objects"):
        gathered = gather_objects(cloud, windows, fit.plane, config.clusters, labels)
        ledger.counts |= gathered.counts
    if not gathered.objects:
        return "no_object", _why_no_object(ledger.counts["n_rejected"], config.clusters), fit.plane, (), labels
    return "ok", "", fit.plane, gathered.objects, labels


def _coarse(xyz: Float32, config: CropConfig) -> tuple[Float32, int]:
    """An image of 480 rows or more is looked at every fourth pixel, unless few of them are in range."""
    if xyz.ndim == 2:
        return xyz, 1
    stride = int(np.clip(min(xyz.shape[:2]) // _GRID_ROWS, 1, 8))
    coarse = np.ascontiguousarray(xyz[::stride, ::stride])
    if stride == 1 or np.count_nonzero(in_range(coarse[..., 2], config)) >= _SPARSE:
        return coarse, stride
    return np.ascontiguousarray(xyz), 1


def _sample(xyz: Float32, config: CropConfig) -> Float32:
    """Finite points in range, evenly spread over them, as many as the plane needs; (n, 3)."""
    index = np.flatnonzero(in_range(xyz[..., 2], config))
    if len(index) > _PLANE_POINTS:
        index = index[np.linspace(0.0, len(index) - 1.0, _PLANE_POINTS).astype(np.intp)]
    points: Float32 = xyz.reshape(-1, 3).take(index, axis=0)
    good = np.isfinite(points).all(axis=1)
    return points if good.all() else points[good]


def _height_cut(plane: Plane, noise_per_m: float, config: ClusterConfig) -> HeightCut:
    return HeightCut(plane, config.min_height_m, config.noise_factor * noise_per_m, config.max_height_m)


def _why_empty(z: Float32, config: CropConfig) -> str:
    if z.size == 0:
        return "the cloud holds no point"
    finite = z[np.isfinite(z)]
    if finite.size == 0:
        return f"none of {z.size} points is finite"
    return (
        f"no point between {config.min_range_m:g} and {config.max_range_m:g} m: "
        f"depths are {finite.min():g} to {finite.max():g}; is the cloud in metres and in the optical frame?"
    )


def _why_no_object(rejected: int, config: ClusterConfig) -> str:
    if rejected == 0:
        return f"nothing stands more than {config.min_height_m * 1e3:g} mm above the table"
    return (
        f"{rejected} clusters stand out, none with {config.min_points} points, "
        f"higher than {config.min_top_m * 1e3:g} mm and within {config.max_extent_m:g} m"
    )
