# SPDX-License-Identifier: Apache-2.0
"""`sensor_msgs/PointCloud2` to clouds and back, and the layout of `object_cloud`.

`object_cloud` holds the points of all targets, one after the other, best first. Besides x, y, z (and rgb)
each point has `label` (UINT32, the object's id), `row` and `column` (UINT16, its pixel in the image that
it was cut from), so that later steps can separate the objects and search neighbours by pixel. A cloud
without these fields is one object without an image.
"""

import array
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from foretouch.cloud.io.pointcloud2 import encode
from foretouch.cloud.messages import decode_objects
from foretouch.cloud.segmentation.objects import ObjectSegment
from foretouch.pipeline import Object
from foretouch.ros.messages.conversions import header_to_msg, point_to_msg
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import AnyArray, Cloud, Plane
from foretouch_msgs.msg import Object as ObjectMsg


def cloud_to_msg(cloud: Cloud, **columns: AnyArray) -> PointCloud2:
    """Convert a cloud to a message of 12 bytes per point, 16 with colour, and further columns (see `encode`)."""
    content = vars(encode(cloud, **columns))
    data, fields = content.pop("data"), [PointField(**vars(field)) for field in content.pop("fields")]
    message = PointCloud2(header=header_to_msg(cloud.frame_id, cloud.stamp_ns), fields=fields, **content)
    message._data = data  # noqa: SLF001  its setter copies, byte by byte
    return message


def objects_to_msg(targets: Sequence[Object], frame_id: str, nanoseconds: int) -> PointCloud2:
    """Convert the targets, whose ids are integers, to `object_cloud`; without any, to a cloud without points.

    Frame and stamp [ns] are those of the scene's cloud.
    """
    colours = [one.cloud.rgb for one in targets if one.cloud.rgb is not None]
    pixels = [
        np.divmod(one.pixels, one.image_shape[1]) for one in targets if one.pixels is not None and one.image_shape
    ]
    xyz = np.concatenate([one.cloud.xyz for one in targets] or [np.empty((0, 3), np.float32)])
    rgb = np.concatenate(colours) if targets and len(colours) == len(targets) else None
    ids, sizes = [int(one.id) for one in targets], [one.cloud.size for one in targets]
    columns = {"label": np.repeat(np.array(ids, np.uint32), sizes or 1)}  # NumPy refuses an empty list of counts
    if pixels:
        rows, places = map(np.concatenate, zip(*pixels, strict=True))
        columns |= {"row": rows.astype(np.uint16), "column": places.astype(np.uint16)}
    return cloud_to_msg(Cloud(xyz, rgb, frame_id, nanoseconds), **columns)


@dataclass(eq=False)
class TargetCloud:
    """An `object_cloud` for subscribers of this process, which use the targets themselves."""

    header: Header  # of the scene's cloud
    targets: Sequence[Object]  # best first

    @cached_property
    def message(self) -> PointCloud2:
        """The message for all others, made when it is first needed."""
        return objects_to_msg(self.targets, self.header.frame_id, stamp_ns(self.header.stamp))


def object_to_msg(segment: ObjectSegment, *, target: bool) -> ObjectMsg:
    """Convert an object with the indices of its points; grasps are planned on a `target` only."""
    low, high = segment.bounds
    return ObjectMsg(
        id=str(segment.id),
        n_points=segment.n_points,
        centroid=point_to_msg(segment.centroid),
        minimum=point_to_msg(low),
        maximum=point_to_msg(high),
        target=target,
        indices=array.array("I", segment.pixels.astype(np.uint32).tobytes()),
    )


def objects_from_msg(message: PointCloud2 | TargetCloud, plane: Plane) -> tuple[Object, ...]:
    """The reverse of `objects_to_msg`; also reads any cloud of one object, and raises as `decode_cloud`."""
    return tuple(
        Object(one.id, one.cloud, plane, one.pixels, one.image_shape)
        for one in (message.targets if isinstance(message, TargetCloud) else decode_objects(message))
    )
