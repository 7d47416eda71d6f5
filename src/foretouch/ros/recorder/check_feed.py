# SPDX-License-Identifier: Apache-2.0
"""Gives the messages that the recorder receives to a check, and records nothing."""

import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from foretouch.cloud.io.depth_messages import CameraInfos
from foretouch.cloud.messages import decode_cloud, decode_objects, decode_plane, read_header
from foretouch.dataset.session_check import SessionCheck
from foretouch.errors import ForetouchError
from foretouch.ros.messages.requests import read_serialized
from foretouch.ros.recorder.subscriptions import MessageQueue, RecorderInputs
from foretouch.ros.runtime.subscription import SerializedMessage
from foretouch.tactile.messages.table import TactileReader
from foretouch.types import Cloud
from foretouch_msgs.msg import TablePlane

_IMAGES = (Image, CompressedImage)
_QUEUE_BYTES = 500_000_000
_CLOUDS = 5  # of the camera that are kept until the object's cloud of the same stamp comes


class CheckFeed:
    """Receives until `close`; messages that cannot be decoded are counted.

    Args:
        check: Gets the messages.
        inputs: What is received.
        reader: Of the hand's messages.
    """

    def __init__(self, check: SessionCheck, inputs: RecorderInputs, reader: TactileReader) -> None:
        self._check = check
        self._inputs = inputs
        self._reader = reader
        self._clouds: OrderedDict[int, SerializedMessage] = OrderedDict()  # or depth images
        images = (name for name, topic in inputs.topics.items() if topic.message in _IMAGES)
        self._infos = CameraInfos(next(images, ""))
        self._queue = MessageQueue(_QUEUE_BYTES)
        inputs.open(self._queue)

    def receive(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Give messages to the check.

        Args:
            seconds: For how long [s].
            done: Ends it before, once it is true.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end and not done():
            for message in self._queue.take(0.05)[0]:
                try:
                    self._add(message)
                except ForetouchError as err:
                    self._check.add_unreadable(message.topic, str(err))

    def close(self) -> None:
        """Receive no more."""
        self._inputs.close()

    def _add(self, message: SerializedMessage) -> None:
        topic, check = self._inputs.topics[message.topic], self._check
        match topic.role:
            case "info":
                self._infos.add(read_serialized(message.data, CameraInfo), time.monotonic())
            case "scene":
                stamp, _ = read_header(message.data)
                check.add_message("camera", message.received_ns, stamp)
                self._clouds[stamp] = message
                if len(self._clouds) > _CLOUDS:
                    self._clouds.popitem(last=False)
            case "table":
                check.table = decode_plane(read_serialized(message.data, TablePlane).plane)
            case "cloud":
                scene = self._clouds.get(read_header(message.data)[0])
                objects = decode_objects(read_serialized(message.data, PointCloud2))
                if scene is not None and objects:
                    check.scene = self._scene(scene).xyz
                    check.targets = [object_.cloud.xyz for object_ in objects]
            case "tactile":
                reading = self._reader.read(read_serialized(message.data, topic.message))
                check.add_reading(reading, message.received_ns)

    def _scene(self, message: SerializedMessage) -> Cloud:
        kind = self._inputs.topics[message.topic].message
        content: Any = read_serialized(message.data, kind)
        return self._infos.cloud(content, time.monotonic()) if kind in _IMAGES else decode_cloud(content)
