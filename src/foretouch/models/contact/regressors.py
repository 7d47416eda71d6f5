# SPDX-License-Identifier: Apache-2.0
"""The two regressors of the contact model: a forest and a kernel ridge regression, stored as tensors.

The forest consists of extremely randomised trees as plain arrays, fitted by scikit-learn and evaluated by numpy:
scikit-learn can save a forest only as a pickle, which the files of this package must not contain.

The kernel ridge regression has a Laplacian kernel and fades to the mean far from the training data. It is the mean of a
Gaussian process with k(x, y) = exp(-γ/F · Σ|x_f - y_f|) over standardised columns [Rasmussen and Williams 2006, eq.
2.25], whose samples are as rough as tactile readings.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from foretouch.errors import ModelError
from foretouch.kernels import Kernel, struct
from foretouch.models.files import Rules, TensorRecord
from foretouch.types import Float32, Float64, Floating, Int32

_DTYPES: Final = {
    "roots": np.int32,
    "feature": np.int16,
    "threshold": np.float64,
    "children": np.int32,
    "leaf": np.int32,
    "value": np.float16,
}


_forest_means = Kernel("forest_means")
_city_distances = Kernel("city_distances")
_weighted_sums = Kernel("weighted_sums")
_ROWS_AT_ONCE, _KNOWN_AT_ONCE, _OUTPUTS_AT_ONCE = 64, 32, 56  # by the compiled functions


@dataclass(frozen=True, eq=False)
class Forest(TensorRecord):
    """T trees with N nodes in all, L of them leaves; M outputs in units of their deviation.

    Attributes:
        roots: (T,) int32, root nodes of the trees.
        feature: (N,) int16, the column that a node compares; -1 at a leaf.
        threshold: (N,) float64; a row goes left where its column is not above.
        children: (N, 2) int32, left and right; both children of a leaf are the leaf.
        leaf: (N,) int32, row of `value` at a leaf, else 0.
        value: (L, M) float16. The rounding, 1e-3 of a deviation, is far below the error of the trees.
    """

    roots: Int32
    feature: npt.NDArray[np.int16]
    threshold: Float64
    children: Int32
    leaf: Int32
    value: npt.NDArray[np.float16]

    @classmethod
    def from_trees(cls, trees: Sequence[Any]) -> Self:
        """Make a forest of the `tree_` of fitted scikit-learn regressors with targets of (S, M)."""
        roots = []
        features = []
        thresholds = []
        children = []
        leaves = []
        values = []
        nodes = rows = 0
        for tree in trees:
            is_leaf, index = tree.children_left < 0, np.arange(tree.node_count)[:, None]
            pair = np.stack([tree.children_left, tree.children_right], axis=1)
            roots.append(nodes)
            features.append(np.where(is_leaf, -1, tree.feature))
            thresholds.append(np.where(is_leaf, 0.0, tree.threshold))
            children.append(np.where(is_leaf[:, None], index, pair) + nodes)
            leaves.append(np.where(is_leaf, np.cumsum(is_leaf) - 1 + rows, 0))
            values.append(tree.value[is_leaf, :, 0])
            nodes += tree.node_count
            rows += int(is_leaf.sum())
        parts = (np.array(roots), *map(np.concatenate, (features, thresholds, children, leaves, values)))
        return cls(*(part.astype(kind) for part, kind in zip(parts, _DTYPES.values(), strict=True)))

    @property
    def output_size(self) -> int:
        """M."""
        return int(self.value.shape[1])

    def first(self, count: int) -> "Forest":
        """Return the first trees, with their nodes and values alone."""
        if count >= len(self.roots):
            return self
        nodes = int(self.roots[count])
        leaves = int(self.leaf[:nodes].max()) + 1
        cut = {name: getattr(self, name)[:nodes] for name in ("feature", "threshold", "children", "leaf")}
        return Forest(roots=self.roots[:count], value=self.value[:leaves], **cut)

    def predict(self, rows: Float64) -> Float64:
        """Return (K, M) float64: mean over the trees for (K, F) rows, which are rounded to float32 as in the fit."""
        return self._compiled.predict(rows)

    @cached_property
    def _compiled(self) -> "CompiledForests":
        return CompiledForests([self])

    def _rules(self) -> Rules:
        nodes = self.feature.size - 1
        return {
            "feature": ("N", -1, 32767),
            "threshold": ("N", -1e300, 1e300),
            "children": ("N2", 0, nodes),
            "value": ("LM", -65504.0, 65504.0),
            "leaf": ("N", 0, len(self.value) - 1 if self.value.ndim else -1),
            "roots": ("T", 0, nodes),
        }

    def _check(self) -> None:
        assert self._checked  # noqa: S101  or an error was raised

    @cached_property
    def _checked(self) -> bool:
        """Dtypes, and that each node leads to later ones and each leaf to a value, since predictions rely on it."""
        for name, kind in _DTYPES.items():
            if getattr(self, name).dtype != kind:
                raise ModelError(f"{name}: dtype {getattr(self, name).dtype} is not {np.dtype(kind)}")
        super()._check()
        if not self.roots.size:
            raise ModelError("roots: there is no tree")
        index, inner = np.arange(self.feature.size)[:, None], self.feature >= 0
        if (self.children[inner] <= index[inner]).any() or (self.children[~inner] != index[~inner]).any():
            raise ModelError("children: an inner node leads back, or a leaf on")
        return True


class CompiledForests:
    """Several forests as the compiled function reads them, which walks through all of them at once.

    Args:
        forests: Are checked, since the function trusts all indices.

    Raises:
        ModelError: If an array of a forest is damaged.
    """

    def __init__(self, forests: Sequence[Forest]) -> None:
        nodes = []
        roots = []
        leaf = []
        value = []
        first = begin = 0
        for forest in forests:
            forest._check()  # noqa: SLF001  of this module
            # A float32 is above a threshold where it is above the largest float32 that is not above the threshold.
            with np.errstate(over="ignore"):
                threshold = forest.threshold.astype(np.float32)
            threshold = np.where(threshold > forest.threshold, np.nextafter(threshold, np.float32(-np.inf)), threshold)
            threshold[forest.feature < 0] = np.inf  # leaves lead to themselves
            feature = np.maximum(forest.feature, 0).astype(np.int32)
            nodes.append(np.column_stack([threshold.view(np.int32), feature, forest.children + first]))
            roots.append(forest.roots + first)
            leaf.append(forest.leaf.astype(np.int64) * forest.output_size + begin)
            value.append(forest.value.reshape(-1))
            first, begin = first + forest.feature.size, begin + forest.value.size
        self._nodes, self._roots, self._leaf = map(np.concatenate, (nodes, roots, leaf))
        self._value = np.concatenate(value).view(np.uint16)
        self._sizes = np.array([(forest.roots.size, forest.output_size) for forest in forests], np.int64)
        self._most, self._width = int(self._sizes[:, 0].max()), int(self._sizes[:, 1].sum())
        self._widest = max(int(forest.feature.max()) for forest in forests)

    def predict(self, rows: Float64) -> Float64:
        """Return (K, M) float64: predictions of the forests beside each other.

        Raises:
            ModelError: If a node compares a column that the rows do not have.
        """
        if rows.ndim != 2 or rows.shape[1] <= max(0, self._widest):
            raise ModelError(f"rows: shape {rows.shape} has no column {self._widest}, which the forest compares")
        rounded = np.ascontiguousarray(rows, np.float32)
        scratch, single = np.empty(_ROWS_AT_ONCE * self._most, np.int32), np.empty(self._most)
        result = np.empty((len(rows), self._width))
        forests = struct(
            "Forests",
            nodes=self._nodes,
            roots=self._roots,
            leaf=self._leaf,
            value=self._value,
            sizes=self._sizes,
            count=len(self._sizes),
            width=self._width,
        )
        _forest_means(rounded, *rounded.shape, forests, scratch, single, result)
        return result


@dataclass(frozen=True, eq=False)
class KernelRegression(TensorRecord):
    """S training rows of F columns and M outputs in units of their deviation from their mean."""

    centre: Float64  # (F,) float64, which standardise the columns
    scale: Float64  # (F,) float64, which standardise the columns
    known: Float32  # (S, F) float32, the training rows, standardised
    weight: Float32  # (S, M) float32
    decay: Float64  # () float64, γ

    RULES = {  # noqa: RUF012
        "centre": "F",
        "scale": ("F", 1e-12, 1e12),
        "known": "SF",
        "weight": "SM",
        "decay": ("", 1e-12, 1e12),
    }

    def predict(self, rows: Float64) -> Float64:
        """Return (K, M) float64 for (K, F) rows; 0, the mean, far from all training rows."""
        scaled = (rows - self.centre) / self.scale
        size, outputs = self.weight.shape
        known, weight = self._packed
        sums = np.empty((len(rows), outputs))
        for start in range(0, len(rows), _ROWS_AT_ONCE):
            part = np.ascontiguousarray(scaled[start : start + _ROWS_AT_ONCE])
            kernel = np.empty((len(part), size))
            _city_distances(part, *part.shape, known, size, kernel)
            _fade(kernel, float(self.decay), rows.shape[1])
            _weighted_sums(kernel, *kernel.shape, weight, outputs, sums[start : start + _ROWS_AT_ONCE])
        return sums

    @cached_property
    def _packed(self) -> tuple[Float64, Float64]:
        """Checked, known rows and weights as the compiled functions read them."""
        self._check()
        return _in_groups(self.known, _KNOWN_AT_ONCE), _in_groups(self.weight.T, _OUTPUTS_AT_ONCE)


def laplacian(rows: Float64, known: Float64, decay: float) -> Float64:
    """Return (K, S) float64 kernel of (K, F) and (S, F) standardised rows."""
    return _fade(np.asarray(cdist(rows, known, "cityblock"), np.float64), decay, rows.shape[1])


def _fade(distance: Float64, decay: float, columns: int) -> Float64:
    """Return the kernel at some distances, in their place."""
    distance *= -decay / columns
    return np.exp(distance, out=distance)


def _in_groups(rows: Floating, size: int) -> Float64:
    """Return (G, F, size) float64: (S, F) rows in groups, a column after the other; the last group is filled up with zeros."""
    groups = -(-len(rows) // size)
    filled = np.zeros((groups * size, rows.shape[1]))
    filled[: len(rows)] = rows
    return np.ascontiguousarray(filled.reshape(groups, size, -1).transpose(0, 2, 1))
