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
from foretouch.ros.touch.grasp_sampler import Latest
from foretouch_msgs.msg import Grasp, Status


class FramedRequest(NamedTuple):
    """A request in the frame of its cloud.

    Attributes:
        cloud: Of the object.
        table: None, or one.
        grasps: On the object.
        transform: Of the answer; None if it stays in the frame of the cloud.
    """

    cloud: PointCloud2 | TargetCloud
    table: Sequence[PlaneMsg]
    grasps: Sequence[Grasp]
    transform: FrameTransform | None


def in_cloud_frame(
    frame: OutputFrame, cloud: PointCloud2, table: Sequence[PlaneMsg], grasps: Sequence[Grasp], latest: Latest | None
) -> FramedRequest:
    """Bring a request to the frame of the camera.

    The header of the cloud gives the frame of cloud, table and grasps: the camera's, or that of the answers. A cloud
    that is only a header stands for the latest one, with its table.

    Args:
        frame: Of the answers.
        cloud: The cloud of the request.
        table: Its table, if there is one.
        grasps: Its grasps.
        latest: The latest cloud of the graph.

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
    return FramedRequest(back.cloud(cloud), _moved(back, table), [back.grasp(one) for one in grasps], transform)


def _on_latest(
    frame: OutputFrame, header: Header, table: Sequence[PlaneMsg], grasps: Sequence[Grasp], latest: Latest | None
) -> FramedRequest:
    if latest is None:
        raise RefusalError(Status.EMPTY_CLOUD, "cloud: is empty, and no object_cloud with a table was received yet")
    camera = latest.cloud.header
    transform = frame.transform(camera)
    own = [latest.table.plane] if latest.table.status == Status.OK else []
    if header.frame_id == camera.frame_id:
        return FramedRequest(latest.cloud, table or own, grasps, transform)
    if transform is None or header.frame_id != transform.target:
        known = repr(camera.frame_id) + ("" if transform is None else f" or {transform.target!r}")
        raise RefusalError(Status.UNKNOWN_FRAME, f"cloud: frame {header.frame_id!r} of the request is not {known}")
    back = transform.inverse()
    return FramedRequest(latest.cloud, _moved(back, table) or own, [back.grasp(one) for one in grasps], transform)


def _moved(back: FrameTransform, table: Sequence[PlaneMsg]) -> list[PlaneMsg]:
    return [back.plane(one) for one in table]
