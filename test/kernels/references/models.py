# SPDX-License-Identifier: Apache-2.0
"""What the kernels of `forest.c`, `contact.c` and `nearest.c` compute, in NumPy and SciPy."""

from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from foretouch.models.contact import above

Array = np.ndarray[Any, Any]


def forest(trees, rows) -> Array:
    """Mean over the trees; a row, rounded to float32, goes right where its column is above the threshold."""
    rounded = rows.astype(np.float32)
    node = np.tile(trees.roots, (len(rows), 1))
    while ((feature := trees.feature[node]) >= 0).any():
        column = np.take_along_axis(rounded, np.maximum(feature, 0), axis=1)
        node = trees.children[node, (column > trees.threshold[node]).astype(int)]
    values = [trees.value[one].astype(np.float64).mean(axis=0) for one in trees.leaf[node]]
    return np.array(values).reshape(len(rows), -1)


def kernel_regression(model, rows) -> Array:
    distance = cdist((rows - model.centre) / model.scale, model.known.astype(np.float64), "cityblock")
    return np.exp(-distance * float(model.decay) / rows.shape[1]) @ model.weight.astype(np.float64)


def nearest(points, targets) -> Array:
    return cdist(targets, points).min(axis=1)


def contact_rows(xyz, contacts, fingers, radii_m=(0.02, 0.008, 0.015, 0.03)) -> Array:
    """(K, 14): weight, roughness and place of the pad, and the slopes of three patches in the finger's frame.

    A point weighs 1 - (distance / radius)²; a slope is the minor axis of its patch, as long as the patch is flat.
    """
    rows = []
    for contact, finger in zip(contacts, fingers, strict=True):
        row: list[float] = []
        for radius_m in radii_m:
            moved = xyz - contact
            weight = np.clip(1.0 - (moved**2).sum(axis=1) / radius_m**2, 0.0, None)
            total = max(weight.sum() / len(xyz), 1e-12) * len(xyz)
            mean = weight @ moved / total
            values, axes = np.linalg.eigh((moved * weight[:, None]).T @ moved / total - np.outer(mean, mean))
            thin, wide = np.sqrt(np.maximum(values[:2], 0.0))
            if not row:
                row = [weight.sum() / len(xyz), thin, *(finger.T @ mean)]
                continue
            normal = finger.T @ axes[:, 0]
            length = (1.0 - thin / max(wide, 1e-12)) * abs(normal[2]) * (-1.0 if normal[2] > 0.0 else 1.0)
            row += [0.0] * 3 if np.count_nonzero(weight) < 4 else list(length * normal)
        rows.append(row)
    return np.array(rows)


def is_hidden(places, points) -> Array:
    """A picture of the depth of points, which hides what is behind it by more than a step."""
    hidden = np.zeros(len(places), bool)
    ahead, front = points[points[:, 2] > 0.0], np.flatnonzero(places[:, 2] > 0.0)
    pixel, at = (np.floor(some[:, :2] / some[:, 2:] / above._PITCH) for some in (ahead, places[front]))
    if not len(ahead) or (np.ptp(pixel, axis=0) + 1.0).prod() > above._MOST_CELLS:
        return hidden
    nearest: dict[tuple[float, ...], float] = {}
    for where, z in zip(map(tuple, pixel), ahead[:, 2], strict=True):
        nearest[where] = min(z, nearest.get(where, np.inf))
    depths = np.array([nearest.get(tuple(where), np.inf) for where in at])
    hidden[front] = places[front, 2] > depths + above._BEHIND_M
    return hidden
