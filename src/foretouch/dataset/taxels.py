# SPDX-License-Identifier: Apache-2.0
"""The readings of a sample as clouds of taxels, which viewers draw without knowing the sensor.

One `sensor_msgs/PointCloud2` for each reading and finger, in the frame of the sample's cloud, with the fingertip at its
contact: x, y, z [m] of the 24 electrodes, and one FLOAT32 field for each channel [counts]. Channels of the whole finger,
such as pdc, have one value in all points.
"""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Final, NamedTuple

import numpy as np

from foretouch.dataset.bag import POINT_CLOUD_TYPE
from foretouch.dataset.messages import header_fields, with_stamp
from foretouch.dataset.record import SampleRecord, TouchSeries, readings
from foretouch.dataset.recording.sample_codec import sample_types
from foretouch.grasp.pose import electrodes_at
from foretouch.tactile import columns
from foretouch.topics import TAXELS
from foretouch.types import AnyArray, Float32

TAXEL_TOPICS: Final = {"TH": f"{TAXELS}thumb", "MF": f"{TAXELS}middle_finger"}
_FLOAT32: Final = 7  # of sensor_msgs/PointField


class TaxelCloud(NamedTuple):
    """One message."""

    topic: str
    stamp_ns: int  # of the reading [ns]
    data: bytes  # CDR with its encapsulation header


def taxel_clouds(record: SampleRecord) -> Iterator[TaxelCloud]:
    """The readings around a grasp in their order, the thumb's first; of a sample without a series its touch, if any."""
    sample, series = record.sample, readings(record)
    if series is None:
        return
    for finger, contact in (("TH", sample.grasp.g1), ("MF", sample.grasp.g2)):
        xyz = electrodes_at(sample.grasp, contact).astype(np.float32)
        fields = dict(zip("xyz", xyz.T, strict=True)) | _channels(series, finger)
        points = np.stack(np.broadcast_arrays(*fields.values()), axis=-1, dtype="<f4")
        head, tail = _template(sample.cloud.frame_id, list(fields), points[0])
        for stamp_ns, one in zip(series.stamps_ns.tolist(), points, strict=True):
            yield TaxelCloud(TAXEL_TOPICS[finger], stamp_ns, with_stamp(head, stamp_ns) + one.tobytes() + tail)


def _channels(series: TouchSeries, finger: str) -> dict[str, Float32]:
    """Channels of a finger by name, (T, 24) or (T, 1)."""
    suffix = f"_{finger}"
    others = {name.removesuffix(suffix).lower(): one for name, one in series.others.items() if name.endswith(suffix)}
    electrodes, pdc = (series.counts[:, columns([name + suffix])] for name in ("E", "PDC"))
    return {"electrode": electrodes, "pdc": pdc, **{name: values[:, None] for name, values in sorted(others.items())}}


def _template(frame_id: str, names: list[str], points: AnyArray) -> tuple[bytes, bytes]:
    """What stands before and after the data of a message: all messages of a finger differ in stamp and data alone."""
    count, channels = points.shape
    message = SimpleNamespace(
        header=header_fields(0, frame_id, "stamp"),
        height=1,
        width=count,
        fields=[SimpleNamespace(name=name, offset=4 * k, datatype=_FLOAT32, count=1) for k, name in enumerate(names)],
        is_bigendian=False,
        point_step=4 * channels,
        row_step=points.nbytes,
        data=np.zeros(points.nbytes, np.uint8),
        is_dense=True,
    )
    data = bytes(sample_types().store.serialize_cdr(message, POINT_CLOUD_TYPE))
    end = len(data) - 1  # the last byte is `is_dense`
    return data[: end - points.nbytes], data[end:]
