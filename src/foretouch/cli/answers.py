# SPDX-License-Identifier: Apache-2.0
"""Answers as `predict --json` and `run --json` print them: also of messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from foretouch.errors import ForetouchError
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.types import stamp_ns

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from foretouch_msgs.msg import TouchPrediction as TouchPredictionMsg
    from foretouch_msgs.msg import TouchPredictionArray


def contacts_text(grasp: Mapping[str, Any]) -> str:
    """Format the contacts of a grasp record in one line, with their distance."""
    g1, g2 = (" ".join(f"{value:.3f}" for value in grasp[name]) for name in ("g1", "g2"))
    return f"g1 {g1}, g2 {g2} m, {1e3 * math.dist(grasp['g1'], grasp['g2']):.0f} mm wide"


def answer_record(message: TouchPredictionArray, sensor: Sensor = BIOTAC_SP) -> dict[str, Any]:
    """Return a `touch` message of a sensor as `run --json` prints it."""
    from foretouch.ros.messages.requests import status_name

    return {
        "stamp_ns": stamp_ns(message.header.stamp),
        "frame_id": message.header.frame_id,
        "status": status_name(message.status),
        "reason": message.reason,
        "predictions": [_message_record(prediction, sensor) for prediction in message.predictions],
    }


def _message_record(message: TouchPredictionMsg, sensor: Sensor) -> dict[str, Any]:
    """Return a prediction for JSON; one that cannot be read, such as with an unknown reference, gets its object and reason alone."""
    from foretouch.ros.messages.conversions import prediction_from_msg
    from foretouch.ros.messages.requests import status_name

    target = {"object": message.grasp.object_id}
    try:
        return target | prediction_from_msg(message, sensor).to_dict()
    except ForetouchError as err:
        status = status_name(message.status) if message.status else "failed"
        return target | {"status": status, "reason": message.reason or str(err)}


def modality_text(
    value: ArrayLike, lower: ArrayLike | None, upper: ArrayLike | None, text: Callable[[float], str] = "{:.0f}".format
) -> str:
    """Format a single number with its half width; of several, the least and largest value, and the mean half width of each.

    Args:
        value: One or more values; None of a refused prediction.
        lower: Lower bounds, if any.
        upper: Upper bounds, if any.
        text: Formats a number.
    """
    if value is None:
        return "refused"
    values = np.atleast_1d(value)
    shown = f"{text(values.min())}–{text(values.max())}" if values.size > 1 else text(values[0])
    if lower is None or upper is None or np.isnan(lower).any():  # not calibrated
        return shown
    half = f"±{text(float(np.mean(np.subtract(upper, lower))) / 2.0)}"  # no space: a table folds there
    return f"{shown}\neach {half}" if values.size > 1 else f"{shown} {half}"
