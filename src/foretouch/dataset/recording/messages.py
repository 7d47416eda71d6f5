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
from foretouch.dataset.recording.definitions import Definitions
from foretouch.dataset.recording.message_fields import (
    cloud_fields,
    cloud_of,
    grasp_fields,
    grasp_of,
    header_fields,
    require_finite,
    series_of,
    stamp_ns_of,
    touch_fields,
    touch_of,
)
from foretouch.dataset.recording.record import Identity, Outcome, SampleRecord, check_name
from foretouch.errors import DatasetError, ForetouchError
from foretouch.types import GraspSample

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
        header=header_fields(sample.stamp_ns, sample.cloud.frame_id, "stamp_ns"),
        schema_version=SCHEMA_VERSION,
        id=sample.id,
        object=sample.object,
        outcome=_OUTCOMES.index(record.outcome),
        note=record.note,
        cloud=cloud_fields(sample.cloud),
        grasp=grasp_fields(sample.grasp),
        score=float(sample.grasp.score),
        candidates=[grasp_fields(grasp) for grasp in record.candidates],
        **touch_fields(sample.touch, "labelled", ""),
        **touch_fields(sample.tare, "tared", "tare_"),
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
    require_finite(message)
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
    cloud = cloud_of(message.cloud)
    sample = GraspSample(
        id=message.id,
        object=message.object,
        cloud=cloud,
        grasp=grasp_of(message.grasp, float(message.score)),
        touch=touch_of(message, "labelled", ""),
        tare=touch_of(message, "tared", "tare_"),
        stamp_ns=stamp_ns_of(message.header),
        extra=dict(zip(message.extra_names, map(float, message.extra_values), strict=True)),
    )
    record = SampleRecord(
        sample=sample,
        candidates=tuple(grasp_of(grasp, float(grasp.score)) for grasp in message.candidates),
        outcome=_OUTCOMES[message.outcome],
        note=message.note,
        series=series_of(message),
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
