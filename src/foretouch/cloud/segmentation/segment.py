# SPDX-License-Identifier: Apache-2.0
"""Segment a depth cloud into the table and the objects on it.

Crop by depth, fit the dominant plane, keep the points above it, and cluster them. An organised cloud is
processed as an image, which is many times faster than a search for neighbours; an unorganised one in voxels.
Every result has a status and a reason, and every point is counted: received = used + dropped(reason).
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from foretouch.cloud.geometry.columns import median, spread
from foretouch.cloud.geometry.frames import TANGENT, not_optical
from foretouch.cloud.geometry.pixel_grid import listed_image
from foretouch.cloud.segmentation.background import REASONS, find_background
from foretouch.cloud.segmentation.clusters import (
    LOCAL_FACTOR,
    NOISE_FACTOR,
    ClusterConfig,
    CoarseGrid,
    CropConfig,
    HeightThreshold,
    WritePoints,
    in_range,
    label_organised,
    label_unorganised,
    local_noise,
    pixel_pitch,
)
from foretouch.cloud.segmentation.objects import extract_objects
from foretouch.cloud.segmentation.parts import SPLIT_COUNTS, SplitConfig, split_clusters, split_list
from foretouch.cloud.segmentation.plane import PlaneConfig
from foretouch.cloud.segmentation.rays import RayFilter, finite_rows, out_of_view, view_fault
from foretouch.cloud.segmentation.table import find_table
from foretouch.cloud.timing import timed
from foretouch.config import Settings, setting
from foretouch.kernels import Kernel
from foretouch.types import Cloud, Float32, Float64, Index, Int32, Plane
from foretouch.types.camera import DepthImage
from foretouch.types.cloud import DepthCloud
from foretouch.types.scene import Object, Scene

SegmentationStatus = Literal[
    "ok", "empty_cloud", "bad_cloud", "too_few_points", "unknown_frame", "no_plane", "doubtful_plane", "no_object"
]

_count_range = Kernel("count_range")
_coarse_grid = Kernel("coarse_grid")

_MIN_POINTS = 100  # in range
_PLANE_POINTS = 2048  # sampled to fit the plane
_HIGHEST_M = 0.6  # above the table: no object reaches it
_LARGEST_LIST = 4_000_000  # points: two images of 1920x1080
_CONNECTED = 0.8  # of the points of a list have another one in the next pixel, where it is processed as an image
_DROPPED = (
    "not_finite",
    "out_of_range",
    "off_ray",
    "rejected",
    "flying",
    "objects",
)  # reasons why a point is no background
_SPARSE = 4000  # with fewer points on the coarse grid every pixel is used


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig(Settings):
    """Settings of each segmentation step."""

    crop: CropConfig = CropConfig()
    plane: PlaneConfig = PlaneConfig()
    clusters: ClusterConfig = ClusterConfig()
    split: SplitConfig = SplitConfig()
    grid_rows: int = setting(
        120,
        "Rows of the coarse grid on which objects are found: of 480 rows each fourth; fewer are faster, outlines suffer",
        bounds=(30, 10_000),
    )


def segment(cloud: Cloud, config: SegmentationConfig | None = None) -> Scene:
    """Segment a cloud into the table and the objects on it.

    Args:
        cloud: Camera optical frame [m], organised or not; points without depth are counted and ignored.
        config: Settings; the defaults if None. The same input gives bit-equal results.

    Returns:
        The scene, without targets; unusable points are reported in its status, not raised.
    """
    config = SegmentationConfig() if config is None else config
    reasons = (f"n_{reason}" for reason in ("background", *REASONS[1:]))
    names = ("received", *_DROPPED[:3], "background", "rejected", "n_rejected", *_DROPPED[4:], *reasons, *SPLIT_COUNTS)
    counts = dict.fromkeys(names, 0)
    ms: dict[str, float] = {}
    with timed(ms, "total"):
        contiguous = cloud if _image_of(cloud) else replace(cloud, xyz=np.ascontiguousarray(cloud.xyz))
        status, reason, plane, objects, background, outline, labels = _of_imagelist(contiguous, config, counts, ms)
        if status != "ok" and cloud.camera is None and (frame := not_optical(cloud.xyz)):
            status, reason = "unknown_frame", frame
    counts["received"] = cloud.size
    counts["background"] = cloud.size - sum(counts[name] for name in _DROPPED)
    return Scene(status, reason, cloud, plane, objects, background, outline, labels, counts, ms)


_Objects = tuple[Object, ...]
_Result = tuple[SegmentationStatus, str, Plane | None, _Objects, _Objects, Float64, Int32]


def _of_imagelist(cloud: Cloud, config: SegmentationConfig, counts: dict[str, int], ms: dict[str, float]) -> _Result:
    """Segment a cloud; a list of the points of an image, in any order, is processed as that image."""
    if cloud.organised or cloud.size > _LARGEST_LIST:
        return _segment(cloud, config, counts, ms)
    image = listed_image(cloud.xyz, config.crop.min_range_m, config.crop.max_range_m, TANGENT)
    # Of a thinned image clusters would fall apart.
    if image is None or image.connected < _CONNECTED * image.n_points or min(image.xyz.shape[:2]) < 2:
        return _segment(cloud, config, counts, ms)
    status, reason, plane, objects, background, outline, image_labels = _segment(Cloud(image.xyz), config, counts, ms)
    finite, usable = _count_depths(cloud.xyz, config.crop)
    counts |= {"not_finite": cloud.size - finite, "out_of_range": finite - usable}
    labels = np.zeros(cloud.size, np.int32)
    labelled = np.flatnonzero(image_labels)
    labels[image.place[labelled]] = image_labels.reshape(-1)[labelled]
    listed, others = (
        tuple(_listed(of_image, cloud, image.place) for of_image in some) for some in (objects, background)
    )
    return status, reason, plane, listed, others, outline, labels


def _listed(of_image: Object, cloud: Cloud, place: Int32) -> Object:
    """Return an object of an image as one of the list of its points, by the row of each pixel in that list."""
    pixels = np.sort(place[of_image.pixels]).astype(np.int64)
    rgb = None if cloud.rgb is None else cloud.rgb[pixels]
    return replace(
        of_image, cloud=Cloud(cloud.xyz[pixels], rgb, cloud.frame_id, cloud.stamp_ns), pixels=pixels, image_shape=None
    )


def _segment(cloud: Cloud, config: SegmentationConfig, counts: dict[str, int], ms: dict[str, float]) -> _Result:
    source = _image_of(cloud) or cloud.xyz
    labels, nothing = (
        np.zeros(source.shape[:2] if cloud.organised else cloud.size, np.int32),
        ((), (), np.empty((0, 3))),
    )
    with timed(ms, "crop"):
        finite, usable = _count_depths(source, config.crop)
        counts |= {"not_finite": cloud.size - finite, "out_of_range": finite - usable}
    if usable == 0:
        return "empty_cloud", _why_empty(cloud.xyz[..., 2], config.crop), None, *nothing, labels
    if usable < _MIN_POINTS:
        return "too_few_points", f"{usable} points in range, fewer than {_MIN_POINTS}", None, *nothing, labels
    with timed(ms, "plane"):
        image = cloud.organised and min(labels.shape) > 1  # whose pixels determine rays; a single row is a list
        if not image:
            source, counts["off_ray"] = _in_view(cloud.xyz, config)
        coarse, stride, index = _coarse(source, config.crop, config.grid_rows)
        xyz, write = _writable(source, coarse, stride)
        if len(index) > _PLANE_POINTS:  # evenly distributed
            index = index[spread(len(index), _PLANE_POINTS)]
        sample: Float32 = coarse.reshape(-1, 3).take(index, axis=0)
        rays, fault = None, ""
        if image and cloud.camera is None:  # else each point is on its ray
            rays = _rays(sample, index, coarse.shape[1], stride, labels.shape[1])
            sample, fault = sample[~rays.off_sample], rays.reason
            counts["off_ray"] = rays.count_dropped(xyz)
        elif not image:
            fault = view_fault(counts["off_ray"], usable)
        if fault:
            return "bad_cloud", fault, None, *nothing, labels
        plane, noise_per_m, reason = find_table(sample[finite_rows(sample)], config.plane, one_view=image)
    if plane is None:
        return "no_plane", reason, None, *nothing, labels
    if reason:
        return "doubtful_plane", reason, plane, *nothing, labels
    with timed(ms, "clusters"):
        limits, found = config.clusters, None
        threshold = _threshold(plane, noise_per_m, sample, config)
        if cloud.organised:
            grid = CoarseGrid(coarse, stride, pixel_pitch(coarse))
            threshold = threshold._replace(local_per_m=local_noise(grid, config.crop))
            windows = label_organised(xyz, grid, config.crop, threshold, limits, rays, write)
            windows, parts = split_clusters(xyz, windows, threshold, grid.pitch / stride, config.split, write)
            hidden = config.plane.table == "given" and noise_per_m == 0.0  # by a pile: the table has no outline
            found = find_background(grid, windows, threshold, hidden=hidden)
        else:
            windows = label_unorganised(xyz, config.crop, threshold)
            windows, parts = split_list(xyz, windows, threshold, config.split)
        counts |= parts
        if rays is not None:
            counts["off_ray"] = rays.count_dropped(xyz)
    with timed(ms, "objects"):
        made = Cloud(xyz, cloud.rgb, cloud.frame_id, cloud.stamp_ns) if isinstance(source, DepthImage) else cloud
        objects, background, numbers = extract_objects(made, windows, threshold, limits, labels, found)
        counts |= numbers
    reason = "" if objects else _why_no_object(counts["n_rejected"], counts["n_background"], limits)
    return (
        "ok" if objects else "no_object",
        reason,
        plane,
        objects,
        background,
        np.empty((0, 3)) if found is None else found.outline,
        labels,
    )


def _threshold(plane: Plane, noise_per_m: float, sample: Float32, config: SegmentationConfig) -> HeightThreshold:
    """Return the height threshold above a table with its noise, from points of the cloud (N, 3)."""
    on = sample[:, 2][np.abs(plane.height(sample)) < config.plane.threshold_m]
    depth_m = median(on if len(on) else sample[finite_rows(sample)][:, 2])
    least_m, least_per_m = config.clusters.min_height_m, NOISE_FACTOR * noise_per_m
    local_per_m = least_per_m / LOCAL_FACTOR  # where no windows are measured, as in a list
    return HeightThreshold(plane, least_m, least_per_m, _HIGHEST_M, depth_m, local_per_m)


def _image_of(cloud: Cloud) -> DepthImage | None:
    """Return the depth image whose points are made where they are read; None for a cloud of points."""
    return cloud.image if isinstance(cloud, DepthCloud) else None


def _rays(sample: Float32, index: Index, across: int, stride: int, width: int) -> RayFilter:
    """Return the rays of an image, from points of a coarse one by their flat indices in it."""
    rows, columns = (stride * position for position in np.divmod(index, across))
    rays = RayFilter(sample, rows, columns)
    if rays.off_sample.any():
        rays.dropped.append((rows * width + columns)[rays.off_sample])
    return rays


def _count_depths(source: Float32 | DepthImage, config: CropConfig) -> tuple[int, int]:
    """Count the points with a finite depth, and those in range, of a depth image, or of (N, 3) or (H, W, 3) float32 contiguous points [m].

    Only z is checked: a pixel without depth has no z.
    """
    if isinstance(source, DepthImage):
        return source.count(config.min_range_m, config.max_range_m)
    counts = np.empty(2, np.int64)
    _count_range(source, source.size // 3, config.min_range_m, config.max_range_m, counts)
    return int(counts[0]), int(counts[1])


def _coarse(source: Float32 | DepthImage, config: CropConfig, grid_rows: int) -> tuple[Float32, int, Index]:
    """Return every k-th pixel of an image, so that about `grid_rows` rows are left, unless few of them are in range.

    Returns:
        The coarse image, its stride, and the flat indices of its points in range.
    """
    is_image = isinstance(source, DepthImage) or source.ndim == 3
    stride = int(min(max(min(source.shape[:2]) // grid_rows, 1), 8)) if is_image else 1
    if stride > 1:
        coarse, index = _every(source, stride, config)
        if len(index) >= _SPARSE:
            return coarse, stride, index
    xyz = source.points() if isinstance(source, DepthImage) else source
    return xyz, 1, np.flatnonzero(in_range(xyz[..., 2], config))


def _every(source: Float32 | DepthImage, stride: int, config: CropConfig) -> tuple[Float32, Index]:
    """Return every n-th row and column of an image, and the flat indices of the points in range."""
    xyz, step = (source.points(stride), 1) if isinstance(source, DepthImage) else (source, stride)
    coarse = np.empty((-(-xyz.shape[0] // step), -(-xyz.shape[1] // step), 3), np.float32)
    index, count = np.empty(coarse.size // 3, np.int64), np.empty(1, np.int64)
    _coarse_grid(xyz, *xyz.shape[:2], step, config.min_range_m, config.max_range_m, coarse, index, count)
    return coarse, index[: count[0]]


def _writable(source: Float32 | DepthImage, coarse: Float32, stride: int) -> tuple[Float32, WritePoints | None]:
    """Return all points, and what writes a part of them where it is read, for a depth image whose coarse points suffice elsewhere."""
    if not isinstance(source, DepthImage):
        return source, None
    if stride == 1:
        return coarse, None
    xyz = np.empty((*source.shape, 3), np.float32)
    return xyz, partial(source.write_points, xyz)


def _in_view(xyz: Float32, config: SegmentationConfig) -> tuple[Float32, int]:
    """Return the cloud with points out of view as points without depth, and their number among those in range."""
    flat = xyz.reshape(-1, 3)
    off = out_of_view(flat)
    if not off.any():
        return xyz, 0
    off &= in_range(flat[:, 2], config.crop)
    seen = flat.copy()
    seen[off] = np.nan
    return seen.reshape(xyz.shape), int(np.count_nonzero(finite_rows(flat[off])))


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


def _why_no_object(rejected: int, background: int, config: ClusterConfig) -> str:
    if background:
        return f"{background} clusters are background, {rejected} have no plausible size: nothing stands within the table's outline"
    if rejected == 0:
        return f"nothing stands more than {config.min_height_m * 1e3:g} mm above the table"
    return (
        f"{rejected} clusters above the table, none with {config.min_points} points, "
        f"higher than {config.min_top_m * 1e3:g} mm and within {config.max_extent_m:g} m"
    )
