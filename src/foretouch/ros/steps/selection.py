# SPDX-License-Identifier: Apache-2.0
"""What a person or another node says about the objects: the topics `mask` and `clicked_point`.

A mask holds the labels of the objects of one image. A point that is clicked in RViz (*Publish Point*) selects an object, which
stays the target by its id until it is gone or another one is clicked. Callbacks only store messages.
"""

import threading
import time
from dataclasses import dataclass
from typing import Any, Final

from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image

from foretouch.cloud.io.mask_files import decode_mask
from foretouch.config import Settings, setting
from foretouch.errors import CloudError
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.stream import Stream
from foretouch.types import AnyArray, Cloud, stamp_ns
from foretouch.types.scene import Scene
from foretouch_msgs.msg import Status

_MASK_TOPIC: Final = "mask"
_CLICK_TOPIC: Final = "clicked_point"
_MASKS: Final = 16  # that wait for the image of their stamp


@dataclass(frozen=True, kw_only=True)
class SelectionSettings(Settings):
    """Settings of masks and clicks."""

    mask: str = setting(
        "none",
        "Labels of the objects on the topic mask: none, objects are found here; same_stamp, each cloud waits for the mask of "
        "its stamp; latest, the last mask is used for every cloud",
        choices=("none", "same_stamp", "latest"),
        read_only=True,
    )
    mask_wait_s: float = setting(1.0, "Longest wait of a cloud for the mask of its stamp", bounds=(0.0, 60.0))
    click_age_s: float = setting(10.0, "Clicked points that are older are refused", bounds=(0.1, 3600.0))


class Selection:
    """Masks and clicks of one stream of clouds.

    Args:
        node: Subscribes; it must be configuring, and its settings are `SelectionSettings`.
        stream: Of the clouds, in which a click selects.
    """

    def __init__(self, node: ForetouchNode[Any], stream: Stream) -> None:
        self._node, self._stream = node, stream
        self._changed = threading.Condition()  # guards what callbacks store
        self._masks: dict[int, Image] = {}  # by stamp
        self._click: PointStamped | None = None  # that no cloud has seen yet
        self._refused = ""  # why the last click selected nothing
        if node.config.mask != "none":
            node.subscribe(InputTopic(_MASK_TOPIC, Image, latched=None), self._receive_mask)
        node.subscribe(InputTopic(_CLICK_TOPIC, PointStamped), self._receive_click)

    def diagnose(self, report: Report) -> None:
        """Report what the last click selected, or why it was refused."""
        if note := self._refused or self._stream.note:
            report.values[_CLICK_TOPIC] = note

    def mask(self, cloud: Cloud) -> AnyArray | None:
        """Find the labels for a cloud; None where objects are found without.

        Raises:
            RefusalError: If there is no mask for it, or it cannot be read or is of another frame.
        """
        config = self._node.config
        if config.mask == "none":
            return None
        with self._changed:
            if config.mask == "latest":
                message = next(reversed(self._masks.values()), None)
            else:
                end = time.monotonic() + config.mask_wait_s
                while cloud.stamp_ns not in self._masks and (left := end - time.monotonic()) > 0.0:
                    self._changed.wait(left)
                message = self._masks.get(cloud.stamp_ns)
        if message is None:
            which = (
                "mask came yet"
                if config.mask == "latest"
                else f"mask of this stamp came within {config.mask_wait_s:g} s"
            )
            raise RefusalError(Status.BAD_REQUEST, f"mask: no {which} on {self._node.resolve_topic_name(_MASK_TOPIC)}")
        if (frame := message.header.frame_id) not in ("", cloud.frame_id):
            rule = f"is not the frame of the image, {cloud.frame_id!r}: label the pixels of the depth image"
            raise RefusalError(Status.UNKNOWN_FRAME, f"mask: frame {frame!r} {rule}")
        try:
            return decode_mask(message)
        except CloudError as err:
            raise RefusalError(Status.BAD_REQUEST, str(err)) from err

    def take_click(self, scene: Scene) -> None:
        """Select the object that was clicked since the scene before, if there is one."""
        with self._changed:
            click, self._click = self._click, None
        if click is not None:
            self._take(click, scene)

    def _take(self, click: PointStamped, scene: Scene) -> None:
        """Select the object at a clicked point, or report why none is selected."""
        try:
            frame = click.header.frame_id
            if frame != scene.cloud.frame_id:
                raise CloudError(
                    f"frame {frame!r} is not the frame of the clouds, {scene.cloud.frame_id!r}; set RViz's fixed frame to it"
                )
            age_s = self._node.age_s(stamp_ns(click.header.stamp))
            if stamp_ns(click.header.stamp) and age_s > self._node.config.click_age_s:
                raise CloudError(f"is {age_s:.0f} s old, more than click_age_s {self._node.config.click_age_s:g}")
            point = [click.point.x, click.point.y, click.point.z]
            tolerance_m = self._node.config.target.tolerance_m
            chosen = scene.near(point, tolerance_m)
        except CloudError as err:
            self._refused = f"refused: {err}"
            self._node.get_logger().warning(f"{_CLICK_TOPIC}: {err}")
            return
        self._refused = ""
        self._stream.select(chosen.id)
        self._node.get_logger().info(f"{_CLICK_TOPIC}: object {chosen.id} is the target")

    def _receive_mask(self, message: Image) -> None:
        with self._changed:
            self._masks.pop(stamp_ns(message.header.stamp), None)
            self._masks[stamp_ns(message.header.stamp)] = message
            while len(self._masks) > _MASKS:
                del self._masks[next(iter(self._masks))]
            self._changed.notify_all()

    def _receive_click(self, message: PointStamped) -> None:
        with self._changed:
            self._click = message
