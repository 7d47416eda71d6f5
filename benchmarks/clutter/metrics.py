# SPDX-License-Identifier: Apache-2.0
"""How well predicted objects agree with true ones: the protocol of UOIS-Net, and how often objects are merged or cut.

Predicted and true objects are paired by the Hungarian method so that the sum of the F of all pairs is largest. Of the
pairs, overlap precision, recall and F count pixels, those of the boundary count the pixels of the outlines that lie near an
outline of the partner (Xie, Xiang, Mousavian, Fox: The Best of Both Modes, CoRL 2019, section 5; after Dave, Tokmakov,
Ramanan: Towards Segmenting Anything That Moves, 2019). An object is found if its F is at least .75.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.optimize import linear_sum_assignment

from foretouch.types import Bool, Float64, Int32, Int64

FOUND: Final = 0.75  # F from which an object is found
MAJORITY: Final = 0.5  # share that one part must have to count as the whole
TINY: Final = 0.05  # smaller shares are outlines, not parts
BOUNDARY: Final = 0.003  # of the image's diagonal: distance within which outlines agree


@dataclass(frozen=True)
class SceneScore:
    """Agreement of one scene; shares, 0 to 1."""

    precision: float  # of the predicted objects' pixels: those on the paired true object
    recall: float  # of the true objects' pixels: those on the paired predicted object
    f: float  # harmonic mean of both
    boundary_precision: float  # the same of the outlines' pixels
    boundary_recall: float
    boundary_f: float
    n_true: int  # true objects
    n_found: int  # of them found
    n_merged: int  # of them most visible pixels lie in a prediction that also has the most of another one
    n_cut: int  # of them two predictions or more hold a part each


def score(predicted: Int32, true: Int32) -> SceneScore:
    """Compare two label images (H, W) of the same size, 0 where there is no object; other values need not agree."""
    common, n_predicted, n_true, dense_predicted, dense_true = _overlaps(predicted, true)
    f = 2.0 * common / (n_true[:, None] + n_predicted[None])
    rows, columns = linear_sum_assignment(f, maximize=True)
    kept = common[rows, columns].sum()
    near_true, near_predicted, edge_true, edge_predicted = _outlines(dense_predicted, dense_true, rows, columns)
    precision, recall = _ratio(kept, n_predicted.sum()), _ratio(kept, n_true.sum())
    boundary = _ratio(near_true, edge_predicted), _ratio(near_predicted, edge_true)
    merged, cut = merged_and_cut(common, n_true)
    return SceneScore(
        *(precision, recall, _harmonic(precision, recall)),
        *(*boundary, _harmonic(*boundary)),
        *(len(n_true), int((f[rows, columns] >= FOUND).sum()), merged, cut),
    )


def merged_and_cut(common: Int64, n_true: Int64) -> tuple[int, int]:
    """True objects that share a prediction, and those that several predictions hold parts of.

    Args:
        common: (T, P) int64, pixels that a true and a predicted object have in common.
        n_true: (T,) int64, pixels of the true objects.
    """
    share = common / n_true[:, None]
    holder = np.where(share.max(axis=1, initial=0.0) >= MAJORITY, np.argmax(share, axis=1) if share.size else -1, -1)
    held = holder[holder >= 0]
    shared = np.isin(holder, np.flatnonzero(np.bincount(held, minlength=1) > 1)) & (holder >= 0)
    return int(shared.sum()), int(((share >= TINY).sum(axis=1) > 1).sum())


def summary(scores: Iterable[SceneScore]) -> dict[str, float]:
    """Means over scenes of precision, recall and F; rates over all objects."""
    scores = list(scores)
    names = ("precision", "recall", "f", "boundary_precision", "boundary_recall", "boundary_f")
    n_true = sum(one.n_true for one in scores)
    rates = {name: sum(getattr(one, f"n_{name}") for one in scores) / n_true for name in ("found", "merged", "cut")}
    return {name: float(np.mean([getattr(one, name) for one in scores])) for name in names} | rates


def _overlaps(predicted: Int32, true: Int32) -> tuple[Int64, Int64, Int64, Int32, Int32]:
    """Common pixels (T, P), sizes (P,) and (T,), and both images with labels 1, 2, ... without gaps."""
    values, dense = np.unique(np.append(predicted, 0), return_inverse=True)
    names, image = np.unique(np.append(true, 0), return_inverse=True)
    dense, image = dense[:-1].reshape(predicted.shape), image[:-1].reshape(true.shape)
    table = np.bincount((image * len(values) + dense).ravel(), minlength=len(names) * len(values))
    table = table.reshape(len(names), len(values))
    return (
        *(table[1:, 1:], table.sum(axis=0)[1:], table.sum(axis=1)[1:]),
        *(dense.astype(np.int32), image.astype(np.int32)),
    )


def _outlines(predicted: Int32, true: Int32, rows: Int64, columns: Int64) -> tuple[int, int, int, int]:
    """Predicted pixels near the paired true outline, true ones near the predicted one, and the sizes of all outlines."""
    reach = np.ceil(BOUNDARY * np.hypot(*true.shape))
    edges_true = [outline(true == k) for k in range(1, int(true.max(initial=0)) + 1)]
    edges_predicted = [outline(predicted == k) for k in range(1, int(predicted.max(initial=0)) + 1)]
    near_true = near_predicted = 0
    for row, column in zip(rows, columns, strict=True):
        mine, theirs = edges_predicted[column], edges_true[row]
        near_true += int((mine & _within(theirs, reach)).sum())
        near_predicted += int((theirs & _within(mine, reach)).sum())
    sizes = (sum(int(edge.sum()) for edge in edges) for edges in (edges_true, edges_predicted))
    return near_true, near_predicted, *sizes


def outline(mask: Bool) -> Bool:
    """Pixels of an image (H, W) whose right, lower or lower right neighbour is on the other side of the mask's edge."""
    padded = np.pad(mask, ((0, 1), (0, 1)), mode="edge")
    return (mask ^ padded[:-1, 1:]) | (mask ^ padded[1:, :-1]) | (mask ^ padded[1:, 1:])


def _within(edge: Bool, reach: float) -> Bool:
    """Pixels no farther than so many pixels from an outline."""
    if not edge.any():
        return np.zeros(edge.shape, np.bool_)
    distance: Float64 = distance_transform_edt(~edge)
    return np.asarray(distance <= reach, np.bool_)


def _ratio(part: float, whole: float) -> float:
    """A share; of nothing it is 1, as UOIS-Net counts it."""
    return float(part / whole) if whole else 1.0


def _harmonic(a: float, b: float) -> float:
    return 2.0 * a * b / (a + b) if a + b > 0.0 else 0.0
