# SPDX-License-Identifier: Apache-2.0
"""Encodes a recorded grasp as a message and decodes it, without ROS.

The message is a `foretouch_msgs/GraspSample` for the BioTac SP, and for any other sensor a `foretouch_msgs/TactileSample`, which
holds the sensor's description.

The last 32 bytes are the SHA-256 of all bytes before them, so that a sample can be verified at any position in a file.

Definitions of message types are found without ROS, since a recording stores them beside the messages. Search order:
ROS 2 Kilted as included in `rosbags`, the texts in the folder `definitions` (copies of those in `foretouch_msgs`), then
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
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import numpy as np

from foretouch import __version__
from foretouch.checked_files import parse_json
from foretouch.dataset.files import require_version
from foretouch.dataset.messages import cloud_fields, decode_cloud, decode_grasp, grasp_fields, header_fields
from foretouch.dataset.record import Identity, Outcome, SampleRecord, TouchSeries, check_id
from foretouch.errors import DatasetError, ForetouchError, VersionError, described
from foretouch.tactile import TOUCH_SIZE, biotac_touch
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor, require_same, sensor_of
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Grasp, GraspSample, Touch

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

SAMPLE_TYPE: Final = "foretouch_msgs/msg/GraspSample"
TACTILE_SAMPLE_TYPE: Final = "foretouch_msgs/msg/TactileSample"
SAMPLE_TYPES: Final = (TACTILE_SAMPLE_TYPE, SAMPLE_TYPE)
SAMPLE_TOPIC: Final = "/foretouch/samples"
ABOUT: Final = "foretouch"  # name of the metadata with versions, hand and camera
COUNTS: Final = "foretouch_accounts"  # name of the metadata with the message counts; the last one is valid
SCHEMA_VERSION: Final = 1
HEAD_SIZE: Final = 65536
"""Bytes at the beginning of a serialised sample that hold its frame and its id."""

_OWN: Final = Path(__file__).parent / "definitions"
_DIGEST_SIZE: Final = 32
OUTCOMES: Final[tuple[Outcome, ...]] = ("unknown", "success", "failure")
_TOUCH: Final = ("pdc_th", "pdc_mf", "e_th", "e_mf")
_PREFIX: Final = {"touch": "", "tare": "tare_"}
_VALUES: Final = (*(f"{one}{name}" for one in _PREFIX.values() for name in _TOUCH), *_PREFIX)
_FINITE: Final = (*_VALUES, "series", "others", "extra_values")


class StoredSample(NamedTuple):
    """A decoded sample, and hand, camera and sensor that it was recorded with."""

    record: SampleRecord
    identity: Identity
    sensor: Sensor


def sample_type(sensor: Sensor) -> str:
    """Type of the messages that hold samples of a sensor."""
    return SAMPLE_TYPE if sensor.is_biotac else TACTILE_SAMPLE_TYPE


def encode_sample(record: SampleRecord, identity: Identity, sensor: Sensor | None = None) -> bytes:
    """A record, whose id is set, as the CDR of the sensor's `sample_type` with encapsulation header.

    Args:
        record: The sample.
        identity: Hand and camera.
        sensor: Which was read; by default the BioTac SP.

    Raises:
        DatasetError: If the id or a stamp is invalid, or a number other than a grasp's score is not finite.
        TactileError: If the touch is of another sensor.
    """
    sample, sensor = record.sample, sensor or BIOTAC_SP
    check_id(sample.id, sample.object)
    type_name, series = sample_type(sensor), record.series
    for name, touch in (("touch", sample.touch), ("tare", sample.tare)):
        if touch is not None:
            require_same(touch.channels, sensor.channels, f"{sample.id}: {name}")
    if series is not None and series.counts.shape[1] != sensor.channels.size:
        raise DatasetError(f"{sample.id}: series: {series.counts.shape[1]} values, not {sensor.channels.size}")
    fields = _biotac_fields if type_name == SAMPLE_TYPE else functools.partial(_tactile_fields, sensor)
    others = {} if series is None else dict(sorted(series.others.items()))
    extra = {name: float(value) for name, value in sorted(sample.extra.items())}
    message = SimpleNamespace(
        header=header_fields(sample.stamp_ns, sample.cloud.frame_id, "stamp_ns"),
        schema_version=SCHEMA_VERSION,
        id=sample.id,
        object=sample.object,
        outcome=OUTCOMES.index(record.outcome),
        note=record.note,
        cloud=cloud_fields(sample.cloud, "cloud.stamp_ns"),
        grasp=grasp_fields(sample.grasp),
        score=float(sample.grasp.score),
        candidates=[grasp_fields(grasp) for grasp in record.candidates],
        labelled=sample.touch is not None,
        tared=sample.tare is not None,
        **fields(sample),
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
        hand=properties_text(identity.hand),
        camera=properties_text(identity.camera),
        sha256=np.zeros(_DIGEST_SIZE, np.uint8),
    )
    for name in _FINITE:
        if not np.isfinite(getattr(message, name, 0.0)).all():
            raise DatasetError(f"{message.id}: {name}: holds a value that is not finite")
    body = bytes(sample_types().store.serialize_cdr(message, type_name))[:-_DIGEST_SIZE]
    return body + hashlib.sha256(body).digest()


def decode_sample(data: bytes | memoryview, type_name: str = "", sensor: Sensor | None = None) -> StoredSample:
    """Decode a sample; its cloud and series are views of `data`.

    Args:
        data: The message.
        type_name: One of `SAMPLE_TYPES`; "" for that which it is found to be.
        sensor: That it must be of, if any.

    Raises:
        DatasetError: If the bytes are damaged, of another schema version or sensor, or break a rule.
    """
    body, digest = data[:-_DIGEST_SIZE], bytes(data[-_DIGEST_SIZE:])
    if not body or hashlib.sha256(body).digest() != digest:
        raise DatasetError("damaged: the bytes do not match their SHA-256")
    try:
        message: Any = sample_types().store.deserialize_cdr(data, type_name or _found_type(data))
        require_version(message.schema_version, SCHEMA_VERSION)
        check_id(message.id, message.object)
        stored = _stored(message)
    except VersionError:
        raise
    except ForetouchError as err:
        raise DatasetError(str(err)) from err
    except Exception as err:  # the digest does not prove that foretouch wrote it: the parser may fail anywhere
        raise DatasetError(f"damaged: {described(err)}") from err
    if sensor is not None and stored.sensor.sha256 != sensor.sha256:
        names = [f"{one.config.name} ({one.sha256[:8]})" for one in (stored.sensor, sensor)]
        raise DatasetError(f"is of {names[0]}, and the dataset of {names[1]}")
    return stored


def id_in(head: bytes) -> str:
    """The id in the first `HEAD_SIZE` bytes of a serialised sample; a `ValueError` if it is none."""
    try:
        cdr = head[4:]  # it aligns from its fifth byte
        (frame,) = struct.unpack_from("<I", cdr, 8)  # after the stamp
        offset = 12 + frame
        offset += -offset % 2 + 2  # the schema version
        offset += -offset % 4
        (length,) = struct.unpack_from("<I", cdr, offset)
    except struct.error as err:
        raise ValueError(str(err)) from err
    if offset + 4 + length > len(cdr):
        raise ValueError("an id longer than its message")
    return cdr[offset + 4 : offset + 4 + length].rstrip(b"\0").decode()


def _found_type(data: bytes | memoryview) -> str:
    """The type of a sample: where one has its sensor's description, the other has a flag, and no text of more than a byte."""
    try:
        message: Any = sample_types().store.deserialize_cdr(data, TACTILE_SAMPLE_TYPE)
        return TACTILE_SAMPLE_TYPE if len(message.sensor) > 1 else SAMPLE_TYPE
    except Exception:  # noqa: BLE001  as other bytes the parser may fail anywhere
        return SAMPLE_TYPE


def _stored(message: Any) -> StoredSample:
    sensor = parse_sensor(message.sensor) if hasattr(message, "sensor") else BIOTAC_SP
    sample = GraspSample(
        id=message.id,
        object=message.object,
        cloud=decode_cloud(message.cloud),
        grasp=_grasp_of(message.grasp, float(message.score)),
        touch=_touch_of(message, "touch", sensor) if message.labelled else None,
        tare=_touch_of(message, "tare", sensor) if message.tared else None,
        stamp_ns=stamp_ns(message.header.stamp),
        extra=dict(zip(message.extra_names, map(float, message.extra_values), strict=True)),
    )
    record = SampleRecord(
        sample=sample,
        candidates=tuple(_grasp_of(grasp, float(grasp.score)) for grasp in message.candidates),
        outcome=OUTCOMES[message.outcome],
        note=message.note,
        series=_series_of(message, sensor),
        contact_ns=message.contact or None,
        detector=message.detector,
        pairing_error_ns=None if message.pairing_error < 0 else message.pairing_error,
        flags=tuple(message.flags),
    )
    identity = Identity(hand=parse_properties(message.hand), camera=parse_properties(message.camera))
    return StoredSample(record, identity, sensor)


def parse_properties(text: str) -> dict[str, str]:
    """The inverse of `properties_text`; a `DatasetError` if the text is none."""
    facts = parse_json(text)
    if not isinstance(facts, dict) or not all(isinstance(value, str) for value in facts.values()):
        raise DatasetError("hand, camera: is no list of named texts")
    return facts


@functools.cache
def sample_types() -> Definitions:
    """The definitions of samples, of all types in them, and of those that were looked up since."""
    definitions = Definitions()
    for name in SAMPLE_TYPES:
        definitions.text(name)
    return definitions


def properties_text(facts: Mapping[str, str]) -> str:
    """The properties of a hand or a camera as JSON; equal ones give equal text."""
    return json.dumps(dict(sorted(facts.items())), ensure_ascii=False)


def _grasp_of(message: Any, score: float) -> Grasp:
    """The grasp in a decoded `foretouch_msgs/Grasp`, whose rotation is taken as it is."""
    return replace(decode_grasp(message, np.asarray(message.rotation, np.float64).reshape(3, 3)), score=score)


def _biotac_fields(sample: GraspSample) -> dict[str, Any]:
    """Touch and tare of a BioTac SP by field; zeros where there is none."""
    fields: dict[str, Any] = {}
    for prefix, touch in zip(_PREFIX.values(), (sample.touch, sample.tare), strict=True):
        parts = biotac_touch(np.zeros(TOUCH_SIZE) if touch is None else touch.values).parts()
        fields |= {f"{prefix}{name}": part for name, part in zip(_TOUCH, parts.values(), strict=True)}
    return fields


def _tactile_fields(sensor: Sensor, sample: GraspSample) -> dict[str, Any]:
    """Touch, tare and description of any sensor; no values where there is no touch."""
    both = zip(_PREFIX, (sample.touch, sample.tare), strict=True)
    return {"sensor": sensor_text(sensor), **{name: np.empty(0) if one is None else one.values for name, one in both}}


def _touch_of(message: Any, name: str, sensor: Sensor) -> Touch:
    """The inverse of both for the `touch` or the `tare`."""
    if hasattr(message, "sensor"):
        return Touch(np.array(getattr(message, name), np.float64), sensor.channels)
    return biotac_touch(np.hstack([getattr(message, f"{_PREFIX[name]}{part}") for part in _TOUCH]))


@functools.lru_cache(maxsize=16)
def sensor_text(sensor: Sensor) -> str:
    """The description of a sensor as JSON."""
    return json.dumps(sensor.to_mapping(), ensure_ascii=False, sort_keys=True)


@functools.lru_cache(maxsize=16)
def parse_sensor(text: str) -> Sensor:
    """The inverse of `sensor_text`; a `DatasetError` or a `ConfigError` if the text is none."""
    return sensor_of(parse_json(text), "sensor")


def _series_of(message: Any, sensor: Sensor) -> TouchSeries | None:
    """The series in a sample as views of the message; None if it is empty."""
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

        Raises a `DatasetError` if the text is no definition, or contradicts a registered one.
        """
        from rosbags.typesys import TypesysError, get_types_from_msg

        try:
            self.store.register(get_types_from_msg(text, type_name))
        except TypesysError as err:
            raise DatasetError(f"{type_name}: {' '.join(str(err).split())}") from err

    def text(self, type_name: str) -> str:
        """The definition with those of all types in it (`ros2msg`); a `DatasetError` if one cannot be found."""
        self._require(type_name)
        return self.store.generate_msgdef(type_name, ros_version=2)[0]

    def _require(self, type_name: str) -> None:
        if type_name not in self.store.fielddefs:
            if not re.fullmatch(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", type_name):
                raise DatasetError(f"{type_name!r} is no message type, such as std_msgs/msg/String")
            self.register(type_name, _find(type_name))
        for needed in _types_in(self.store, type_name):
            self._require(needed)


def _find(type_name: str) -> str:
    package, _, name = type_name.split("/")
    if package == "foretouch_msgs" and (_OWN / f"{name}.msg").is_file():
        return (_OWN / f"{name}.msg").read_text(encoding="utf-8")
    for prefix in [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]:
        file = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise DatasetError(f"{type_name}: no definition is known, and {package} is not installed")


def _types_in(store: Typestore, type_name: str) -> Iterator[str]:
    from rosbags.interfaces import Nodetype

    for _, field in store.fielddefs[type_name][1]:
        kind, detail = cast("tuple[Any, Any]", field)
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (kind, detail), _ = detail
        if kind == Nodetype.NAME:
            yield detail
