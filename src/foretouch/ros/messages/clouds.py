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
from typing import Any

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from foretouch.cloud.io.pointcloud2 import encode
from foretouch.cloud.segmentation.objects import ObjectSegment
from foretouch.dataset.messages import decode_objects
from foretouch.pipeline import FoundObject
from foretouch.ros.messages.conversions import header_to_msg, point_to_msg
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Cloud, Plane
from foretouch_msgs.msg import Object


def cloud_to_msg(cloud: Cloud) -> PointCloud2:
    """Convert a cloud to a message of 12 bytes per point, 16 with colour."""
    layout, data = encode(cloud)
    message = PointCloud2(
        header=header_to_msg(cloud.frame_id, cloud.stamp_ns),
        height=layout.height,
        width=layout.width,
        fields=[PointField(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count) for f in layout.fields],
        is_bigendian=layout.is_bigendian,
        point_step=layout.point_step,
        row_step=layout.row_step,
        is_dense=layout.is_dense,
    )
    message.data = data
    return message


def objects_to_msg(targets: Sequence[FoundObject], frame_id: str, nanoseconds: int) -> PointCloud2:
    """Convert the targets, whose ids are integers, to `object_cloud`; without any, to a cloud without points.

    Frame and stamp [ns] are those of the scene's cloud.
    """
    coloured = bool(targets) and all(one.cloud.rgb is not None for one in targets)
    points = np.concatenate([_records(one, coloured=coloured) for one in targets] or [np.empty(0, _record())])
    message = PointCloud2(
        header=header_to_msg(frame_id, nanoseconds),
        height=1,
        width=len(points),
        fields=_fields(points.dtype),
        point_step=points.dtype.itemsize,
        row_step=points.nbytes,
        is_dense=True,
    )
    # An array.array is stored as it is; a NumPy array would be checked byte by byte.
    message.data = array.array("B", points.tobytes())
    return message


@dataclass(eq=False)
class TargetCloud:
    """An `object_cloud` for subscribers of this process, which use the targets themselves."""

    header: Header  # of the scene's cloud
    targets: Sequence[FoundObject]  # best first

    @cached_property
    def message(self) -> PointCloud2:
        """The message for all others, made when it is first needed."""
        return objects_to_msg(self.targets, self.header.frame_id, stamp_ns(self.header.stamp))


def object_to_msg(segment: ObjectSegment, *, target: bool) -> Object:
    """Convert an object with the indices of its points; grasps are planned on a `target` only."""
    low, high = segment.bounds
    return Object(
        id=str(segment.id),
        n_points=segment.n_points,
        centroid=point_to_msg(segment.centroid),
        minimum=point_to_msg(low),
        maximum=point_to_msg(high),
        target=target,
        indices=array.array("I", segment.pixels.astype(np.uint32).tobytes()),
    )


def objects_from_msg(message: PointCloud2 | TargetCloud, plane: Plane) -> tuple[FoundObject, ...]:
    """The reverse of `objects_to_msg`; also reads any cloud of one object, and raises as `decode_cloud`."""
    return tuple(
        FoundObject(one.id, one.cloud, plane, one.pixels, one.image_shape)
        for one in (message.targets if isinstance(message, TargetCloud) else decode_objects(message))
    )


def _record(*, coloured: bool = False, imaged: bool = False) -> np.dtype[Any]:
    rgb, pixel = [("rgb", "<u4")] if coloured else [], [("row", "<u2"), ("column", "<u2")] if imaged else []
    return np.dtype([*((name, "<f4") for name in "xyz"), *rgb, ("label", "<u4"), *pixel])


def _records(target: FoundObject, *, coloured: bool) -> npt.NDArray[Any]:
    imaged = target.pixels is not None and target.image_shape is not None
    records = np.empty(target.cloud.size, _record(coloured=coloured, imaged=imaged))
    for i, name in enumerate("xyz"):
        records[name] = target.cloud.xyz[:, i]
    if coloured and target.cloud.rgb is not None:
        r, g, b = target.cloud.rgb.T.astype(np.uint32)
        records["rgb"] = (r << 16) | (g << 8) | b
    records["label"] = int(target.id)
    if target.pixels is not None and target.image_shape is not None:
        records["row"], records["column"] = np.divmod(target.pixels, target.image_shape[1])
    return records


def _fields(record: np.dtype[Any]) -> list[PointField]:
    codes = {"<f4": PointField.FLOAT32, "<u4": PointField.UINT32, "<u2": PointField.UINT16}
    floats = {"rgb": PointField.FLOAT32}  # PCL and RViz expect packed colours to be declared as such
    return [
        PointField(name=name, offset=offset, datatype=floats.get(name, codes[kind.str]), count=1)
        for name, (kind, offset, *_) in (record.fields or {}).items()
    ]
