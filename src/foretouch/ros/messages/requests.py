# SPDX-License-Identifier: Apache-2.0
"""Messages that others sent, read or refused with the status that answers them."""

from __future__ import annotations

from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Plane as PlaneMsg
from std_msgs.msg import Header

from foretouch.errors import CloudError
from foretouch.pipeline import FoundObject
from foretouch.ros.messages.clouds import cloud_from_msg, objects_from_msg
from foretouch.ros.messages.conversions import plane_from_msg
from foretouch.ros.messages.status import RefusalError
from foretouch.types import Cloud, Plane
from foretouch_msgs.msg import Status, TablePlane

__all__ = ["check_frames", "read_cloud", "read_plane", "read_table", "read_targets"]


def read_cloud(message: PointCloud2) -> Cloud:
    """A cloud.

    Raises:
        RefusalError: BAD_CLOUD, if its sizes do not add up.
    """
    try:
        return cloud_from_msg(message)
    except CloudError as err:
        raise RefusalError(Status.BAD_CLOUD, str(err)) from err


def read_targets(message: PointCloud2, plane: Plane) -> tuple[FoundObject, ...]:
    """The objects in a cloud of objects, at least one.

    Raises:
        RefusalError: BAD_CLOUD or EMPTY_CLOUD.
    """
    try:
        targets = objects_from_msg(message, plane)
    except CloudError as err:
        raise RefusalError(Status.BAD_CLOUD, str(err)) from err
    if not targets:
        raise RefusalError(Status.EMPTY_CLOUD, "cloud: holds no finite point")
    return targets


def read_plane(message: PlaneMsg) -> Plane:
    """A plane.

    Raises:
        RefusalError: BAD_PLANE, if a number is not finite or all are zero.
    """
    try:
        plane = plane_from_msg(message)
    except CloudError as err:
        raise RefusalError(Status.BAD_PLANE, str(err)) from err
    if plane is None:
        raise RefusalError(Status.BAD_PLANE, "table: holds no plane")
    return plane


def read_table(message: TablePlane, header: Header) -> Plane:
    """The table of a cloud.

    Args:
        message: The table.
        header: Of the cloud.

    Raises:
        RefusalError: What the table says is missing, BAD_PLANE, or UNKNOWN_FRAME.
    """
    if message.status != Status.OK:
        raise RefusalError(message.status, message.reason)
    check_frames("table", message.header, header)
    return read_plane(message.plane)


def check_frames(name: str, header: Header, cloud: Header) -> None:
    """Whether what comes with a cloud is in its frame.

    Raises:
        RefusalError: UNKNOWN_FRAME.
    """
    if header.frame_id != cloud.frame_id:
        raise RefusalError(
            Status.UNKNOWN_FRAME, f"{name}: frame {header.frame_id!r} is not the cloud's, {cloud.frame_id!r}"
        )
