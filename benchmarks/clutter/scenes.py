# SPDX-License-Identifier: Apache-2.0
"""Labelled scenes: those of the Object Segmentation Database, whole images that others took, and our piles.

A file of either holds a cloud and the object of each pixel. The database has `depth_100um` (H, W) uint16 and `K` (f, fy, cx,
cy), or `xyz` (H, W, 3) [m], and `label` with object × 10 + part, 0 to 9 the background. Piles have `xyz`, `labels` (H, W)
int32 with 1 and up for objects, and `kind`. Whole images have `depth_mm` (H, W) uint16, `K` (fx, fy, cx, cy), and `label` with
1 and up for objects, negative where nothing is scored.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.cloud.io.files import read_cloud
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.types import AnyArray, Cloud, Float32, Float64, Int32, Int64

# The database lists its scenes by kind: the first number of each, of the scenes for learning and for testing.
_KINDS: Final = {
    "learn": ((0, "boxes"), (17, "stacked"), (25, "occluded"), (35, "cylinders")),
    "test": ((0, "boxes"), (16, "stacked"), (25, "occluded"), (35, "cylinders"), (43, "mixed"), (55, "complex")),
}
_BACKGROUND: Final = 10  # labels below are no object
_FOCAL_PX: Final = 616.3335  # of the camera that recorded the grasps: its points are equally spaced by 1 / 616.3335
_BELOW_M: Final = 0.01  # from the farthest point of a recorded object to the table that is put behind it


@dataclass(frozen=True, eq=False)
class LabelledCloud:
    """An organised cloud with its truth."""

    name: str  # of the file
    kind: str  # of scene
    cloud: Cloud  # organised
    labels: Int32  # (H, W) int32, 1 and up for objects, 0 for everything else, negative where nothing is scored


def load_scenes(folder: Path) -> Iterator[LabelledCloud]:
    """All scenes of a folder of .npz files, by name and number."""
    for path in sorted(folder.glob("*.npz"), key=lambda path: _numbered(path.stem)):
        with np.load(path) as arrays:
            fields = {name: arrays[name] for name in arrays}
        if "xyz" in fields:
            xyz = fields["xyz"]
        elif "depth_mm" in fields:
            xyz = _points(fields["depth_mm"] * 1e-3, fields["K"])
        else:
            xyz = _points(fields["depth_100um"] * 1e-4, fields["K"])
        if "labels" in fields or "depth_mm" in fields:
            labels = fields["labels" if "labels" in fields else "label"].astype(np.int32)
        else:
            whole = fields["label"].astype(np.int32)
            labels = np.where(whole < _BACKGROUND, 0, whole // 10)
        kind = str(fields["kind"]) if "kind" in fields else _kind(path.stem)
        yield LabelledCloud(path.stem, kind, Cloud(np.ascontiguousarray(xyz, np.float32)), labels)


def _points(depth_m: AnyArray, lens: AnyArray) -> Float32:
    f, fy, cx, cy = lens
    z = np.where(depth_m > 0, depth_m, np.nan)
    v, u = np.indices(z.shape)
    return np.stack([(u - cx) * z / f, (v - cy) * z / fy, z], axis=-1).astype(np.float32)


def _numbered(stem: str) -> tuple[str, int]:
    name = stem.rstrip("0123456789")
    return name, int(stem[len(name) :] or 0)


def _kind(stem: str) -> str:
    name, number = _numbered(stem)
    kinds = [kind for first, kind in _KINDS.get(name, ()) if first <= number]
    return kinds[-1] if kinds else stem.split("_", maxsplit=1)[0]


def real_sources(data: Path) -> dict[str, list[LabelledCloud]]:
    """Images of real cameras that people labelled, by their source: whole images by the first word of their names, and the database as `osd`."""
    sources: dict[str, list[LabelledCloud]] = {}
    for folder in ("real_scenes", "osd"):
        for scene in load_scenes(data / folder):
            name = folder if folder == "osd" else scene.name.split("_", maxsplit=1)[0]
            sources.setdefault(name, []).append(scene)
    return sources


def recorded_objects(folder: Path) -> Iterator[LabelledCloud]:
    """The segmented objects of recorded grasps (`<object>/<time>/cloud-object.pcd`), put back into the image they came from.

    Their points lie on the rays of an image of 640x480 pixels. All other pixels show a table below the object.
    """
    for path in sorted(folder.glob("*/*/cloud-object.pcd")):
        points = read_cloud(path).xyz.astype(np.float64)
        points = points[np.isfinite(points).all(axis=1)]
        u, v = (_pixels(points[:, k] / points[:, 2], centre) for k, centre in ((0, 320.0), (1, 240.0)))
        rays = np.stack(
            [*(np.indices((480, 640))[::-1] - np.array([320.0, 240.0])[:, None, None]), np.full((480, 640), _FOCAL_PX)]
        )
        xyz = np.moveaxis(rays / _FOCAL_PX * (points[:, 2].max() + _BELOW_M), 0, -1)
        xyz[v, u] = points
        labels = np.zeros((480, 640), np.int32)
        labels[v, u] = 1
        yield LabelledCloud("/".join(path.parts[-3:-1]), path.parts[-3], Cloud(xyz.astype(np.float32)), labels)


def _pixels(slope: Float64, centre: float) -> Int64:
    """Columns or rows of points by their slope from the optical axis: the centre's fraction of a pixel fits them all."""
    fraction = np.angle(np.exp(2j * np.pi * slope * _FOCAL_PX).mean()) / (2.0 * np.pi)
    pixels: Int64 = np.rint(slope * _FOCAL_PX - fraction + centre).astype(np.int64)
    return pixels


def segment_anew(cloud: Cloud, config: SegmentationConfig | None) -> None:
    """Segment a new copy of a cloud, as from a camera."""
    segment(replace(cloud, xyz=cloud.xyz.copy()), config)
