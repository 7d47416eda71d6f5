# SPDX-License-Identifier: Apache-2.0
"""Encodes a recorded grasp as a message and decodes it, without ROS.

The message is a `foretouch_msgs/GraspSample`, which holds the description of its sensor. Version 2 of foretouch 0.3 and 0.4 lacks the table,
which is then not known. Foretouch 0.2 wrote samples of version 1, whose touch is of the BioTac SP and states no sensor; `dataset import` converts them, everything else refuses them.

The last 32 bytes are the SHA-256 of all bytes before them, so that a sample can be verified at any position in a file.

Definitions of message types are found without ROS, since a recording stores them beside the messages. Search order:
ROS 2 Kilted as included in `rosbags`, the folder `definitions` with the types of samples, whose fields never change, then
every installed message package on `AMENT_PREFIX_PATH` and in the Python environment.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import re
import struct
import sys
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from foretouch import __version__
from foretouch.base.files import TEXT_LIMIT, parse_json, read_bytes
from foretouch.cloud.messages import cloud_fields, decode_cloud, header_fields
from foretouch.dataset.files import require_version
from foretouch.dataset.identity import Identity, check_id
from foretouch.dataset.recordings.bag import POINT_CLOUD_TYPE, types_in
from foretouch.errors import DatasetError, ForetouchError, VersionError, described, shown
from foretouch.grasp.messages import decode_grasp, encode_grasp
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.dead_taxels import is_storable
from foretouch.tactile.description import Sensor, require_same, sensor_of
from foretouch.types import OUTCOMES, Cloud, Grasp, Plane, Sample, Touch, TouchSeries, stamp_ns
from foretouch.types.channels import Channels

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

SAMPLE_TYPE: Final = "foretouch_msgs/msg/GraspSample"
SAMPLE_TYPES: Final = (SAMPLE_TYPE, "foretouch_msgs/msg/TactileSample")  # the second in recordings of version 1
SAMPLE_TOPIC: Final = "/foretouch/samples"
ABOUT: Final = "foretouch"  # name of the metadata with versions, hand and camera
COUNTS: Final = "foretouch_accounts"  # name of the metadata with the message counts; the last one is valid
SCHEMA_VERSION: Final = 3
READ_VERSIONS: Final = (SCHEMA_VERSION, 2)
OLD_VERSION: Final = (
    "schema_version: 1 is of foretouch 0.2: convert it with `foretouch dataset import OLD -o NEW` of version 0.3"
)

_OWN: Final = Path(__file__).parent / "definitions"
_DIGEST_SIZE: Final = 32
_EMPTY: Final = bytes(4)  # a field without elements in CDR
_READINGS: Final = ("touch", "tare", "series")
_FINITE: Final = (*_READINGS, "others", "extra_values")


class StoredSample(NamedTuple):
    """A decoded sample, and hand, camera and sensor that it was recorded with."""

    sample: Sample
    identity: Identity
    sensor: Sensor


def encode_sample(sample: Sample, identity: Identity, sensor: Sensor | None = None) -> bytes:
    """Return a record as the CDR of a `SAMPLE_TYPE` with encapsulation header (see `sample_fields`)."""
    try:
        message = sample_fields(sample, identity, sensor or BIOTAC_SP)
        body = bytes(sample_types().store.serialize_cdr(message, SAMPLE_TYPE))[:-_DIGEST_SIZE]
    except UnicodeEncodeError as err:
        raise DatasetError(
            f"{sample.id}: {shown(err.object)} holds half of a surrogate pair, which is no text"
        ) from err
    except (TypeError, AttributeError, ValueError, OverflowError, struct.error) as err:
        raise DatasetError(
            f"{shown(sample.id)}: a field is of another type than `Sample` states: {described(err)}"
        ) from err
    return body + hashlib.sha256(body).digest()


def sample_fields(sample: Sample, identity: Identity, sensor: Sensor) -> SimpleNamespace:
    """Return a record, whose id is set, as the fields of a `SAMPLE_TYPE`.

    Args:
        sample: The sample.
        identity: Hand and camera.
        sensor: Which was read.

    Raises:
        DatasetError: If the id or a stamp is invalid, or a number other than a grasp's score is not finite.
        TactileError: If the touch is of another sensor.
    """
    check_id(sample.id, sample.object)
    series = sample.series
    for name, touch in (("touch", sample.touch), ("tare", sample.tare)):
        if touch is not None:
            require_same(touch.channels, sensor.channels, f"{sample.id}: {name}")
    if series is not None and series.counts.shape[1] != sensor.channels.size:
        raise DatasetError(f"{sample.id}: series: {series.counts.shape[1]} values, not {sensor.channels.size}")
    others = {} if series is None else dict(sorted(series.others.items()))
    extra = {name: float(value) for name, value in sorted(sample.extra.items())}
    message = SimpleNamespace(
        header=header_fields(sample.stamp_ns, sample.cloud.frame_id, "stamp_ns"),
        schema_version=SCHEMA_VERSION,
        id=sample.id,
        object=sample.object,
        outcome=OUTCOMES.index(sample.outcome),
        note=sample.note,
        cloud=cloud_fields(sample.cloud, "cloud.stamp_ns"),
        grasp=encode_grasp(sample.grasp),
        score=float(sample.grasp.score),
        candidates=[encode_grasp(grasp) for grasp in sample.candidates],
        sensor=_sensor_text(sensor),
        labelled=sample.touch is not None,
        touch=np.empty(0) if sample.touch is None else sample.touch.values,
        tared=sample.tare is not None,
        tare=np.empty(0) if sample.tare is None else sample.tare.values,
        series_stamps=np.asarray([] if series is None else series.stamps_ns, np.int64),
        series_phase=np.asarray([] if series is None else series.phases, np.uint8),
        series=np.asarray([] if series is None else series.counts, np.float32).ravel(),
        other_names=list(others),
        others=np.concatenate([*others.values(), np.empty(0)]).astype(np.float32),
        contact=sample.contact_ns or 0,
        detector=sample.detector,
        pairing_error=-1 if sample.pairing_error_ns is None else sample.pairing_error_ns,
        flags=list(sample.flags),
        extra_names=list(extra),
        extra_values=np.array(list(extra.values()), np.float64),
        foretouch=__version__,
        hand=_properties_text(identity.hand),
        camera=_properties_text(identity.camera),
        table=np.empty(0) if sample.table is None else sample.table.coefficients,
        sha256=np.zeros(_DIGEST_SIZE, np.uint8),
    )
    _require_finite(message, sensor.channels)
    return message


def _require_finite(message: SimpleNamespace, channels: Channels) -> None:
    """Refuse numbers that are not finite, but for NaN of taxels that were not read."""
    for name in _FINITE:
        values = np.asarray(getattr(message, name, 0.0))
        if name in _READINGS and values.size:
            finite = is_storable(values.reshape(-1, channels.size), channels)
        else:
            finite = bool(np.isfinite(values).all())
        if not finite:
            raise DatasetError(f"{message.id}: {name}: holds a value that is not finite")


def serialize_cloud(cloud: Cloud) -> bytes:
    """Return a cloud as the CDR of a `sensor_msgs/PointCloud2` with encapsulation header; a `DatasetError` for its stamp."""
    return bytes(sample_types().store.serialize_cdr(cloud_fields(cloud), POINT_CLOUD_TYPE))


def decode_sample(data: bytes | memoryview, sensor: Sensor | None = None) -> StoredSample:
    """Decode a sample; its cloud and series are views of `data`.

    Args:
        data: The message.
        sensor: That it must be of, if any.

    Raises:
        DatasetError: If the bytes are damaged, of another schema version or sensor, or break a rule.
    """
    body, digest = data[:-_DIGEST_SIZE], bytes(data[-_DIGEST_SIZE:])
    if not body or hashlib.sha256(body).digest() != digest:
        raise DatasetError("damaged: the bytes do not match their SHA-256")
    try:
        version = _version_in(data)
        if version == 1:
            raise VersionError(OLD_VERSION)
        require_version(version, *READ_VERSIONS)
        message: Any = sample_types().store.deserialize_cdr(_current(data, version), SAMPLE_TYPE)
        check_id(message.id, message.object)
        stored = stored_sample(message)
    except VersionError:
        raise
    except ForetouchError as err:
        raise DatasetError(str(err)) from err
    except Exception as err:  # the digest does not prove that foretouch wrote it: the parser may fail anywhere
        raise DatasetError(f"damaged: {described(err)}") from err
    if sensor is not None and stored.sensor.sha256 != sensor.sha256:
        names = [
            f"{described_sensor.config.name} ({described_sensor.sha256[:8]})"
            for described_sensor in (stored.sensor, sensor)
        ]
        raise DatasetError(f"is of {names[0]}, and the dataset of {names[1]}")
    return stored


def _version_in(data: bytes | memoryview) -> int:
    """Return the schema version of a serialised sample; a `struct.error` if the bytes end before."""
    (frame,) = struct.unpack_from("<I", data, 12)  # length of the frame, after the stamp
    offset = 12 + frame
    return int(struct.unpack_from("<H", data, 4 + offset + offset % 2)[0])


def _current(data: bytes | memoryview, version: int) -> bytes | memoryview:
    """Return a serialised sample with the field that version 2 lacks, empty."""
    if version == SCHEMA_VERSION:
        return data
    body = bytes(data[:-_DIGEST_SIZE])
    return body + bytes(-len(body) % 4) + _EMPTY + bytes(data[-_DIGEST_SIZE:])


def stored_sample(message: Any) -> StoredSample:
    """Make the sample of a decoded message, of which `sample_fields` are the fields; raises any error for values that break a rule."""
    sensor = _parse_sensor(message.sensor)
    sample = Sample(
        id=message.id,
        object=message.object,
        cloud=decode_cloud(message.cloud),
        grasp=_grasp_of(message.grasp, float(message.score)),
        touch=Touch(np.array(message.touch, np.float64), sensor.channels) if message.labelled else None,
        tare=Touch(np.array(message.tare, np.float64), sensor.channels) if message.tared else None,
        stamp_ns=stamp_ns(message.header.stamp),
        extra=dict(zip(message.extra_names, map(float, message.extra_values), strict=True)),
        candidates=tuple(_grasp_of(grasp, float(grasp.score)) for grasp in message.candidates),
        outcome=OUTCOMES[message.outcome],
        note=message.note,
        series=_series_of(message, sensor),
        contact_ns=message.contact or None,
        detector=message.detector,
        pairing_error_ns=None if message.pairing_error < 0 else message.pairing_error,
        flags=tuple(message.flags),
        table=Plane(np.array(message.table[:3], np.float64), float(message.table[3])) if len(message.table) else None,
    )
    identity = Identity(hand=_parse_properties(message.hand), camera=_parse_properties(message.camera))
    return StoredSample(sample, identity, sensor)


def _parse_properties(text: str) -> dict[str, str]:
    """Read the properties of a hand or a camera from JSON; a `DatasetError` if the text is none."""
    facts = parse_json(text)
    if not isinstance(facts, dict) or not all(isinstance(value, str) for value in facts.values()):
        raise DatasetError("hand, camera: is not a list of named texts")
    return facts


@functools.cache
def sample_types() -> Definitions:
    """Return the definitions of samples, of all types in them, and of those that were looked up since."""
    definitions = Definitions()
    definitions.text(SAMPLE_TYPE)
    return definitions


def _properties_text(facts: Mapping[str, str]) -> str:
    """Return the properties of a hand or a camera as JSON; equal ones give equal text."""
    return json.dumps(dict(sorted(facts.items())), ensure_ascii=False)


def _grasp_of(message: Any, score: float) -> Grasp:
    """Return the grasp in a decoded `foretouch_msgs/Grasp`, whose rotation is taken as it is."""
    return decode_grasp(message, np.asarray(message.rotation, np.float64).reshape(3, 3), score)


@functools.lru_cache(maxsize=16)
def _sensor_text(sensor: Sensor) -> str:
    """Return the description of a sensor as JSON."""
    return json.dumps(sensor.to_mapping(), ensure_ascii=False, sort_keys=True)


@functools.lru_cache(maxsize=16)
def _parse_sensor(text: str) -> Sensor:
    """Read the description of a sensor from JSON; a `DatasetError` or a `ConfigError` if the text is none."""
    return sensor_of(parse_json(text), "sensor")


def _series_of(message: Any, sensor: Sensor) -> TouchSeries | None:
    """Return the series in a sample as views of the message; None if it is empty."""
    length = len(message.series_stamps)
    if length == 0:
        return None
    others = np.asarray(message.others, np.float32).reshape(len(message.other_names), length)
    return TouchSeries(
        stamps_ns=np.asarray(message.series_stamps, np.int64),
        counts=np.asarray(message.series, np.float32).reshape(length, sensor.channels.size),
        phases=np.asarray(message.series_phase, np.uint8),
        others=dict(zip(message.other_names, others, strict=True)),
    )


class Definitions:
    """Message types, looked up on request; `store` holds those found so far, and serialises their messages."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store: Typestore = get_typestore(Stores.ROS2_KILTED)

    def register(self, type_name: str, text: str) -> None:
        """Register a type by the text of its `.msg` file, which definitions of the types in it may follow, as in MCAP.

        Raises a `DatasetError` if the text is not a definition, or contradicts a registered one.
        """
        from rosbags.typesys import TypesysError, get_types_from_msg

        try:
            self.store.register(get_types_from_msg(text, type_name))
        except TypesysError as err:
            raise DatasetError(f"{type_name}: {' '.join(str(err).split())}") from err

    def text(self, type_name: str) -> str:
        """Return the definition with the definitions of all types in it (`ros2msg`); a `DatasetError` if one cannot be found."""
        self._require(type_name)
        return self.store.generate_msgdef(type_name, ros_version=2)[0]

    def _require(self, type_name: str) -> None:
        if type_name not in self.store.fielddefs:
            if not re.fullmatch(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", type_name):
                raise DatasetError(f"{type_name!r} is not a message type, such as std_msgs/msg/String")
            self.register(type_name, _find(type_name))
        for needed in types_in(self.store.fielddefs[type_name][1]):
            self._require(needed)


def _find(type_name: str) -> str:
    package, _, name = type_name.split("/")
    if package == "foretouch_msgs" and (_OWN / f"{name}.msg").is_file():
        return read_bytes(_OWN / f"{name}.msg").decode("utf-8")
    for prefix in [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]:
        file = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if file.is_file():
            return read_bytes(file, TEXT_LIMIT).decode("utf-8")
    raise DatasetError(f"{type_name}: no definition is known, and {package} is not installed")
