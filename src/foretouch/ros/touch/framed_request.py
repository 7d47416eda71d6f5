# SPDX-License-Identifier: Apache-2.0
"""Requests in the frame of the answers, brought to the frame of the camera, in which touch is predicted."""

from collections.abc import Sequence
from typing import NamedTuple

from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Plane as PlaneMsg
from std_msgs.msg import Header

from foretouch.ros.messages.clouds import TargetCloud
from foretouch.ros.messages.frames import FrameTransform
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.runtime.output_frame import OutputFrame
from foretouch_msgs.msg import Grasp, Status, TablePlane


class Latest(NamedTuple):
    """The newest object_cloud and the table of the same stamp."""

    cloud: PointCloud2 | TargetCloud
    table: TablePlane


class FramedRequest(NamedTuple):
    """A request in the frame of its cloud."""

    cloud: PointCloud2 | TargetCloud  # of the object
    table: Sequence[PlaneMsg]  # none, or one
    grasps: Sequence[Grasp]  # on the object
    transform: FrameTransform | None  # of the answer; None if it stays in the frame of the cloud


def in_cloud_frame(
    frame: OutputFrame, cloud: PointCloud2, table: Sequence[PlaneMsg], grasps: Sequence[Grasp], latest: Latest | None
) -> FramedRequest:
    """Bring a request to the frame of the camera.

    The header of the cloud gives the frame of cloud, table and grasps: the camera's, or `frame`, that of the answers. A
    cloud that is only a header stands for the latest one, with its table.

    Raises:
        RefusalError: UNKNOWN_FRAME, or EMPTY_CLOUD if there is no latest cloud.
    """
    header = cloud.header
    if header.frame_id and not cloud.fields:
        return _on_latest(frame, header, table, grasps, latest)
    if not frame.name or header.frame_id != frame.name:
        return FramedRequest(cloud, table, grasps, frame.transform(header))
    camera = frame.camera_frame("" if latest is None else latest.cloud.header.frame_id)
    transform = frame.transform(Header(frame_id=camera, stamp=header.stamp))
    if transform is None:  # the frame of the answers is the camera's
        return FramedRequest(cloud, table, grasps, None)
    back = transform.inverse()
    return FramedRequest(back.cloud(cloud), [*map(back.plane, table)], [*map(back.grasp, grasps)], transform)


def _on_latest(
    frame: OutputFrame, header: Header, table: Sequence[PlaneMsg], grasps: Sequence[Grasp], latest: Latest | None
) -> FramedRequest:
    if latest is None:
        raise no_latest_cloud()
    camera = latest.cloud.header
    transform = frame.transform(camera)
    if header.frame_id != camera.frame_id:
        if transform is None or header.frame_id != transform.target:
            known = repr(camera.frame_id) + ("" if transform is None else f" or {transform.target!r}")
            raise RefusalError(Status.UNKNOWN_FRAME, f"cloud: frame {header.frame_id!r} of the request is not {known}")
        back = transform.inverse()
        table, grasps = [*map(back.plane, table)], [*map(back.grasp, grasps)]
    own = [latest.table.plane] if latest.table.status == Status.OK else []
    return FramedRequest(latest.cloud, table or own, grasps, transform)


def no_latest_cloud() -> RefusalError:
    """The refusal of a request that is about the latest cloud before there is one."""
    return RefusalError(Status.EMPTY_CLOUD, "cloud: is empty, and no object_cloud with a table was received yet")
