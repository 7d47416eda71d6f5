# SPDX-License-Identifier: Apache-2.0
"""How sure it is that a segment is one whole object.

A logistic regression of three numbers: the logarithm of the cells of the segment, the highest log odds of a join that was refused, since
what should have been joined is a part, and the lowest of the joins that made it, since what should not have been joined is several
objects. Its weights (`whole_object.json`) are made by `python -m benchmarks.clutter.confidence`, from labelled images.
"""

import math
from functools import cache
from pathlib import Path

from foretouch.cloud.segmentation.clusters import Clusters
from foretouch.files import read_json

WEIGHTS = Path(__file__).with_name("whole_object.json")
INPUTS = ("log_cells", "refused", "accepted")
_RANGES = ((0.0, 12.0), (-6.0, 1.0), (-2.0, 6.0))  # beyond which a number says no more


@cache
def _weights() -> tuple[float, ...]:
    """Return the weights of the inputs, and the constant."""
    weights = read_json(WEIGHTS)["weights"]
    return tuple(float(weights[name]) for name in (*INPUTS, "constant"))


def inputs(window: Clusters, label: int, n_points: int) -> list[float] | None:
    """Return the inputs of the regression (`INPUTS`) for a label of a window; None where splitting is not possible.

    Args:
        window: With the joins of its parts, or the pixels of a cell where nothing called for splitting.
        label: A label of the window.
        n_points: Its solid points.
    """
    if window.joins is not None:
        refused, accepted, cells = window.joins[label].tolist()
    elif window.pixels_per_cell > 0.0:
        refused, accepted, cells = -math.inf, math.inf, n_points / window.pixels_per_cell
    else:
        return None
    values = math.log(max(cells, 1.0)), refused, accepted
    return [min(max(value, low), high) for value, (low, high) in zip(values, _RANGES, strict=True)]


def confidence(window: Clusters, label: int, n_points: int) -> float | None:
    """Return the probability that a label of a window is one whole object; None where splitting is not possible (see `inputs`)."""
    values = inputs(window, label, n_points)
    if values is None:
        return None
    *weights, constant = _weights()
    odds = constant + sum(weight * value for weight, value in zip(weights, values, strict=True))
    return 1.0 / (1.0 + math.exp(-odds))
