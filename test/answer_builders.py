# SPDX-License-Identifier: Apache-2.0
"""Messages of predictions, as the node sends them."""

from typing import Any

from std_msgs.msg import Header

from foretouch.ros.messages.answers import Refusal, TouchAnswer
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.types import TouchPrediction
from foretouch_msgs.msg import Grasp as GraspMsg


def touch_message(
    outcome: TouchPrediction | Refusal, grasp: GraspMsg, header: Header | None = None, **fields: Any
) -> Any:
    """The message of one prediction or refusal, of the BioTac SP unless another `sensor` is given."""
    return TouchAnswer(header or Header(), [grasp], [outcome], **{"sensor": BIOTAC_SP, **fields}).message.predictions[0]
