# SPDX-License-Identifier: Apache-2.0
"""The camera's clouds -> `objects`, `table`, `object_cloud` alone, for who plans grasps with a node of another package."""

from dataclasses import dataclass
from typing import Any

from foretouch.ros.messages.requests import status_code
from foretouch.ros.runtime.processing_node import Input, ProcessingConfig, ProcessingNode
from foretouch.ros.steps.camera_input import CameraInput, CameraInputSettings
from foretouch.ros.steps.segmentation import SegmentationSettings, SegmentationStep


@dataclass(frozen=True, kw_only=True)
class SegmentationNodeConfig(ProcessingConfig, CameraInputSettings, SegmentationSettings):
    """Settings of the segmentation node."""


class SegmentationNode(ProcessingNode[SegmentationNodeConfig]):
    """Runs the step of the segmentation."""

    exclusive_topics = ("objects",)

    def __init__(self, **options: Any) -> None:
        super().__init__("segmentation", SegmentationNodeConfig, **options)

    def _setup(self) -> None:
        self._step = SegmentationStep(self)  # before subscribing, so that no answer is lost
        self._camera = CameraInput(self, self._receive)
        self.steps = (self._step, self._camera)

    def _answer(self, item: Input) -> tuple[int, str]:
        cloud = self._camera.cloud(item.content)
        scene = self._step.segment(cloud)
        self._step.publish(item.header, scene)
        return status_code(scene.status), scene.reason
