# SPDX-License-Identifier: Apache-2.0
"""Depth images, clouds and objects to messages."""

import array
import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any, Final

import numpy as np
from geometry_msgs.msg import Pose, Vector3
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header

from foretouch.camera.stream import DepthFrame
from foretouch.cloud.io.pointcloud2 import encode
from foretouch.cloud.messages import join_objects
from foretouch.report.overlay import marked
from foretouch.ros.messages.conversions import header_to_msg, point_to_msg
from foretouch.ros.messages.placement import Placement
from foretouch.types import AnyArray, Cloud, Float64, Grasp, UInt8
from foretouch.types.camera import MODELS
from foretouch.types.cloud import DepthCloud
from foretouch.types.scene import Object, Scene
from foretouch_msgs.msg import Object as ObjectMsg

_MILLIMETRE: Final = 1e-3  # [m], the unit of 16UC1
_LARGEST_LABEL: Final = 65535  # of 16UC1
_SHADES: Final = np.interp(  # brightness by depth [mm]
    np.log(np.maximum(np.arange(_LARGEST_LABEL + 1), 1)), np.log([250.0, 4000.0]), (230.0, 30.0)
).astype(np.uint8)
_SHADES[0] = 0  # no depth
_WIDEST: Final = 480  # pixels of an overlay
_TARGET: Final = np.int32(180)  # share of the colour of an object over the image, of 255
_OTHER: Final = np.int32(90)
_OBJECT_RGB: Final = np.array(  # by id
    [(255, 128, 0), (0, 166, 214), (230, 0, 126), (122, 184, 0), (143, 79, 209), (217, 179, 0), (0, 168, 143)], np.int32
)


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
    depth, encoding = frame.depth.astype("<u2", copy=False), "16UC1"
    if round(frame.scale_m, 9) != _MILLIMETRE:
        depth, encoding = (frame.depth * np.float32(frame.scale_m)).astype("<f4"), "32FC1"
        depth[frame.depth == 0] = np.nan  # as REP 118 has it for floats
    image = _image(header, depth, encoding)
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


def colours_to_msg(header: Header, rgb: UInt8) -> Image:
    """Convert colours (H, W, 3) uint8 to rgb8."""
    return _image(header, rgb, "rgb8")


def _image(header: Header, pixels: AnyArray, encoding: str) -> Image:
    """Make an image of (H, W) or (H, W, C) numbers in the byte order of this machine, or little-endian ones."""
    pixels = np.ascontiguousarray(pixels)
    height, width = pixels.shape[:2]
    step = pixels.nbytes // max(1, height)
    return Image(header=header, height=height, width=width, encoding=encoding, step=step, data=_bytes(pixels))


def labels_to_msg(scene: Scene, header: Header) -> Image:
    """Convert the labels of the pixels to 16UC1: the id of the object, 0 for none; ids begin again after 65535."""
    labels = np.atleast_2d(scene.labels)
    if labels.max(initial=0) > _LARGEST_LABEL:
        labels = np.where(labels > 0, (labels - 1) % _LARGEST_LABEL + 1, 0)
    return _image(header, labels.astype("<u2"), "16UC1")


def overlay_to_msg(scene: Scene, header: Header, grasp: Grasp | None = None) -> Image:
    """Draw the objects with their ids over the image, rgb8, and a grasp with its hand, if there is one.

    Targets have their full colour, others are paler. The image has its colours, or is the brighter the nearer. Of an image that is wider than 480 pixels, every second, third, ... row and column is drawn: it is to be looked at.
    """
    labels = np.atleast_2d(scene.labels)
    shape, step = labels.shape, -(-labels.shape[1] // _WIDEST)
    labels = np.ascontiguousarray(labels[::step, ::step])
    drawn = np.empty((*labels.shape, 3), np.uint8)
    if scene.cloud.rgb is not None:
        drawn[...] = scene.cloud.rgb.reshape(*shape, 3)[::step, ::step]
    else:
        grey = _SHADES.take(np.atleast_2d(_millimetres(scene.cloud))[::step, ::step])
        for channel in range(3):
            drawn[..., channel] = grey
    pixels, flat = np.flatnonzero(labels > 0), drawn.reshape(-1, 3)
    ids = labels.reshape(-1)[pixels]
    shares = np.where(np.isin(ids, [int(target.id) for target in scene.targets]), _TARGET, _OTHER)[:, None]
    border = np.flatnonzero(_borders(labels))
    flat[pixels] = ((255 - shares) * flat[pixels] + shares * _OBJECT_RGB[ids % len(_OBJECT_RGB)]) // 255
    flat[border] = _OBJECT_RGB[labels.reshape(-1)[border] % len(_OBJECT_RGB)]
    return _image(header, marked(drawn, scene, step, grasp), "rgb8")


def _borders(labels: AnyArray) -> AnyArray:
    """Return (H, W) which pixels of objects have one of another label below or beside them."""
    border = np.zeros(labels.shape, np.bool_)
    across, along = labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1]
    border[:, 1:] |= across
    border[:, :-1] |= across
    border[1:] |= along
    border[:-1] |= along
    return border & (labels > 0)


def _millimetres(cloud: Cloud) -> AnyArray:
    """Return the depth of all points, uint16; 0 without, and beyond 65 m."""
    image = cloud.image if isinstance(cloud, DepthCloud) else None
    if image is not None and (received := image.millimetres) is not None:
        return received
    depth = cloud.xyz[..., 2]
    return np.where((depth > 0.0) & (depth < _LARGEST_LABEL * _MILLIMETRE), depth / _MILLIMETRE, 0.0).astype(np.uint16)


def objects_to_msg(targets: Sequence[Object], frame_id: str, nanoseconds: int) -> PointCloud2:
    """Convert targets to `object_cloud`; without any, to a cloud without points.

    Args:
        targets: Objects whose ids are integers.
        frame_id: Frame of the scene's cloud.
        nanoseconds: Stamp of the scene's cloud [ns].
    """
    cloud, columns = join_objects(targets, frame_id, nanoseconds)
    return cloud_to_msg(cloud, **columns)


def object_to_msg(object_: Object, placement: Placement, *, target: bool) -> ObjectMsg:
    """Convert an object with the indices of its points.

    Args:
        object_: The object.
        placement: Of the result.
        target: Whether grasps are planned on it.
    """
    low, high = _bounds(object_, placement)
    return ObjectMsg(
        id=object_.id,
        n_points=object_.n_points,
        centroid=point_to_msg(placement.points(object_.centroid)),
        minimum=point_to_msg(low),
        maximum=point_to_msg(high),
        target=target,
        confidence=math.nan if object_.confidence is None else object_.confidence,
        indices=array.array("I", object_.pixels.astype(np.uint32).tobytes()),
    )


def detections_to_msg(objects: Sequence[Object], placement: Placement, kinds: ModuleType) -> Any:
    """Convert objects to a `vision_msgs/Detection3DArray`: boxes along the axes of the frame.

    Args:
        objects: All that are on the table, named by their ids; nothing says what they are.
        placement: Of the result.
        kinds: The module `vision_msgs.msg`, which may not be installed.
    """
    detections = []
    for object_ in objects:
        low, high = _bounds(object_, placement)
        x, y, z = map(float, high - low)
        centre = Pose(position=point_to_msg((low + high) / 2.0))
        result = kinds.ObjectHypothesisWithPose()
        result.hypothesis.class_id = "object"
        result.hypothesis.score = 1.0 if object_.confidence is None else object_.confidence
        result.pose.pose = Pose(position=point_to_msg(placement.points(object_.centroid)))
        box = kinds.BoundingBox3D(center=centre, size=Vector3(x=x, y=y, z=z))
        detections.append(kinds.Detection3D(header=placement.header, results=[result], bbox=box, id=object_.id))
    return kinds.Detection3DArray(header=placement.header, detections=detections)


def _bounds(object_: Object, placement: Placement) -> Float64:
    """Return (2, 3) the smallest and the largest coordinates of an object in the frame of the results [m]."""
    if placement.pose is None or not len(object_.cloud.finite):
        return object_.bounds
    points = placement.points(object_.cloud.finite)
    return np.stack([points.min(axis=0), points.max(axis=0)])
