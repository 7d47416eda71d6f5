# SPDX-License-Identifier: Apache-2.0
"""Feel before you touch: predict tactile readings from a depth cloud, before the hand moves."""

from typing import Any

__version__ = "0.3.0"


def reading(message: Any) -> dict[str, Any]:
    """The predicted readings in a message by the name of their channel, such as `reading(message)["PDC"]`.

    Args:
        message: A `foretouch_msgs/TouchPrediction`, or any object with its fields; ROS need not be installed. Of a
            `TouchPredictionBatch`, all arrays have a first dimension K, its grasps.

    Returns:
        By name of a scalar (F,), of a channel of the taxels (F, N): float32 arrays by finger in the order of
        `message.fingers`, whose attributes `lower` and `upper` are arrays of the same shape, the bounds of the prediction
        intervals. Values are NaN if there is no prediction, bounds without calibration.

    Raises:
        TactileError: If the number of values is not that of the names.
    """
    from foretouch.types.channels import read_prediction  # loads NumPy, which `foretouch --help` does without

    return read_prediction(message)
