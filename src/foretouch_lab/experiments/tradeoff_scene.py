# SPDX-License-Identifier: Apache-2.0
"""Area `scene`: objects found, and their masks, against the time of segmentation on a depth image.

Four objects touch each other on each image, which has the faults of a depth camera (`shared.touched_scenes`). Beside
foretouch stands what others offer, where it is installed: Open3D's plane by RANSAC, with clusters of the points above it, and
PCL's LCCP, which splits foretouch's clusters by local convexity.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from itertools import cycle
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from foretouch.camera.device import ensure_libusb
from foretouch.types import Cloud, Int32
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.tradeoff import Panel, Timed, Variant, make_area
from foretouch_lab.experiments.peers import has_lccp, lccp
from foretouch_lab.experiments.shared.touched_scenes import (
    FOUND,
    HARD,
    TIMED,
    SceneSettings,
    TouchedScenes,
    drawn_rows,
    share,
)

_OPEN3D: Final = "Open3D: plane and clusters"
_LCCP: Final = "our clusters, PCL: LCCP"
_CLUSTERS: Final = {"segmentation.split.angle_deg": 180.0}  # alone: they are not split
_VOXEL_M: Final = 0.004  # to which Open3D thins the points; neighbours are within two of them
_ABOVE_M: Final = 0.008  # the plane


def _variants() -> Iterator[Variant]:
    yield Variant("default", "shipped")
    others: tuple[tuple[str, Mapping[str, float]], ...] = (
        *(("grid", {"grid_rows": rows}) for rows in (60, 80, 240, 480)),  # the last one: every pixel
        *(("height", {"clusters.min_height_m": height}) for height in (0.002, 0.006)),
        ("gap", {"clusters.gap_m": 0.016}),
        *(("split", {"split.angle_deg": angle}) for angle in (30.0, 180.0)),  # the last one: clusters alone
        ("grid x split", {"grid_rows": 60, "split.angle_deg": 180.0}),
    )
    for factor, changes in others:
        name = ", ".join(f"{key.rpartition('.')[2].replace('_', ' ')} {value:g}" for key, value in changes.items())
        yield Variant(name, factor, {f"segmentation.{key}": value for key, value in changes.items()})
    if find_spec("open3d"):
        yield Variant(_OPEN3D, "reference")
    if has_lccp():
        yield Variant(_LCCP, "reference", _CLUSTERS)


VARIANTS: Final = tuple(_variants())


def open3d_labels(cloud: Cloud) -> Int32:
    """Return (H, W) labels of an organised cloud by Open3D, objects from 1 on, 0 where there is none."""
    ensure_libusb()
    import open3d as o3d

    o3d.utility.random.seed(0)
    xyz = cloud.xyz.reshape(-1, 3)
    seen = np.flatnonzero(np.isfinite(xyz[:, 2]))
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz[seen].astype(np.float64)))
    thinned = points.voxel_down_sample(_VOXEL_M)
    plane, _ = thinned.segment_plane(_ABOVE_M, 3, 200)
    normal, offset = np.array(plane[:3]), plane[3]
    normal, offset = (normal, offset) if offset > 0.0 else (-normal, -offset)  # towards the camera

    def above(some: np.ndarray) -> np.ndarray:
        return np.flatnonzero(some @ normal + offset > _ABOVE_M)

    some = np.asarray(thinned.points)
    parts = thinned.select_by_index(above(some).tolist())
    clusters = np.asarray(parts.cluster_dbscan(2.0 * _VOXEL_M, 5), np.int32)
    labels = np.zeros(len(xyz), np.int32)
    if len(clusters):
        seen = seen[above(xyz[seen].astype(np.float64))]
        labels[seen] = 1 + clusters[cKDTree(np.asarray(parts.points)).query(xyz[seen])[1]]
    return labels.reshape(cloud.shape)


def _labels(variant: Variant, data: TouchedScenes) -> Callable[[Cloud], Int32]:
    """Return what labels the objects of a cloud."""
    if variant.name == _OPEN3D:
        return open3d_labels
    pipeline = data.pipeline(variant.values)
    if variant.name == _LCCP:
        return lambda cloud: lccp(cloud, pipeline.segment(cloud).labels)
    return lambda cloud: pipeline.segment(cloud).labels


def _accuracy(skill: str, settings: SceneSettings, data: TouchedScenes) -> Mapping[str, Row]:
    sums = {}
    for variant in VARIANTS:
        label = _labels(variant, data)
        shares = [np.array(data.overlaps(k, label(data.cloud(k)))) for k in range(len(data))]
        values = [own >= FOUND if skill == "found" else own for own in shares]
        sums[variant.name] = np.array([(own.sum(), len(own)) for own in values], np.float64)
    return drawn_rows(skill, sums, share, settings.bootstrap)


def _timed(variant: Variant, _settings: SceneSettings, data: TouchedScenes) -> Timed:
    """Return what segments depth images, one after the other."""
    label = _labels(variant, data)
    turn = cycle([partial(data.cloud, k) for k in range(min(TIMED, len(data)))])
    return lambda _: label(next(turn)()), 1.0


EXPERIMENT = make_area(
    _accuracy,
    name="tradeoff_scene",
    question="How many objects can be found in a few milliseconds?",
    module=__name__,
    settings=SceneSettings,
    presets={
        "smoke": {"scenes": 2, "timing_s": 1.0},
        "small": {"scenes": 100, "timing_s": 30.0},
        "full": {"timing_s": 120.0},
    },
    prepare=lambda _settings, _source, out: out,  # scenes are generated
    load=lambda settings, _path: TouchedScenes.render(settings.scenes, HARD),
    variants=VARIANTS,
    timed=_timed,
    panels=(
        Panel("found", 1, "Objects that touch, 640x480: found (IoU 0.6 or more)", "share found, 95 % interval"),
        Panel("iou", 1, "Objects that touch, 640x480: masks", "mean IoU of the objects, 95 % interval"),
    ),
)
