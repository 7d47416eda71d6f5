# SPDX-License-Identifier: Apache-2.0
"""The cost of a grasp for a planner: lower is better, infinite without a prediction."""

import math
from typing import Final

import numpy as np

from foretouch.tactile import TactileRanges
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Status, TouchPrediction

PRESSURE: Final = SampleGrasps.Goal.PRESSURE
SCORE: Final = SampleGrasps.Goal.SCORE
HARDER_FINGER: Final = "harder_finger"
COSTS: Final = (PRESSURE, SCORE, HARDER_FINGER)
"""Names of the rules."""


def cost_of(rule: str, prediction: TouchPrediction, ranges: TactileRanges) -> float:
    """The cost of a grasp by a rule.

    Args:
        rule: `pressure`, the mean of both fingers' predicted static pressure, each relative to its range, 0 lowest,
            1 highest; `harder_finger`, the larger of the two; `score`, the negative score of GeoGrasp.
        prediction: Of the grasp, with it.
        ranges: Ranges of the tactile values.

    Returns:
        Infinity for what is not finite, and for a grasp whose cost needs a prediction that there is not.
    """
    if rule == SCORE:
        return _finite(-prediction.grasp.score)
    if prediction.status != Status.OK:
        return math.inf
    shares = []
    for name, interval in (("PDC_TH", prediction.pdc_th), ("PDC_MF", prediction.pdc_mf)):
        low, high = ranges.of(name)
        shares.append((interval.value - low) / (high - low))
    return _finite(max(shares) if rule == HARDER_FINGER else float(np.mean(shares)))


def _finite(cost: float) -> float:
    return cost if math.isfinite(cost) else math.inf
