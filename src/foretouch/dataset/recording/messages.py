# SPDX-License-Identifier: Apache-2.0
"""A grasp to the bytes of a `foretouch_msgs/GraspSample` and back, without ROS.

The last 32 bytes are the SHA-256 of all before, so that a sample can be proven intact wherever its bytes lie.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from foretouch import __version__
from foretouch.cloud.pointcloud2 import PointCloud2Layout, PointField, decode, encode
from foretouch.dataset.recording.definitions import Definitions
from foretouch.dataset.recording.record import Identity, Outcome, SampleRecord, TouchSeries, check_name
from foretouch.errors import DatasetError, ForetouchError
from foretouch.grasp.pose import quaternion_xyzw
from foretouch.types import TOUCH_SIZE, Cloud, Grasp, GraspSample, Touch

__all__ = [
    "ABOUT",
    "ACCOUNTS",
    "SAMPLE_TOPIC",
    "SAMPLE_TYPE",
    "SCHEMA_VERSION",
    "StoredSample",
    "check_id",
    "decode_sample",
    "encode_sample",
    "is_intact",
]

SAMPLE_TYPE: Final = "foretouch_msgs/msg/GraspSample"
SAMPLE_TOPIC: Final = "/foretouch/samples"
ABOUT: Final = "foretouch"  # metadata of a file: versions, hand, camera
ACCOUNTS: Final = "foretouch_accounts"  # metadata of a file, the last counts
SCHEMA_VERSION: Final = 1

_DIGEST_SIZE: Final = 32
_OUTCOMES: Final[tuple[Outcome, ...]] = ("unknown", "success", "failure")
_NS: Final = 1_000_000_000
_STAMP_END_NS: Final = 2**31 * _NS


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredSample:
    """A sample as it was read back.

    Attributes:
        record: The sample.
        identity: Hand and camera that it was recorded with.
        foretouch: Version that wrote it.
    """

    record: SampleRecord
    identity: Identity
    foretouch: str


def check_id(sample_id: str, label: str) -> None:
    """Refuse an id that is not `<object>/<name>`.

    Raises:
        DatasetError: Names the rule.
    """
    head, slash, name = sample_id.partition("/")
    if not slash or head != label:
        raise DatasetError(f"id: {sample_id[:200]!r} is not {label[:100]!r}, a slash and a name")
    check_name(head, "object")
    check_name(name, "id")


def encode_sample(record: SampleRecord, identity: Identity) -> bytes:
    """CDR of a `foretouch_msgs/GraspSample`, encapsulation header included.

    Args:
        record: With its id.
        identity: Hand and camera.

    Raises:
        DatasetError: If the id, a stamp or a number cannot be kept: nothing that is not finite, scores of grasps aside.
    """
    sample = record.sample
    check_id(sample.id, sample.object)
    series = record.series
    others = {} if series is None else dict(sorted(series.others.items()))
    extra = {name: float(value) for name, value in sorted(sample.extra.items())}
    message = SimpleNamespace(
        header=_header(sample.stamp_ns, sample.cloud.frame_id, "stamp_ns"),
        schema_version=SCHEMA_VERSION,
        id=sample.id,
        object=sample.object,
        outcome=_OUTCOMES.index(record.outcome),
        note=record.note,
        cloud=_cloud_fields(sample.cloud),
        grasp=_grasp_fields(sample.grasp),
        score=float(sample.grasp.score),
        candidates=[_grasp_fields(grasp) for grasp in record.candidates],
        **_touch_fields(sample.touch, "labelled", ""),
        **_touch_fields(sample.tare, "tared", "tare_"),
        series_stamps=np.asarray([] if series is None else series.stamps_ns, np.int64),
        series_phase=np.asarray([] if series is None else series.phases, np.uint8),
        series=np.asarray([] if series is None else series.counts, np.float32).ravel(),
        other_names=list(others),
        others=np.concatenate([*others.values(), np.empty(0)]).astype(np.float32),
        contact=record.contact_ns or 0,
        detector=record.detector,
        pairing_error=-1 if record.pairing_error_ns is None else record.pairing_error_ns,
        flags=list(record.flags),
        extra_names=list(extra),
        extra_values=np.array(list(extra.values()), np.float64),
        foretouch=__version__,
        hand=_facts(identity.hand),
        camera=_facts(identity.camera),
        sha256=np.zeros(_DIGEST_SIZE, np.uint8),
    )
    _require_finite(message)
    body = bytes(_definitions().store.serialize_cdr(message, SAMPLE_TYPE))[:-_DIGEST_SIZE]
    return body + hashlib.sha256(body).digest()


def is_intact(data: bytes | memoryview) -> bool:
    """Whether the bytes are those that `encode_sample` gave."""
    return len(data) > _DIGEST_SIZE and hashlib.sha256(data[:-_DIGEST_SIZE]).digest() == bytes(data[-_DIGEST_SIZE:])


def decode_sample(data: bytes | memoryview) -> StoredSample:
    """The sample in a message.

    Returns:
        The cloud and the series look into `data`.

    Raises:
        DatasetError: If the bytes are damaged, of another schema version, or break a rule.
    """
    if not is_intact(data):
        raise DatasetError("damaged: the bytes are not those that their SHA-256 was taken of")
    try:
        message: Any = _definitions().store.deserialize_cdr(data, SAMPLE_TYPE)
        if message.schema_version != SCHEMA_VERSION:
            raise DatasetError(_other_version(message.schema_version))
        check_id(message.id, message.object)
        return _stored(message)
    except ForetouchError as err:
        raise DatasetError(str(err)) from err
    except Exception as err:  # whatever the parser trips over, for the digest says nothing of who wrote it
        raise DatasetError(f"damaged: {type(err).__name__}: {' '.join(str(err).split())}") from err


def _other_version(version: int) -> str:
    newer = "newer than" if version > SCHEMA_VERSION else "not"
    return f"schema_version: {version} is {newer} {SCHEMA_VERSION}, the one that foretouch {__version__} reads"


def _stored(message: Any) -> StoredSample:
    cloud = _cloud(message.cloud)
    sample = GraspSample(
        id=message.id,
        object=message.object,
        cloud=cloud,
        grasp=_grasp(message.grasp, float(message.score)),
        touch=_touch(message, "labelled", ""),
        tare=_touch(message, "tared", "tare_"),
        stamp_ns=_stamp_ns(message.header),
        extra=dict(zip(message.extra_names, map(float, message.extra_values), strict=True)),
    )
    record = SampleRecord(
        sample=sample,
        candidates=tuple(_grasp(grasp, float(grasp.score)) for grasp in message.candidates),
        outcome=_OUTCOMES[message.outcome],
        note=message.note,
        series=_series(message),
        contact_ns=message.contact or None,
        detector=message.detector,
        pairing_error_ns=None if message.pairing_error < 0 else message.pairing_error,
        flags=tuple(message.flags),
    )
    identity = Identity(hand=json.loads(message.hand), camera=json.loads(message.camera))
    return StoredSample(record=record, identity=identity, foretouch=message.foretouch)


@functools.cache
def _definitions() -> Definitions:
    definitions = Definitions()
    definitions.text(SAMPLE_TYPE)
    return definitions


def _facts(facts: Mapping[str, str]) -> str:
    return json.dumps(dict(sorted(facts.items())), ensure_ascii=False)


def _header(stamp_ns: int, frame_id: str, name: str) -> SimpleNamespace:
    if not 0 <= stamp_ns < _STAMP_END_NS:
        raise DatasetError(f"{name}: {stamp_ns} is before 1970 or after 2038, where the stamps of ROS end")
    seconds, nanoseconds = divmod(int(stamp_ns), _NS)
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * _NS + int(header.stamp.nanosec)


def _cloud_fields(cloud: Cloud) -> SimpleNamespace:
    layout, data = encode(cloud)
    return SimpleNamespace(
        header=_header(cloud.stamp_ns, cloud.frame_id, "cloud.stamp_ns"),
        height=layout.height,
        width=layout.width,
        fields=[
            SimpleNamespace(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count) for f in layout.fields
        ],
        is_bigendian=layout.is_bigendian,
        point_step=layout.point_step,
        row_step=layout.row_step,
        data=np.frombuffer(data, np.uint8),
        is_dense=layout.is_dense,
    )


def _cloud(message: Any) -> Cloud:
    layout = PointCloud2Layout(
        height=message.height,
        width=message.width,
        fields=tuple(PointField(f.name, f.offset, f.datatype, f.count) for f in message.fields),
        is_bigendian=bool(message.is_bigendian),
        point_step=message.point_step,
        row_step=message.row_step,
    )
    xyz, rgb = decode(layout, message.data)
    return Cloud(xyz, rgb, message.header.frame_id, _stamp_ns(message.header))


def _grasp_fields(grasp: Grasp) -> SimpleNamespace:
    x, y, z, w = map(float, quaternion_xyzw(grasp.rotation))
    return SimpleNamespace(
        id=grasp.id,
        object_id=grasp.object_id,
        g1=_point(grasp.g1),
        g2=_point(grasp.g2),
        pose=SimpleNamespace(position=_point(grasp.midpoint), orientation=SimpleNamespace(x=x, y=y, z=z, w=w)),
        rotation=np.ascontiguousarray(grasp.rotation.reshape(9), np.float64),
        score=float(grasp.score),
        status=0,
        reason="",
    )


def _grasp(message: Any, score: float) -> Grasp:
    g1, g2 = (np.array([point.x, point.y, point.z], np.float64) for point in (message.g1, message.g2))
    rotation = np.asarray(message.rotation, np.float64).reshape(3, 3)
    return Grasp(g1, g2, rotation, score, message.id, message.object_id)


def _point(position: Any) -> SimpleNamespace:
    x, y, z = map(float, position)
    return SimpleNamespace(x=x, y=y, z=z)


def _touch_fields(touch: Touch | None, flag: str, prefix: str) -> dict[str, Any]:
    vector = np.zeros(TOUCH_SIZE) if touch is None else touch.vector()
    values = Touch.from_vector(vector)
    names = ("pdc_th", "pdc_mf", "e_th", "e_mf")
    return {flag: touch is not None, **{f"{prefix}{name}": getattr(values, name) for name in names}}


def _touch(message: Any, flag: str, prefix: str) -> Touch | None:
    if not getattr(message, flag):
        return None
    pdc_th, pdc_mf, e_th, e_mf = (getattr(message, f"{prefix}{name}") for name in ("pdc_th", "pdc_mf", "e_th", "e_mf"))
    return Touch(float(pdc_th), float(pdc_mf), np.asarray(e_th, np.float64), np.asarray(e_mf, np.float64))


def _series(message: Any) -> TouchSeries | None:
    length = len(message.series_stamps)
    if length == 0:
        return None
    others = np.asarray(message.others, np.float32).reshape(len(message.other_names), length)
    return TouchSeries(
        stamps_ns=np.asarray(message.series_stamps, np.int64),
        counts=np.asarray(message.series, np.float32).reshape(length, TOUCH_SIZE),
        phases=np.asarray(message.series_phase, np.uint8),
        others=dict(zip(message.other_names, others, strict=True)),
    )


def _require_finite(message: SimpleNamespace) -> None:
    for name in ("e_th", "e_mf", "pdc_th", "pdc_mf", "tare_e_th", "tare_e_mf", "tare_pdc_th", "tare_pdc_mf", "series"):
        if not np.isfinite(getattr(message, name)).all():
            raise DatasetError(f"{message.id}: {name}: holds a value that is not finite")
    for name in ("others", "extra_values"):
        if not np.isfinite(getattr(message, name)).all():
            raise DatasetError(f"{message.id}: {name}: holds a value that is not finite")
