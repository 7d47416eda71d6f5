# SPDX-License-Identifier: Apache-2.0
"""Objects by a mask: the labels of somebody else's segmentation, such as of a network, on the table that is found here.

The table is found in the image without the masked pixels. What the depth refutes is taken out of each label and counted:
pixels on the table, and pixels behind or before the object.
"""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.clusters import NOISE_FACTOR, in_range
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.errors import CloudError
from foretouch.types import Bool, Cloud, Float32, Int32, Plane
from foretouch.types.scene import Object, Scene

_FEWEST: Final = 30  # points that are left of an object
_NEAR_M: Final = 0.02  # from the plane of the table: its noise, not an object
_GAP_M: Final = 0.03  # in depth, around what is not the object
_SHARE: Final = 0.1  # of the points; fewer are not the object
_LABELS: Final = 2**31  # an id is an int32
_NAMED: Final = 5  # labels in a reason


def segment_mask(cloud: Cloud, mask: npt.ArrayLike, config: SegmentationConfig) -> Scene:
    """Segment an image by the labels of a mask.

    Args:
        cloud: (H, W, 3), camera optical frame [m].
        mask: (H, W) integers or bool; 0 and negative numbers are no object.
        config: Settings of the table, and of what is above it.

    Returns:
        The table and an object for each label, whose id it is, nearest first. Labels without enough points above the
        table are left out: the reason names them and why, and `n_rejected` counts them. Counts of masked pixels, besides those
        of `segment`: `mask` = `mask_no_depth` + `mask_table` + `mask_apart` + `mask_rejected` + `objects`.

    Raises:
        CloudError: If the mask has another size than the image or no label, or its numbers are not whole.
    """
    labels = _checked(mask, cloud)
    masked = labels > 0
    rest = segment(replace(cloud, xyz=np.where(masked[..., None], np.float32(np.nan), cloud.xyz)), config)
    counts = rest.counts | dict.fromkeys(("mask_no_depth", "mask_table", "mask_apart", "mask_rejected"), 0)
    counts |= {"mask": int(np.count_nonzero(masked)), "n_rejected": 0, "objects": 0}
    empty = replace(rest, cloud=cloud, objects=(), labels=np.zeros_like(labels), counts=counts)
    if rest.table is None or rest.status == "doubtful_plane":
        return replace(empty, reason=f"{rest.reason} (in the image without the mask)")
    depth = in_range(cloud.xyz[..., 2], config.crop) & np.isfinite(cloud.xyz).all(axis=2)
    above = _above(cloud.xyz, depth & ~masked, rest.table, config.clusters.min_height_m)
    counts["mask_no_depth"] = int(np.count_nonzero(masked & ~depth))
    counts["mask_table"] = int(np.count_nonzero(masked & depth & ~above))
    objects, left_out = [], []
    flat, kept = labels.ravel(), np.flatnonzero((masked & depth & above).ravel())
    kept = kept[np.argsort(flat[kept], kind="stable")]
    ids, starts = np.unique(flat[kept], return_index=True)
    parts = dict(zip(ids.tolist(), np.split(kept, starts[1:]), strict=True)) if len(ids) else {}
    for label in np.unique(labels[masked]).tolist():
        pixels = parts.get(label, np.empty(0, np.intp))
        together = _together(cloud.xyz.reshape(-1, 3)[pixels])
        counts["mask_apart"] += len(pixels) - int(np.count_nonzero(together))
        pixels = np.sort(pixels[together])
        if len(pixels) < _FEWEST:
            counts["mask_rejected"] += len(pixels)
            left_out.append(f"label {label} has {len(pixels)} points above the table, fewer than {_FEWEST}")
            continue
        objects.append(Object.of(str(label), cloud.take(pixels), rest.table, pixels=pixels, image_shape=labels.shape))
        counts["objects"] += len(pixels)
    objects.sort(key=lambda piece: piece.distance_m)
    counts["n_rejected"] = len(left_out)
    ids_of_pixels = np.zeros(labels.size, np.int32)
    for object_ in objects:
        ids_of_pixels[object_.pixels] = int(object_.id)
    more = f" and {len(left_out) - _NAMED} more" if len(left_out) > _NAMED else ""
    reason = f"mask: {'; '.join(left_out[:_NAMED])}{more}" if left_out else ""
    return replace(
        empty,
        status="ok" if objects else "no_object",
        reason=reason,
        objects=tuple(objects),
        labels=ids_of_pixels.reshape(labels.shape),
    )


def _checked(mask: npt.ArrayLike, cloud: Cloud) -> Int32:
    """Return (H, W) int32 labels of a mask that fits the image."""
    try:
        labels = np.asarray(np.ma.filled(mask, 0))  # masked pixels are no object
    except ValueError as err:
        raise CloudError(f"mask: {err}") from err
    if not cloud.organised:
        raise CloudError(
            f"mask: the cloud is a list of {cloud.size} points; a mask needs an image, such as of Cloud.from_depth"
        )
    if labels.shape != cloud.shape:
        height, width = cloud.shape
        raise CloudError(f"mask: shape {labels.shape} is not ({height}, {width}), the rows and columns of the image")
    if labels.dtype.kind not in "biu":
        raise CloudError(
            f"mask: dtype {labels.dtype} is not of whole numbers or bool; threshold it, such as mask > 0.5"
        )
    if not (labels > 0).any():
        raise CloudError("mask: holds no label above 0")
    if int(labels.max()) >= _LABELS:
        raise CloudError(f"mask: label {labels.max()} is not below 2^31")
    return np.maximum(labels, 0).astype(np.int32) if labels.dtype.kind == "i" else labels.astype(np.int32)


def _above(xyz: Float32, of_table: Bool, plane: Plane, least_m: float) -> Bool:
    """Return (H, W) which points are above the table by more than a height and its noise, which grows with the square of the depth.

    The noise is the median distance from the plane of the unmasked points near it, as a standard deviation.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        height, square = plane.height(xyz), xyz[..., 2].astype(np.float64) ** 2
        near = np.abs(height[of_table]) < _NEAR_M
        noise_per_m = (
            1.4826 * float(np.median(np.abs(height[of_table][near]) / square[of_table][near])) if near.any() else 0.0
        )
        return np.asarray(height >= np.maximum(least_m, NOISE_FACTOR * noise_per_m * square), np.bool_)


def _together(points: Float32) -> Bool:
    """Return (N,) which of (N, 3) points belong to the object: groups in depth with a gap around them are another thing if they are few."""
    order = np.argsort(points[:, 2], kind="stable")
    group = np.zeros(len(points), np.intp)
    group[order] = np.cumsum(np.diff(points[order, 2], prepend=points[order[:1], 2]) > _GAP_M)
    return np.asarray(np.bincount(group)[group] >= _SHARE * len(points), np.bool_)
