# SPDX-License-Identifier: Apache-2.0
"""Which grasps of a request have predicted pressures that differ by less than their intervals.

The error of a prediction has a part that all grasps on an object share and a part of each grasp. For the released models, the
interval of the difference of two grasps is .4 to 1.03 times as wide as the interval of one prediction before any touch, so the
rule here is the rule of a difference, on the safe side, and can be checked from the bounds of the answer alone.
"""

from typing import Final, Protocol

import numpy as np
from numpy.typing import ArrayLike

from foretouch.models.calibration import Calibration
from foretouch.tactile import Ranges
from foretouch.tactile.description import Sensor
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Bool, Float64, Index, Predictions, Touch

EQUAL_PRESSURE: Final = "equal_pressure"
"""Flag of grasps whose predicted pressure differs from the lowest of the request by less than the half width of its interval."""


class Scaled(Protocol):
    """What shows how hard a finger presses in a prediction: a `TouchModel`."""

    sensor: Sensor
    ranges: Ranges
    calibration: Calibration | None


def equal_groups(costs: ArrayLike, half: ArrayLike) -> Index:
    """Return (K,) number of the group of each of (K,) costs with half widths (K,), group 0 with the lowest cost.

    A group holds all costs that exceed its lowest by less than the half width of that one; NaN and infinity are alone.
    """
    costs, half = np.asarray(costs, np.float64), np.asarray(half, np.float64)
    groups, left, number = np.empty(len(costs), np.intp), np.arange(len(costs)), 0
    while len(left):
        own = _lowest_group(costs[left], half[left])
        groups[left[own]], left, number = number, left[~own], number + 1
    return groups


def _lowest_group(costs: Float64, half: Float64) -> Bool:
    """Return (K,) which of (K,) costs, at least one, are in the group of the lowest; see `equal_groups`."""
    lowest = np.argsort(costs, kind="stable")[0]  # NaN is the last
    with np.errstate(invalid="ignore"):
        group = np.asarray(costs - costs[lowest] < half[lowest], np.bool_)
    group[lowest] = True
    return group


def scale_of(model: Scaled) -> tuple[Touch | None, Ranges]:
    """Return the reading at rest of a model, if it has one, and the ranges that its predictions are shown in."""
    rest = None if model.calibration is None else Touch(model.calibration.rest, model.sensor.channels)
    return rest, model.ranges


def predicted_pressures(predictions: Predictions, model: Scaled) -> Float64:
    """Return (3, K, F) how hard each finger presses in predictions of a model, and its bounds (see `TaxelView.pressures`); NaN for none."""
    view, scale = TaxelView(model.sensor), scale_of(model)
    ends = (predictions.value, predictions.lower, predictions.upper)
    return np.stack([view.pressures(rows, *scale) for rows in ends])


def equal_pressures(predictions: Predictions, model: Scaled) -> Bool:
    """Return (K,) which grasps on one object cannot be ranked before another as the gentlest: those of the flag `EQUAL_PRESSURE`.

    The pressure is the mean of both fingers; of models without intervals, none.
    """
    none = np.zeros(len(predictions), np.bool_)
    if len(predictions) < 2:
        return none
    value, lower, upper = predicted_pressures(predictions, model).mean(axis=-1)
    equal = _lowest_group(value, np.abs(upper - lower) / 2.0)
    return equal if np.count_nonzero(equal) > 1 else none
