# SPDX-License-Identifier: Apache-2.0
"""Messages of predictions, as the node sends them."""

from typing import Any

from std_msgs.msg import Header

from foretouch.ros.messages.answers import TouchAnswer
from foretouch.tactile.channels import BIOTAC, BIOTAC_SP
from foretouch.types import Grasps, Prediction, Predictions
from foretouch.types.channels import Channels
from foretouch_msgs.msg import Grasp as GraspMsg


def refusal(status: str, reason: str, channels: Channels = BIOTAC, count: int = 1) -> Predictions:
    """Grasps without a prediction, whose numbers are not known."""
    return Predictions.refused(Grasps.unknown(count), channels, status, reason)


def touch_message(
    prediction: Prediction | Predictions, grasp: GraspMsg, header: Header | None = None, **fields: Any
) -> Any:
    """The message of one prediction or refusal, of the BioTac SP unless another `sensor` is given."""
    rows = prediction.row if isinstance(prediction, Prediction) else prediction
    return TouchAnswer(header or Header(), [grasp], rows, **{"sensor": BIOTAC_SP, **fields}).message.predictions[0]
