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
    """The cost of a grasp by a rule; infinity for what is not finite, or needs a prediction that there is not.

    Rules: `pressure`, the mean of both fingers' predicted static pressure, each relative to its range, 0 lowest, 1 highest;
    `harder_finger`, the larger of the two; `score`, the negative score of GeoGrasp.
    """
    cost = math.inf
    if rule == SCORE:
        cost = -prediction.grasp.score
    elif prediction.status == Status.OK:
        values = {"PDC_TH": prediction.pdc_th.value, "PDC_MF": prediction.pdc_mf.value}
        limits = [ranges.of(name) for name in values]
        shares = [(value - low) / (high - low) for value, (low, high) in zip(values.values(), limits, strict=True)]
        cost = max(shares) if rule == HARDER_FINGER else float(np.mean(shares))
    return cost if math.isfinite(cost) else math.inf
