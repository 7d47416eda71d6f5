# SPDX-License-Identifier: Apache-2.0
"""Depth images, clouds and objects to messages."""

import array
from collections.abc import Sequence
from typing import Final

import numpy as np
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField

from foretouch.camera.stream import DepthFrame
from foretouch.cloud.io.pointcloud2 import encode
from foretouch.cloud.messages import join_objects
from foretouch.ros.messages.conversions import header_to_msg, point_to_msg
from foretouch.types import AnyArray, Cloud
from foretouch.types.camera import MODELS
from foretouch.types.scene import Object
from foretouch_msgs.msg import Object as ObjectMsg

_MILLIMETRE: Final = 1e-3  # [m], the unit of 16UC1


def cloud_to_msg(cloud: Cloud, **columns: AnyArray) -> PointCloud2:
    """Convert a cloud to a message of 12 bytes per point, 16 with colour.

    Args:
        cloud: The cloud.
        columns: Further numbers of each point (see `encode`).
    """
    content = vars(encode(cloud, **columns))
    data, fields = content.pop("data"), [PointField(**vars(field)) for field in content.pop("fields")]
    header = header_to_msg(cloud.frame_id, cloud.stamp_ns)
    return PointCloud2(header=header, fields=fields, data=_bytes(data), **content)


def _bytes(numbers: AnyArray) -> "array.array[int]":
    """Contiguous numbers in the only type that rclpy takes over without looking at each byte."""
    data = array.array("B")
    data.frombytes(numbers.data.cast("B"))
    return data


def depth_to_msgs(frame: DepthFrame) -> tuple[Image, CameraInfo]:
    """Convert a depth image to 16UC1 in millimetres, or 32FC1 in metres where its unit is another, and its camera."""
    header, camera = header_to_msg(frame.frame_id, frame.stamp_ns), frame.camera
    height, width = frame.depth.shape
    depth, encoding = frame.depth.astype("<u2", copy=False), "16UC1"
    if round(frame.scale_m, 9) != _MILLIMETRE:
        depth, encoding = (frame.depth * np.float32(frame.scale_m)).astype("<f4"), "32FC1"
    image = Image(
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        step=width * depth.itemsize,
        data=_bytes(np.ascontiguousarray(depth)),
    )
    d = [*camera.distortion, *[0.0] * (5 - len(camera.distortion))]
    info = CameraInfo(
        header=header,
        height=camera.height,
        width=camera.width,
        distortion_model=MODELS[len(d) > 5],
        d=[*d, *[0.0] * (8 - len(d))] if len(d) > 5 else d,
        k=camera.matrix.ravel(),
        r=np.eye(3).ravel(),
        p=np.insert(camera.matrix.ravel(), [3, 6, 9], 0.0),
    )
    return image, info


def objects_to_msg(targets: Sequence[Object], frame_id: str, nanoseconds: int) -> PointCloud2:
    """Convert targets to `object_cloud`; without any, to a cloud without points.

    Args:
        targets: Objects whose ids are integers.
        frame_id: Frame of the scene's cloud.
        nanoseconds: Stamp of the scene's cloud [ns].
    """
    cloud, columns = join_objects(targets, frame_id, nanoseconds)
    return cloud_to_msg(cloud, **columns)


def object_to_msg(object_: Object, *, target: bool) -> ObjectMsg:
    """Convert an object with the indices of its points.

    Args:
        object_: The object.
        target: Whether grasps are planned on it.
    """
    low, high = object_.bounds
    return ObjectMsg(
        id=object_.id,
        n_points=object_.n_points,
        centroid=point_to_msg(object_.centroid),
        minimum=point_to_msg(low),
        maximum=point_to_msg(high),
        target=target,
        indices=array.array("I", object_.pixels.astype(np.uint32).tobytes()),
    )
