# SPDX-License-Identifier: Apache-2.0
"""How well predicted objects agree with true ones: the protocol of UOIS-Net, and how often objects are merged or cut.

Predicted and true objects are paired by the Hungarian method so that the sum of the F of all pairs is largest. Of the
pairs, overlap precision, recall and F count pixels, those of the boundary count the pixels of the outlines that lie near an
outline of the partner (Xie, Xiang, Mousavian, Fox: The Best of Both Modes, CoRL 2019, section 5; after Dave, Tokmakov,
Ramanan: Towards Segmenting Anything That Moves, 2019). An object is found if its F is at least .75.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.optimize import linear_sum_assignment

from foretouch.types import Bool, Float64, Int32, Int64

FOUND: Final = 0.75  # F from which an object is found
MAJORITY: Final = 0.5  # a prediction with a larger share of a true object holds it
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
    n_merged: int  # of them held, with more than half of their pixels, by a prediction that holds another one too
    n_cut: int  # of them with parts, of at least a twentieth of their pixels, in two predictions or more


def score(predicted: Int32, true: Int32) -> SceneScore:
    """Compare two label images (H, W) of the same size, 0 where there is no object; other values need not agree."""
    overlap = _Overlap.of(predicted, true)
    rows, columns, f = overlap.matched()
    kept = overlap.common[rows, columns].sum()
    precision, recall = _ratio(kept, overlap.n_predicted.sum()), _ratio(kept, overlap.n_true.sum())
    near_true, near_predicted, edge_true, edge_predicted = _outlines(overlap, rows, columns)
    boundary = _ratio(near_true, edge_predicted), _ratio(near_predicted, edge_true)
    merged, cut = merged_and_cut(overlap.common, overlap.n_true)
    return SceneScore(
        *(precision, recall, _harmonic(precision, recall)),
        *(*boundary, _harmonic(*boundary)),
        *(len(overlap.n_true), int((f >= FOUND).sum()), merged, cut),
    )


def merged_and_cut(common: Int64, n_true: Int64) -> tuple[int, int]:
    """How many true objects share a prediction (under-segmentation), and how many are in parts (over-segmentation).

    Args:
        common: (T, P) int64, pixels that a true and a predicted object have in common.
        n_true: (T,) int64, pixels of the true objects.
    """
    share = common / n_true[:, None]
    held = (share > MAJORITY).sum(axis=0)  # by each prediction; at most one holds an object
    return int(held[held > 1].sum()), int(((share >= TINY).sum(axis=1) > 1).sum())


def summary(scores: Iterable[SceneScore]) -> dict[str, float]:
    """Means over scenes of precision, recall and F; rates over all objects."""
    scores = list(scores)
    names = ("precision", "recall", "f", "boundary_precision", "boundary_recall", "boundary_f")
    n_true = sum(one.n_true for one in scores)
    rates = {name: sum(getattr(one, f"n_{name}") for one in scores) / n_true for name in ("found", "merged", "cut")}
    return {name: float(np.mean([getattr(one, name) for one in scores])) for name in names} | rates


@dataclass(frozen=True, eq=False)
class _Overlap:
    """Pixels that T true and P predicted objects have in common."""

    common: Int64  # (T, P) int64
    n_predicted: Int64  # (P,) int64, their sizes
    n_true: Int64  # (T,) int64
    predicted: Int32  # (H, W) int32, labels 1 to P
    true: Int32  # (H, W) int32, labels 1 to T

    @classmethod
    def of(cls, predicted: Int32, true: Int32) -> Self:
        """Of two label images."""
        (p_names, p_image), (t_names, t_image) = (_without_gaps(labels) for labels in (predicted, true))
        flat = (t_image * len(p_names) + p_image).ravel()
        table = np.bincount(flat, minlength=len(t_names) * len(p_names)).reshape(len(t_names), len(p_names))
        return cls(table[1:, 1:], table.sum(axis=0)[1:], table.sum(axis=1)[1:], p_image, t_image)

    def matched(self) -> tuple[Int64, Int64, Float64]:
        """True and predicted object of each pair that has pixels in common, and its F."""
        f = 2.0 * self.common / (self.n_true[:, None] + self.n_predicted[None])
        rows, columns = linear_sum_assignment(f, maximize=True)
        shared = f[rows, columns] > 0.0
        rows, columns = rows[shared], columns[shared]
        return rows, columns, f[rows, columns]


def _without_gaps(labels: Int32) -> tuple[Int64, Int32]:
    """The labels there are, 0 in any case, and the image of their places in that list."""
    names, places = np.unique(np.append(labels, 0), return_inverse=True)
    return names, places[:-1].reshape(labels.shape).astype(np.int32)


def _outlines(overlap: _Overlap, rows: Int64, columns: Int64) -> tuple[int, int, int, int]:
    """Predicted pixels near the paired true outline, true ones near the predicted one, and the sizes of all outlines."""
    reach = float(np.ceil(BOUNDARY * np.hypot(*overlap.true.shape)))
    window = _around(overlap.true + overlap.predicted > 0)
    true, predicted = overlap.true[window], overlap.predicted[window]
    edges_true = [outline(true == k) for k in range(1, len(overlap.n_true) + 1)]
    edges_predicted = [outline(predicted == k) for k in range(1, len(overlap.n_predicted) + 1)]
    near_true = near_predicted = 0
    for row, column in zip(rows, columns, strict=True):
        mine, theirs = edges_predicted[column], edges_true[row]
        near_true += int((mine & _within(theirs, reach)).sum())
        near_predicted += int((theirs & _within(mine, reach)).sum())
    size_true, size_predicted = (sum(int(edge.sum()) for edge in edges) for edges in (edges_true, edges_predicted))
    return near_true, near_predicted, size_true, size_predicted


def _around(mask: Bool) -> tuple[slice, slice]:
    """The part of an image that holds all of a mask and a pixel around it, where there is one."""
    if not mask.any():
        return np.s_[:0, :0]
    v, u = np.nonzero(mask)
    return np.s_[max(0, v.min() - 1) : v.max() + 2, max(0, u.min() - 1) : u.max() + 2]


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
