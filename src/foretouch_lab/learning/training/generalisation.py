# SPDX-License-Identifier: Apache-2.0
"""How far the kernel of a contact model holds on objects that it was not fitted to: its generalisation gain.

The kernel predicts each training object from the others. What held there is a share λ of its predicted differences from
the mean, one for each modality: the slope of the actual differences over the predicted ones, where every object weighs
the same, since it is divided by its own error of the mean. The share is shrunk by how much it changes with the objects,
as the jackknife over objects shows [Efron and Stein 1981]: λ · max(0, 1 - var(λ) / λ²), within [0, 1].

Objects differ in more than their shape shows, and a training set of a few objects confounds the two. The kernel is
fitted beside an effect of each object, as in a mixed model [Rasmussen and Williams 2006, section 2.7]: K + ρ [same
object] + ridge I. What an object has of its own is then not taken for a consequence of its shape, and the effect of an
unknown object is zero.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.models.contact.regressors import laplacian
from foretouch.models.novelty import standardisation
from foretouch.types import Float64
from foretouch.types.channels import Channels
from foretouch_lab.learning.data.folds import object_folds

DECAY: Final = 2.0
"""Of the kernel, over the mean distance per standardised feature."""

_OBJECT_EFFECT: Final = 1.0  # variance of what is an object's own, beside its shape, over that of the kernel
_RIDGES: Final = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # candidates for the ratio of noise to signal


def training_kernel(known: Float64, objects: Sequence[str] | npt.NDArray[np.str_]) -> Float64:
    """(S, S) kernel of (S, F) standardised rows with the effects of their objects, before the ridge."""
    _, index = np.unique(np.asarray(objects), return_inverse=True)
    return np.asarray(laplacian(known, known, DECAY) + _OBJECT_EFFECT * (index[:, None] == index), np.float64)


def choose_ridge(rows: Float64, scaled: Float64, objects: Sequence[str], channels: Channels) -> tuple[float, Float64]:
    """The ridge of least error on objects left out, each object and modality weighing the same, and its gain there.

    Args:
        rows: (S, F) features.
        scaled: (S, D) standardised labels.
        objects: (S,) names.
        channels: Of the labels.

    Returns:
        The ridge, and (M,) gains λ of the modalities; of a single object the largest ridge and zeros.
    """
    if len(set(objects)) < 2:
        return max(_RIDGES), np.zeros(len(channels.modalities))
    products, powers = _held_out(rows, scaled, np.asarray(objects), channels)
    best = int(np.argmin((powers - 2.0 * products).sum(axis=(1, 2))))
    return _RIDGES[best], np.array([shrunken_slope(*one) for one in zip(products[best], powers[best], strict=True)])


def _held_out(
    rows: Float64, scaled: Float64, objects: npt.NDArray[np.str_], channels: Channels
) -> tuple[Float64, Float64]:
    """(R, M, G) sums of predicted times actual differences from the mean, and of squared predicted ones.

    Both are divided by the object's sum of squared actual differences.
    """
    groups = np.unique(objects)
    products, powers = (np.zeros((len(_RIDGES), len(channels.modalities), len(groups))) for _ in range(2))
    for fold in object_folds(list(objects)):
        centre, scale = standardisation(rows[fold.train])
        known, test = ((rows[index] - centre) / scale for index in (fold.train, fold.test))
        mean = scaled[fold.train].mean(axis=0)
        values, vectors = np.linalg.eigh(training_kernel(known, objects[fold.train]))
        cross, turned = laplacian(test, known, DECAY) @ vectors, vectors.T @ (scaled[fold.train] - mean)
        actual = scaled[fold.test] - mean
        for r, ridge in enumerate(_RIDGES):
            predicted = cross @ (turned / (values + ridge)[:, None])
            for g in np.flatnonzero(np.isin(groups, objects[fold.test])):
                mine = objects[fold.test] == groups[g]
                for m, own in enumerate(channels.modality_columns.values()):
                    x, y = (part[mine][:, own] for part in (predicted, actual))
                    size = max(float((y * y).sum()), 1e-12)
                    products[r, m, g], powers[r, m, g] = (x * y).sum() / size, (x * x).sum() / size
    return products, powers


def shrunken_slope(products: Float64, powers: Float64) -> float:
    """λ of one modality from (G,) products and powers of the objects; 0 where nothing was predicted, or G is 1."""
    total, power = products.sum(), powers.sum()
    left = power - powers
    if len(products) < 2 or left.min() <= 1e-12 or total <= 0.0:
        return 0.0
    slope = total / power
    variance = (len(products) - 1) * ((total - products) / left).var()  # of the jackknife
    return float(np.clip(slope * max(0.0, 1.0 - variance / slope**2), 0.0, 1.0))
