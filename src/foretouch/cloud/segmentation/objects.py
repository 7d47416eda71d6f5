# SPDX-License-Identifier: Apache-2.0
"""The objects on the table: extracted from the clusters, and the selection of those that get grasps."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.clusters import ClusterConfig, Clusters, Int32
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.types import Cloud, Float64, Plane

TargetMode = Literal["nearest", "largest", "point", "all"]


@dataclass(frozen=True, eq=False)
class ObjectSegment:
    """One object."""

    id: int  # 1 for the object whose centroid is nearest to the camera, and so on; its label in `Segmentation.labels`
    cloud: Cloud  # its points, unorganised, all finite, in the order of the input
    pixels: npt.NDArray[np.int64]  # (n,) int64, rows of `cloud` as flat indices into the input cloud, ascending
    centroid: Float64  # (3,) float64, mean of the points [m]
    bounds: Float64  # (2, 3) float64, smallest and largest x, y, z [m]

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.pixels)

    @property
    def distance_m(self) -> float:
        """Distance of the centroid from the camera [m]."""
        return float(np.linalg.norm(self.centroid))


class _Candidate(NamedTuple):
    """A cluster that may become an object; objects are sorted by the fields in this order."""

    distance_m: float
    window: int
    cluster: int
    segment: ObjectSegment


def extract_objects(
    cloud: Cloud, windows: Sequence[Clusters], plane: Plane, config: ClusterConfig, labels: Int32
) -> tuple[tuple[ObjectSegment, ...], dict[str, int]]:
    """Extract the clusters of a plausible size as objects.

    Args:
        cloud: The whole cloud.
        windows: Its labelled windows.
        plane: The table.
        config: Limits of the size.
        labels: (H, W) or (N,) int32, zeros; the ids are written into it.

    Returns:
        Objects in order of the distance of their centroid from the camera, ties by position in the image; and the
        counts `objects`, `rejected` and `flying` of points and `n_rejected` of clusters.
    """
    # Once, not for each window: if rows are padded this is a copy.
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
        window_ids = ids.take(window.labels)
        labelled += int(np.count_nonzero(window_ids))
        np.copyto(_part(labels, window), window_ids, where=window_ids > 0)
    used = sum(segment.n_points for segment in objects)
    counts = {"objects": used, "rejected": sum(rejected), "n_rejected": len(rejected), "flying": labelled - used}
    return objects, counts


def _segments(flat: Cloud, window: Clusters, shape: tuple[int, ...]) -> Iterator[tuple[int, ObjectSegment]]:
    """The clusters of a window with solid points, by label, as segments without an id."""
    pixels, ends = _members(window, shape)
    points = flat.take(pixels)
    start = 0
    for cluster, end in enumerate(ends.tolist()):
        if end > start:
            xyz = points.xyz[start:end]
            columns = xyz.T.astype(np.float64, order="C")  # reductions along rows of three are slow
            bounds = np.stack([columns.min(axis=1), columns.max(axis=1)])
            rgb = None if points.rgb is None else points.rgb[start:end]
            part = Cloud(xyz, rgb, points.frame_id, points.stamp_ns)
            yield cluster, ObjectSegment(0, part, pixels[start:end], columns.mean(axis=1), bounds)
        start = end


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
        (n,) int64 flat indices into the cloud, by cluster, ascending within; and the end of each label in them.
    """
    index = np.flatnonzero(clusters.solid)
    owner = clusters.labels.reshape(-1)[index]
    order = np.argsort(owner.astype(np.min_scalar_type(clusters.n_labels)), kind="stable")  # 8 or 16 bits: a radix sort
    flat = index[order].astype(np.int64, copy=False)
    if len(shape) == 2:
        width = clusters.labels.shape[1]
        flat += (flat // width) * (shape[1] - width) + clusters.rows * shape[1] + clusters.columns
    return flat, np.cumsum(np.bincount(owner, minlength=clusters.n_labels + 1))


@dataclass(frozen=True, kw_only=True)
class TargetConfig(Settings):
    """Which objects get grasps."""

    mode: TargetMode = setting(
        "nearest", "nearest to the camera, largest in points, the one at a point, or all", choices=get_args(TargetMode)
    )
    point: tuple[float, ...] = setting((), "x, y, z for mode point, in the cloud's frame", unit="m")
    tolerance_m: float = setting(
        0.03, "Maximum distance of the object's nearest point from the point", minimum=0.0, maximum=1.0, unit="m"
    )
    margin_m: float = setting(
        0.005, "Two objects whose distances differ less are ambiguous", minimum=0.0, maximum=1.0, unit="m"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.point) not in (0, 3):
            raise ConfigError(f"TargetConfig.point: {len(self.point)} numbers are not x, y, z")
        if self.mode == "point" and not self.point:
            raise ConfigError("TargetConfig.point: is empty, mode point needs x, y, z")


def select_targets(objects: Sequence[ObjectSegment], config: TargetConfig) -> tuple[list[ObjectSegment], str]:
    """Select the objects that get grasps.

    Args:
        objects: In order of id.
        config: The rule.

    Returns:
        The selected objects and "", or none and the reason: there is no object, none is at the point, or two are
        within `margin_m` (mode `largest`: within 5 % of the points) of each other, so that noise would decide.
    """
    if not objects:
        return [], "there is no object"
    if config.mode == "all":
        return list(objects), ""
    if config.mode == "largest":
        return _largest(objects)
    if config.mode == "nearest":
        return _nearest(objects, [obj.distance_m for obj in objects], config.margin_m, "the camera")
    point = np.asarray(config.point)
    distances = [float(np.sqrt(((obj.cloud.xyz.astype(np.float64) - point) ** 2).sum(axis=1).min())) for obj in objects]
    at = f"({', '.join(f'{p:g}' for p in config.point)})"
    nearest = min(distances)
    if nearest > config.tolerance_m:
        return [], f"no object within {config.tolerance_m:g} m of the point {at}: the nearest is {nearest:.3f} m away"
    return _nearest(objects, distances, config.margin_m, f"the point {at}")


def _nearest(
    objects: Sequence[ObjectSegment], distances: Sequence[float], margin: float, where: str
) -> tuple[list[ObjectSegment], str]:
    order = sorted(range(len(objects)), key=lambda i: distances[i])
    if len(order) > 1 and distances[order[1]] - distances[order[0]] < margin:
        a, b = sorted(order[:2])
        pair = f"objects {objects[a].id} and {objects[b].id}"
        return [], f"{pair} are equally near to {where}, {distances[a]:.3f} and {distances[b]:.3f} m"
    return [objects[order[0]]], ""


def _largest(objects: Sequence[ObjectSegment]) -> tuple[list[ObjectSegment], str]:
    first, *rest = sorted(objects, key=lambda obj: -obj.n_points)
    if rest and rest[0].n_points > 0.95 * first.n_points:
        return [], (
            f"objects {first.id} and {rest[0].id} are equally large, {first.n_points} and {rest[0].n_points} points"
        )
    return [first], ""
