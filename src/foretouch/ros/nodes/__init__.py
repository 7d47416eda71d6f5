# SPDX-License-Identifier: Apache-2.0
"""The nodes by name. Each is imported when it is asked for, so that an executable loads only its own."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from foretouch.laboratory import needs_laboratory

if TYPE_CHECKING:
    from foretouch.ros.runtime.lifecycle_node import ForetouchNode

NodeName = Literal[
    "camera", "perception", "segmentation", "grasp", "touch_predictor", "replay", "hand", "recorder", "bridge"
]


def node_class(name: NodeName) -> "type[ForetouchNode[Any]]":
    """Import the class of a node.

    Args:
        name: Of the node in a graph.

    Raises:
        MissingDependencyError: If it is of the laboratory, which is not installed.
    """
    with needs_laboratory(f"node {name}"):
        match name:
            case "camera":
                from foretouch.ros.nodes.camera import CameraNode

                return CameraNode
            case "perception":
                from foretouch.ros.nodes.perception import PerceptionNode

                return PerceptionNode
            case "segmentation":
                from foretouch.ros.nodes.perception import SegmentationNode

                return SegmentationNode
            case "grasp":
                from foretouch.ros.nodes.perception import GraspNode

                return GraspNode
            case "touch_predictor":
                from foretouch.ros.nodes.perception import TouchPredictorNode

                return TouchPredictorNode
            case "replay":
                from foretouch.ros.nodes.replay import ReplayNode

                return ReplayNode
            case "hand":
                from foretouch_lab.ros.hand import HandNode

                return HandNode
            case "recorder":
                from foretouch.ros.nodes.recorder import RecorderNode

                return RecorderNode
            case "bridge":
                from foretouch.ros.nodes.bridge import BridgeNode

                return BridgeNode


NODES: Final[dict[str, Callable[[], "type[ForetouchNode[Any]]"]]] = {
    name: partial(node_class, name) for name in get_args(NodeName)
}
"""What imports the class of each node, by name."""
