# SPDX-License-Identifier: Apache-2.0
"""The nodes by name. Each is imported when it is asked for, so that an executable loads only its own."""

from typing import TYPE_CHECKING, Any, Final

from foretouch.doors import Door
from foretouch.errors import ConfigError

if TYPE_CHECKING:
    from foretouch.ros.runtime.lifecycle_node import ForetouchNode

_HERE: Final = "foretouch.ros.nodes"

NODES: Final = Door(
    "foretouch.nodes",
    "node",
    {
        "camera": f"{_HERE}.camera:CameraNode",
        "perception": f"{_HERE}.perception:PerceptionNode",
        "segmentation": f"{_HERE}.perception:SegmentationNode",
        "grasp": f"{_HERE}.perception:GraspNode",
        "touch_predictor": f"{_HERE}.perception:TouchPredictorNode",
        "replay": f"{_HERE}.replay:ReplayNode",
        "recorder": f"{_HERE}.recorder:RecorderNode",
        "bridge": f"{_HERE}.bridge:BridgeNode",
    },
    type,
)
"""The class of each node, a `ForetouchNode`."""


def node_class(name: str) -> "type[ForetouchNode[Any]]":
    """Import the class of a node.

    Raises:
        ConfigError: If there is no such node, it cannot be imported, or it is none of foretouch.
    """
    found: type[Any] = NODES.load(name)
    from foretouch.ros.runtime.lifecycle_node import ForetouchNode

    if not issubclass(found, ForetouchNode):
        raise ConfigError(
            f"node {name}: {found.__name__} is not derived from ForetouchNode (ros.runtime.lifecycle_node)"
        )
    return found
