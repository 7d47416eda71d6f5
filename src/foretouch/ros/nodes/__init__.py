# SPDX-License-Identifier: Apache-2.0
"""The nodes of a robot; that of the simulated hand is in the laboratory."""

from typing import Any, Final

from foretouch.ros.nodes.bridge import BridgeNode
from foretouch.ros.nodes.camera import CameraNode
from foretouch.ros.nodes.perception import PerceptionNode
from foretouch.ros.nodes.recorder import RecorderNode
from foretouch.ros.nodes.replay import ReplayNode
from foretouch.ros.nodes.single_steps import GraspNode, SegmentationNode, TouchPredictorNode
from foretouch.ros.runtime.lifecycle_node import ForetouchNode

NODE_CLASSES: Final[dict[str, type[ForetouchNode[Any]]]] = {
    "camera": CameraNode,
    "perception": PerceptionNode,
    "segmentation": SegmentationNode,
    "grasp": GraspNode,
    "touch_predictor": TouchPredictorNode,
    "replay": ReplayNode,
    "recorder": RecorderNode,
    "bridge": BridgeNode,
}
"""By name, which is that of the node in a graph."""
