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
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from foretouch.cloud.clusters import ClusterConfig, Clusters, HeightCut, label_image, label_points
from foretouch.cloud.crop import CropConfig, in_range
from foretouch.cloud.objects import ObjectSegment, TargetConfig, choose_targets
from foretouch.cloud.plane import PlaneConfig, PlaneFit, fit_plane
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
_PLANE_POINTS = 4096  # that decide on the plane
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
    labels = np.zeros(cloud.xyz.shape[:-1], np.int32)
    with ledger.stage("crop"):
        kept = _crop(cloud.xyz, config.crop, ledger)
    usable = int(np.count_nonzero(kept))
    if usable == 0:
        return "empty_cloud", _why_empty(cloud, config.crop, ledger), None, (), labels
    if usable < config.min_points:
        return "too_few_points", f"{usable} points in range, fewer than {config.min_points}", None, (), labels
    with ledger.stage("plane"):
        stride = _stride(kept) if cloud.organised else 1
        grid = (slice(None, None, stride),) * (cloud.xyz.ndim - 1)
        fit = fit_plane(_sample(cloud.xyz[grid], kept[grid], _PLANE_POINTS), config.plane)
    if fit.plane is None:
        return "no_plane", fit.reason, None, (), labels
    with ledger.stage("clusters"):
        clusters = _label(cloud.xyz, kept, fit, config.clusters, stride)
    with ledger.stage("objects"):
        objects = () if clusters is None else _objects(cloud, clusters, fit.plane, config.clusters, labels, ledger)
    if not objects:
        return "no_object", _why_no_object(ledger, config.clusters), fit.plane, (), labels
    return "ok", "", fit.plane, objects, labels


def _crop(xyz: Float32, config: CropConfig, ledger: _Ledger) -> npt.NDArray[np.bool_]:
    """Points in range, by depth alone: a pixel without depth has no z, and testing one number costs a third."""
    z = np.ascontiguousarray(xyz[..., 2])
    kept = in_range(z, config)
    finite = int(np.count_nonzero(np.isfinite(z)))
    ledger.counts["not_finite"] = z.size - finite
    ledger.counts["out_of_range"] = finite - int(np.count_nonzero(kept))
    return kept


def _sample(xyz: Float32, kept: npt.NDArray[np.bool_], count: int) -> Float32:
    """At most `count` finite rows of those kept, evenly spread over them."""
    index = np.flatnonzero(kept)
    if len(index) > count:
        index = index[np.linspace(0.0, len(index) - 1.0, count).astype(np.intp)]
    points = xyz.reshape(-1, 3)[index] if xyz.ndim == 2 else xyz[np.divmod(index, xyz.shape[1])]
    good = np.isfinite(points).all(axis=1)
    return points if good.all() else points[good]


def _stride(kept: npt.NDArray[np.bool_]) -> int:
    """Of the coarse grid: an image of 480 rows or more is looked at every fourth pixel."""
    stride = int(np.clip(min(kept.shape) // _GRID_ROWS, 1, 4))
    return stride if np.count_nonzero(kept[::stride, ::stride]) >= _SPARSE else 1


def _label(
    xyz: Float32, kept: npt.NDArray[np.bool_], fit: PlaneFit, config: ClusterConfig, stride: int
) -> Clusters | None:
    if fit.plane is None:
        return None
    cut = HeightCut(fit.plane, config.min_height_m, config.noise_factor * fit.noise_per_m, config.max_height_m)
    if xyz.ndim == 3:
        return label_image(xyz, kept, cut, config, stride)
    return label_points(xyz, kept, cut, config)


def _objects(
    cloud: Cloud, clusters: Clusters, plane: Plane, config: ClusterConfig, labels: Int32, ledger: _Ledger
) -> tuple[ObjectSegment, ...]:
    """Clusters of a sensible size as objects, nearest first; writes their ids into `labels`."""
    pixels, ends = _members(clusters, labels.shape)
    points = cloud.take(pixels)
    sizes = np.diff(ends, prepend=0)
    rejected = 0
    found = []
    for cluster in np.flatnonzero(sizes):
        span = slice(int(ends[cluster]) - int(sizes[cluster]), int(ends[cluster]))
        candidate = _object(points, pixels, span)
        if _plausible(candidate, plane, config):
            found.append((candidate.distance_m, int(cluster), candidate))
        else:
            rejected += candidate.n_points
            ledger.counts["n_rejected"] = ledger.counts.get("n_rejected", 0) + 1
    found.sort(key=lambda entry: entry[:2])
    ids = np.zeros(len(ends), np.int32)
    ids[[cluster for _, cluster, _ in found]] = np.arange(1, len(found) + 1)
    placed = _part(labels, clusters)
    np.take(ids, clusters.labels, out=placed, mode="clip")
    used = sum(candidate.n_points for _, _, candidate in found)
    ledger.counts |= {"objects": used, "rejected": rejected, "flying": int(np.count_nonzero(placed)) - used}
    return tuple(replace(candidate, id=number) for number, (_, _, candidate) in enumerate(found, 1))


def _object(points: Cloud, pixels: npt.NDArray[np.int64], span: slice) -> ObjectSegment:
    """The rows of one cluster, not yet numbered."""
    xyz = points.xyz[span]
    columns = np.ascontiguousarray(xyz.T)  # reductions along rows of three are slow
    bounds = np.stack([columns.min(axis=1), columns.max(axis=1)]).astype(np.float64)
    centroid = columns.mean(axis=1, dtype=np.float64)
    rgb = None if points.rgb is None else points.rgb[span]
    return ObjectSegment(0, Cloud(xyz, rgb, points.frame_id, points.stamp_ns), pixels[span], centroid, bounds)


def _plausible(candidate: ObjectSegment, plane: Plane, config: ClusterConfig) -> bool:
    """Neither speckle nor noise of the table, nor a wall."""
    return bool(
        candidate.n_points >= config.min_points
        and (candidate.bounds[1] - candidate.bounds[0]).max() <= config.max_extent_m
        and plane.height(candidate.cloud.xyz).max() >= config.min_top_m
    )


def _part(image: Int32, clusters: Clusters) -> Int32:
    """The part of an image (or list) that the clusters cover, as a view."""
    if image.ndim == 1:
        return image
    height, width = clusters.labels.shape
    return image[clusters.rows : clusters.rows + height, clusters.columns : clusters.columns + width]


def _members(clusters: Clusters, shape: tuple[int, ...]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The solid points of all clusters.

    Returns:
        (n,) int64 flat indices into the cloud, by cluster, ascending within; and for each label where its own end.
    """
    place = np.flatnonzero(clusters.solid)
    owner = clusters.labels.reshape(-1)[place]
    order = np.argsort(owner.astype(np.min_scalar_type(clusters.count)), kind="stable")  # 8 or 16 bits: a radix sort
    flat = place[order].astype(np.int64, copy=False)
    if len(shape) == 2:
        rows, columns = np.divmod(flat, clusters.labels.shape[1])
        flat = (rows + clusters.rows) * shape[1] + columns + clusters.columns
    return flat, np.cumsum(np.bincount(owner, minlength=clusters.count + 1))


def _why_empty(cloud: Cloud, config: CropConfig, ledger: _Ledger) -> str:
    if cloud.size == 0:
        return "the cloud holds no point"
    if ledger.counts["out_of_range"] == 0:
        return f"none of {cloud.size} points is finite"
    z = cloud.xyz[..., 2]
    z = z[np.isfinite(z)]
    return (
        f"no point between {config.min_range_m:g} and {config.max_range_m:g} m: "
        f"depths are {z.min():g} to {z.max():g}; is the cloud in metres and in the optical frame?"
    )


def _why_no_object(ledger: _Ledger, config: ClusterConfig) -> str:
    rejected = ledger.counts.get("n_rejected", 0)
    if rejected == 0:
        return f"nothing stands more than {config.min_height_m * 1e3:g} mm above the table"
    return (
        f"{rejected} clusters stand out, none with {config.min_points} points, "
        f"higher than {config.min_top_m * 1e3:g} mm and within {config.max_extent_m:g} m"
    )
