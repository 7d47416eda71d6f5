# SPDX-License-Identifier: Apache-2.0
"""How well predicted objects agree with true ones: the overlap of UOIS-Net, and how often objects are merged or cut.

Predicted and true objects are paired by the Hungarian method so that the sum of the F of all pairs is largest. Of the
pairs, overlap precision, recall and F count pixels (Xie, Xiang, Mousavian, Fox: The Best of Both Modes, CoRL 2019, section 5;
after Dave, Tokmakov, Ramanan: Towards Segmenting Anything That Moves, 2019). An object is found if its F is at least .75.
A prediction is none of the objects if less than a fifth of its pixels are on one, or on what is not scored.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from foretouch.types import Bool, Int32, Int64

FOUND: Final = 0.75  # F from which an object is found
MAJORITY: Final = 0.5  # a prediction with a larger share of a true object holds it
TINY: Final = 0.05  # smaller shares are outlines, not parts
NONE: Final = 0.2  # a prediction with a smaller share on objects is none of them


@dataclass(frozen=True)
class SceneScore:
    """Agreement of one scene; shares, 0 to 1."""

    precision: float  # of the predicted objects' pixels: those on the paired true object
    recall: float  # of the true objects' pixels: those on the paired predicted object
    f: float  # harmonic mean of both
    n_true: int  # true objects
    n_found: int  # of them found
    n_merged: int  # of them held, with more than half of their pixels, by a prediction that holds another one too
    n_cut: int  # of them with parts, of at least a twentieth of their pixels, in two predictions or more
    n_none: int = 0  # predictions that are none of the objects


def score(predicted: Int32, true: Int32) -> SceneScore:
    """Compare two label images (H, W) of the same size, 0 where there is no object; other values need not agree.

    Where the true label is negative nothing is scored.
    """
    n_none = _count_none(predicted, true)
    (p_count, p_image), (t_count, t_image) = (
        _without_gaps(np.where(true < 0, 0, labels)) for labels in (predicted, true)
    )
    table = np.bincount((t_image * p_count + p_image).ravel(), minlength=t_count * p_count).reshape(t_count, p_count)
    common, n_predicted, n_true = table[1:, 1:], table.sum(axis=0)[1:], table.sum(axis=1)[1:]
    f = 2.0 * common / (n_true[:, None] + n_predicted[None])
    rows, columns = linear_sum_assignment(f, maximize=True)
    kept = common[rows, columns].sum()
    precision, recall = _ratio(kept, n_predicted.sum()), _ratio(kept, n_true.sum())
    both = 2.0 * precision * recall / (precision + recall) if precision + recall > 0.0 else 0.0
    merged, cut = merged_and_cut(common, n_true)
    return SceneScore(precision, recall, both, len(n_true), int((f[rows, columns] >= FOUND).sum()), merged, cut, n_none)


def _count_none(predicted: Int32, true: Int32) -> int:
    whole = np.bincount(predicted.ravel())[1:]
    some = np.bincount(predicted[true != 0], minlength=len(whole) + 1)[1:]
    return int(np.count_nonzero(some[whole > 0] < NONE * whole[whole > 0]))


def f_of_best(one: Bool, true: Int32) -> float:
    """F of a prediction (H, W) with the object that fits it best; 0 if there is no object."""
    seen = one & (true >= 0)
    common, sizes = (np.bincount(labels[labels > 0], minlength=int(true.max()) + 1) for labels in (true[seen], true))
    return float((2.0 * common / np.maximum(np.count_nonzero(seen) + sizes, 1)).max())


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
    """Means over scenes of precision, recall, F and predictions that are none of the objects; rates over all objects."""
    scores = list(scores)
    names = ("precision", "recall", "f")
    n_true = sum(one.n_true for one in scores)
    rates = {name: sum(getattr(one, f"n_{name}") for one in scores) / n_true for name in ("found", "merged", "cut")}
    rates["none"] = float(np.mean([one.n_none for one in scores]))
    return {name: float(np.mean([getattr(one, name) for one in scores])) for name in names} | rates


def _without_gaps(labels: Int32) -> tuple[int, Int64]:
    """One more than the number of labels, and the image with labels from 1 without gaps."""
    names, places = np.unique(np.append(0, labels), return_inverse=True)
    return len(names), places[1:].reshape(labels.shape)


def _ratio(part: float, whole: float) -> float:
    """A share; of nothing it is 1, as UOIS-Net counts it."""
    return float(part / whole) if whole else 1.0
