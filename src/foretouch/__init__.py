# SPDX-License-Identifier: Apache-2.0
"""Feel before you touch: predict tactile readings from a depth cloud, before the hand moves."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from foretouch.types import Prediction, Predictions

__version__ = "0.3.0"


def reading(message: Any) -> "Prediction | Predictions":
    """Read the predicted readings in a message, such as `reading(message)["E"].value`.

    Args:
        message: A `foretouch_msgs/TouchPrediction`, or any object with its fields; ROS need not be installed. Or a
            `TouchPredictionBatch` or `TouchPredictionArray`, with K grasps.

    Returns:
        What a touch model returns in Python: `reading(message)[channel]` has `value`, `lower` and `upper`, float64 arrays by
        finger in the order of `message.fingers`: (F, N) for a channel of the taxels, (F,) for a scalar, with a first
        dimension K for K grasps. Values are NaN if there is no prediction, bounds without calibration.

    Raises:
        TactileError: If the number of values is not that of the names.
    """
    from foretouch.grasp.messages import decode_predictions  # loads NumPy, which `foretouch --help` does without

    rows = decode_predictions(message)
    many = hasattr(message, "predictions") or hasattr(message, "statuses")
    return rows if many else rows[0]
