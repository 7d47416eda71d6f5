# SPDX-License-Identifier: Apache-2.0
"""The nodes by name. Each is imported when it is asked for, so that an executable loads only its own."""

from typing import Final

from foretouch.doors import Door

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
