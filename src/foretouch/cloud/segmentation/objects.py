# SPDX-License-Identifier: Apache-2.0
"""The objects on the table, from their clusters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.clusters import ClusterConfig, Clusters
from foretouch.types import Cloud, Float64, Plane

__all__ = ["GatheredObjects", "ObjectSegment", "gather_objects"]

Int32 = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class ObjectSegment:
    """One object.

    Attributes:
        id: 1 for the one whose centroid is nearest to the camera, and so on; its label in `Segmentation.labels`.
        cloud: Its points, unorganised, all finite, in the order of the input.
        pixels: (n,) int64, rows of `cloud` as flat indices into the input cloud, ascending.
        centroid: (3,) float64, mean of the points [m].
        bounds: (2, 3) float64, smallest and largest x, y, z [m].
    """

    id: int
    cloud: Cloud
    pixels: npt.NDArray[np.int64]
    centroid: Float64
    bounds: Float64

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.pixels)

    @property
    def distance_m(self) -> float:
        """From the camera to the centroid [m]."""
        return float(np.linalg.norm(self.centroid))


class GatheredObjects(NamedTuple):
    """Objects, nearest first, and the points by what became of them: objects, rejected, n_rejected, flying."""

    objects: tuple[ObjectSegment, ...]
    counts: dict[str, int]


class _Candidate(NamedTuple):
    """A cluster on its way to an object; the order of the fields is that of the objects."""

    distance_m: float
    window: int
    cluster: int
    segment: ObjectSegment


def gather_objects(
    cloud: Cloud, windows: Sequence[Clusters], plane: Plane, config: ClusterConfig, labels: Int32
) -> GatheredObjects:
    """Clusters of a sensible size as objects.

    Args:
        cloud: The whole cloud.
        windows: Of it, labelled.
        plane: The table.
        config: What is too small or too large.
        labels: (H, W) or (N,) int32, zeros; the ids are written into it.

    Returns:
        Objects in order of the distance of their centroid from the camera, ties by place in the image, and counts.
    """
    # Once, not for each window: where rows are padded this is a copy.
    rgb = None if cloud.rgb is None else cloud.rgb.reshape(-1, 3)
    flat = Cloud(cloud.xyz.reshape(-1, 3), rgb, cloud.frame_id, cloud.stamp_ns)
    found: list[_Candidate] = []
    rejected = []
    for index, window in enumerate(windows):
        for cluster, segment in _segments(flat, window, labels.shape):
            if _plausible(segment, plane, config):
                found.append(_Candidate(segment.distance_m, index, cluster, segment))
            else:
                rejected.append(segment.n_points)
    found.sort(key=lambda candidate: candidate[:3])
    objects = tuple(replace(candidate.segment, id=number) for number, candidate in enumerate(found, 1))
    labelled = 0
    for index, window in enumerate(windows):
        ids = np.zeros(window.n_labels + 1, np.int32)
        for number, candidate in enumerate(found, 1):
            if candidate.window == index:
                ids[candidate.cluster] = number
        placed = ids.take(window.labels)
        labelled += int(np.count_nonzero(placed))
        np.copyto(_part(labels, window), placed, where=placed > 0)
    used = sum(segment.n_points for segment in objects)
    counts = {"objects": used, "rejected": sum(rejected), "n_rejected": len(rejected), "flying": labelled - used}
    return GatheredObjects(objects, counts)


def _segments(flat: Cloud, window: Clusters, shape: tuple[int, ...]) -> Iterator[tuple[int, ObjectSegment]]:
    """The clusters of a window that hold solid points, by number."""
    pixels, ends = _members(window, shape)
    points = flat.take(pixels)
    start = 0
    for cluster, end in enumerate(ends.tolist()):
        if end > start:
            yield cluster, _object(points, pixels, slice(start, end))
        start = end


def _object(points: Cloud, pixels: npt.NDArray[np.int64], span: slice) -> ObjectSegment:
    """The rows of one cluster, not yet numbered."""
    xyz = points.xyz[span]
    columns = xyz.T.astype(np.float64, order="C")  # reductions along rows of three are slow
    bounds = np.stack([columns.min(axis=1), columns.max(axis=1)])
    centroid = columns.mean(axis=1)
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
    order = np.argsort(owner.astype(np.min_scalar_type(clusters.n_labels)), kind="stable")  # 8 or 16 bits: a radix sort
    flat = place[order].astype(np.int64, copy=False)
    if len(shape) == 2:
        width = clusters.labels.shape[1]
        flat += (flat // width) * (shape[1] - width) + clusters.rows * shape[1] + clusters.columns
    return flat, np.cumsum(np.bincount(owner, minlength=clusters.n_labels + 1))
