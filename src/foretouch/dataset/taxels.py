# SPDX-License-Identifier: Apache-2.0
"""The readings of a sample as clouds of taxels, which viewers draw without knowing the sensor.

One `sensor_msgs/PointCloud2` for each reading and finger, in the frame of the sample's cloud, with the fingertip at its
contact: x, y, z [m] of the taxels, and one FLOAT32 field for each channel. Channels of the whole finger, such as pdc, have
one value in all points.
"""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Final

import numpy as np

from foretouch.cloud.io.pointcloud2 import PointCloud2Layout, PointField
from foretouch.cloud.messages import header_fields, with_stamp
from foretouch.dataset.bag import POINT_CLOUD_TYPE
from foretouch.dataset.record import SampleRecord, TouchSeries, readings
from foretouch.dataset.recording.sample_codec import sample_types
from foretouch.dataset.topics import TAXELS
from foretouch.grasp.pose import taxels_at
from foretouch.tactile.channels import finger_label
from foretouch.tactile.description import Sensor
from foretouch.types import AnyArray, Float32

_FLOAT32: Final = 7  # of sensor_msgs/PointField


def finger_key(finger: str) -> str:
    """Name of a finger in topics and columns, such as middle_finger."""
    return finger_label(finger).replace(" ", "_")


def channel_key(channel: str) -> str:
    """Name of a channel in fields and columns, such as pdc and electrode; x, y and z are the coordinates of a taxel."""
    name = channel.lower()
    return {"e": "electrode", **{axis: f"taxel_{axis}" for axis in "xyz"}}.get(name, name)


def taxel_clouds(record: SampleRecord, sensor: Sensor) -> Iterator[tuple[str, int, bytes]]:
    """The readings around a grasp in order, those at g1 first; of a sample without a series its touch, if any.

    Yields:
        Topic, stamp of the reading [ns], and message: CDR with its encapsulation header.
    """
    sample, series = record.sample, readings(record)
    if series is None:
        return
    for finger, contact in zip(sensor.channels.fingers, (sample.grasp.g1, sample.grasp.g2), strict=True):
        xyz = taxels_at(sensor.layout, sample.grasp, contact).astype(np.float32)
        fields = dict(zip("xyz", xyz.T, strict=True)) | _channels(series, finger, sensor)
        points = np.stack(np.broadcast_arrays(*fields.values()), axis=-1, dtype="<f4")
        head, tail = _template(sample.cloud.frame_id, list(fields), points[0])
        for stamp_ns, one in zip(series.stamps_ns.tolist(), points, strict=True):
            yield TAXELS + finger_key(finger), stamp_ns, with_stamp(head, stamp_ns) + one.tobytes() + tail


def _channels(series: TouchSeries, finger: str, sensor: Sensor) -> dict[str, Float32]:
    """Channels of a finger by name, (T, N) or (T, 1), those of taxels first."""
    suffix, channels = f"_{finger}", sensor.channels
    others = {
        channel_key(name.removesuffix(suffix)): one for name, one in series.others.items() if name.endswith(suffix)
    }
    ordered = sorted(channels.channels, key=lambda one: one.size == 1)
    own = {channel_key(one.name): series.counts[:, channels.columns([one.name + suffix])] for one in ordered}
    return own | {name: values[:, None] for name, values in sorted(others.items()) if name not in own}


def _template(frame_id: str, names: list[str], points: AnyArray) -> tuple[bytes, bytes]:
    """What stands before and after the data of a message: all messages of a finger differ in stamp and data alone."""
    count, channels = points.shape
    fields = tuple(PointField(name, 4 * k, _FLOAT32) for k, name in enumerate(names))
    step = 4 * channels
    layout = PointCloud2Layout(
        height=1, width=count, fields=fields, point_step=step, row_step=points.nbytes, is_dense=True
    )
    header, zeros = header_fields(0, frame_id, "stamp"), np.zeros(points.nbytes, np.uint8)
    message = SimpleNamespace(header=header, data=zeros, **vars(layout))
    data = bytes(sample_types().store.serialize_cdr(message, POINT_CLOUD_TYPE))
    end = len(data) - 1  # the last byte is `is_dense`
    return data[: end - points.nbytes], data[end:]
