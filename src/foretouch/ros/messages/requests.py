# SPDX-License-Identifier: Apache-2.0
"""Read what other nodes send, or refuse it with a status."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Plane as PlaneMsg
from std_msgs.msg import Header

from foretouch.cloud.geometry.limits import ObjectLimits, check_object
from foretouch.cloud.messages import decode_objects, decode_plane
from foretouch.errors import CloudError, DatasetError, ForetouchError, FrameError, LimitError
from foretouch.grasp import Obstacles
from foretouch.grasp.messages import STATUSES, decode_grasps
from foretouch.grasp.pose import joined_faults
from foretouch.ros.messages.conversions import obstacles_from_msg
from foretouch.ros.messages.placement import Placement, moved_grasp
from foretouch.types import ASSUMED_TABLE, Float64, Grasps, Plane, assumed_table
from foretouch.types.arrays import Bool, objects
from foretouch.types.grasps import contact_faults
from foretouch.types.rotations import rotation_faults
from foretouch.types.scene import Object
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TablePlane

_CODES = {name: code for code, name in STATUSES.items()}
_M = TypeVar("_M")
Place: TypeAlias = Callable[[Header, str], Placement]


def status_code(name: str) -> int:
    """Convert the name of a status to its number in `foretouch_msgs/Status`; FAILED for one without a number."""
    return _CODES.get(name, Status.FAILED)


def status_name(code: int) -> str:
    """Convert the number of a status to its name."""
    return STATUSES.get(code, f"status {code}")


class RefusalError(ForetouchError):
    """An input cannot be answered: a status of `foretouch_msgs/Status`, not OK, and the reason as text."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status
        self.reason = str(self)


class Targets(NamedTuple):
    """The objects of one cloud, on which requests have grasps planned or predicted."""

    header: Header  # of the cloud
    objects: tuple[Object, ...]
    refusal: RefusalError | None = None  # why their table is not known
    placement: Placement | None = None  # of what is answered; None for the frame of the cloud

    @property
    def answered_in(self) -> Placement:
        """The frame of the answer, which is also that of the grasps of a request."""
        return self.placement or Placement(self.header)


@dataclass(frozen=True, eq=False)
class RequestedGrasps:
    """The grasps of a request, which gives them as messages or as arrays."""

    grasps: Grasps  # K rows; NaN where one cannot be read, and an orientation of no meaning where it is not given
    turned: Bool  # (K,) which have an orientation
    reasons: list[str]  # why a grasp cannot be read; "" if it can
    messages: Sequence[GraspMsg] | None = None  # as they came; None for arrays

    @classmethod
    def of_messages(cls, messages: Sequence[GraspMsg]) -> "RequestedGrasps":
        """Read grasps from messages, each of which may be refused."""
        return cls(*decode_grasps(messages), messages)

    @classmethod
    def of_arrays(cls, request: Any) -> "RequestedGrasps":
        """Read grasps from the arrays of a `PredictTouch.Request`; a `RefusalError`, BAD_REQUEST, if their sizes differ."""
        contacts, rotations = (np.array(values, np.float64) for values in (request.contacts, request.rotations))
        if len(request.grasps):
            raise RefusalError(Status.BAD_REQUEST, "contacts: grasps are given too")
        count = contacts.size // 6
        for name, array, size in (("contacts", contacts, 6), ("rotations", rotations, 9)):
            if array.size % size or array.size // size not in {0, count}:
                expected = f"{count} x 9" if size == 9 else "a multiple of 6"
                raise RefusalError(Status.BAD_REQUEST, f"{name}: {array.size} numbers are not {expected}")
        given = rotations.size > 0
        turned = rotations.reshape(-1, 3, 3) if given else np.tile(np.eye(3), (count, 1, 1))
        g1, g2 = contacts.reshape(-1, 2, 3).swapaxes(0, 1)
        names = [f"{request.id}/{k}" if request.id else "" for k in range(count)]
        faults = joined_faults(contact_faults(g1, g2, turned), rotation_faults(turned))
        turned[[bool(fault) for fault in faults]] = np.nan  # what is no rotation
        grasps = Grasps(g1, g2, turned, id=objects(names), object_id=objects([request.object_id] * count))
        return cls(grasps, np.full(count, given), faults)

    def moved(self, pose: Float64 | None) -> "RequestedGrasps":
        """Return the same grasps in another frame, in which `pose` (4, 4) is the frame of these; None changes nothing."""
        if pose is None:
            return self
        messages = None if self.messages is None else [moved_grasp(message, pose) for message in self.messages]
        return replace(self, grasps=self.grasps.moved(pose), messages=messages)


@contextmanager
def _refused_as(status: int) -> Iterator[None]:
    try:
        yield
    except CloudError as err:
        raise RefusalError(status, str(err)) from err


def read_serialized(data: bytes, kind: type[_M]) -> _M:
    """Deserialise a message of a raw subscription, whose bytes nobody has checked.

    Args:
        data: The message in CDR.
        kind: Its class.

    Raises:
        DatasetError: If the bytes are no such message.
    """
    try:
        message: _M = deserialize_message(data, kind)
    except Exception as err:  # rclpy declares no type for it
        raise DatasetError(f"{kind.__name__}: {len(data)} bytes cannot be deserialized: {err}") from err
    return message


def read_targets(message: PointCloud2, plane: Plane, limits: ObjectLimits) -> tuple[Object, ...]:
    """Convert a cloud of objects, which must hold at least one.

    Args:
        message: An `object_cloud`, or any cloud of one object.
        plane: Table of the objects, in the frame of the cloud.
        limits: Of objects; an object within them must be in an optical frame.

    Raises:
        RefusalError: BAD_CLOUD, EMPTY_CLOUD, or UNKNOWN_FRAME with a reason that holds `not_optical`.
    """
    with _refused_as(Status.BAD_CLOUD):
        targets = decode_objects(message, plane)
    if not targets:
        raise RefusalError(Status.EMPTY_CLOUD, "cloud: holds no finite point")
    for target in targets:
        try:
            check_object(target.cloud.xyz, limits)
        except FrameError as err:
            raise RefusalError(Status.UNKNOWN_FRAME, f"cloud: frame {target.cloud.frame_id!r}: {err}") from err
        except LimitError:
            continue  # refused where it is planned or predicted, so that the other objects are answered
    return targets


def read_plane(message: PlaneMsg) -> Plane:
    """Convert a plane; a `RefusalError`, BAD_PLANE, if a number is not finite or all are zero."""
    with _refused_as(Status.BAD_PLANE):
        plane = decode_plane(message)
    if plane is None:
        raise RefusalError(Status.BAD_PLANE, "table: holds no plane")
    return plane


def read_objects(message: PointCloud2, table: TablePlane, limits: ObjectLimits) -> tuple[Object, ...]:
    """Convert objects with their table and what stands around them.

    Args:
        message: The objects.
        table: Of the same cloud.
        limits: Of objects.

    Raises:
        RefusalError: As `read_table`, then as `read_targets`.
    """
    plane, obstacles = read_table(table, message.header)
    return tuple(replace(target, obstacles=obstacles) for target in read_targets(message, plane, limits))


def read_table(table: TablePlane, header: Header) -> tuple[Plane, Obstacles | None]:
    """Convert a table and what stands around the targets.

    Args:
        table: The message.
        header: Of the cloud.

    Raises:
        RefusalError: As the table's sender has refused; BAD_PLANE; UNKNOWN_FRAME; BAD_REQUEST if the fields of the obstacles
            do not fit each other.
    """
    if table.status != Status.OK:
        raise passed_on("table", table.status, table.reason)
    check_frames("table", table.header, header)
    plane = read_plane(table.plane)
    with _refused_as(Status.BAD_REQUEST):
        return plane, obstacles_from_msg(table)


def requested_targets(request: Any, latest: Targets | None, limits: ObjectLimits, place: Place) -> Targets:
    """Convert cloud and table of a request; a cloud without points stands for the latest one, with its table.

    The answer is in the frame that the header of the request names, and without one in that of the other results. A cloud without a
    table stands on a level one where it is known what is up.

    Args:
        request: Holds a `cloud`, and a `table` with one plane or none.
        latest: The newest objects, if there are any.
        limits: Of objects.
        place: Finds the frame of the results of a cloud, by its header and the name of the frame, "" for that of all results.

    Raises:
        RefusalError: As `read_targets` and `read_plane`; EMPTY_CLOUD before the first cloud, UNKNOWN_FRAME if nothing transforms
            the latest to the frame of the header, or why the latest has no objects.
    """
    cloud, table = request.cloud, request.table
    plane = read_plane(table[0]) if table else None
    if cloud.width * cloud.height or len(cloud.data):
        targets = read_targets(cloud, plane or ASSUMED_TABLE, limits)
        up = None if table else _up(cloud.header, place)
        if up is not None:
            targets = tuple(replace(target, plane=assumed_table(target.cloud, up)) for target in targets)
        known = bool(table) or up is not None
        unknown = None if known else RefusalError(Status.BAD_PLANE, "table: is needed with a cloud")
        return Targets(cloud.header, targets, unknown)
    if latest is None:
        raise RefusalError(Status.EMPTY_CLOUD, "cloud: is empty, and no object_cloud with a table was received yet")
    if not latest.objects and latest.refusal is not None:
        raise latest.refusal
    if cloud.header.frame_id:
        latest = latest._replace(placement=place(latest.header, cloud.header.frame_id))
    if plane is None:
        return latest
    if (back := latest.answered_in.back) is not None:
        plane = plane.moved(back)
    return latest._replace(objects=tuple(replace(target, plane=plane) for target in latest.objects), refusal=None)


def _up(cloud: Header, place: Place) -> Float64 | None:
    """Return (3,) what is up in the frame of a cloud; None where that is not known."""
    try:
        return place(cloud, "").up
    except RefusalError:
        return None


def passed_on(name: str, status: int, reason: str) -> RefusalError:
    """Make the refusal of a message whose sender has refused the cloud; it has a reason in any case.

    Args:
        name: What the message is called in the reason.
        status: Of the message.
        reason: Of the message.
    """
    if status not in STATUSES:
        return RefusalError(Status.BAD_REQUEST, f"{name}: status {status} is unknown")
    return RefusalError(status, reason or f"{name}: status {status_name(status)} without a reason")


def check_frames(name: str, header: Header, cloud: Header) -> None:
    """Require that a message is in the frame of its cloud.

    Args:
        name: What the message is called in the reason.
        header: Of the message.
        cloud: Header of the cloud.

    Raises:
        RefusalError: UNKNOWN_FRAME.
    """
    if header.frame_id != cloud.frame_id:
        raise RefusalError(
            Status.UNKNOWN_FRAME, f"{name}: frame {header.frame_id!r} is not the cloud's, {cloud.frame_id!r}"
        )
