# SPDX-License-Identifier: Apache-2.0
"""The predictions of one request as messages: of any sensor, or of the BioTac SP, then also as the bytes that are sent.

For each `TouchPrediction` rclpy would convert 50 `Interval` objects, which takes longer than to predict. The bytes are CDR as in
`foretouch.dataset.messages`: numbers at multiples of their size, strings with their length and a final zero. Here each part
ends at a multiple of four bytes.
"""

import array
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from foretouch.dataset.messages import grasp_numbers
from foretouch.ros.messages.conversions import REFERENCE_CODES, evidence_fields, prediction_to_msg, refusal_to_msg
from foretouch.tactile import BIOTAC, TOUCH_SIZE, biotac_touch
from foretouch.tactile.description import Sensor
from foretouch.topics import PREDICTED_TOPIC
from foretouch.types import Evidence, Float64, Index, Touch, TouchPrediction
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TactilePrediction, TactilePredictionArray, TouchPredictionArray
from foretouch_msgs.msg import TouchPrediction as TouchPredictionMsg


class Refusal(NamedTuple):
    """Why a grasp gets no prediction: a status of `foretouch_msgs/Status`, and the reason as text."""

    status: int
    reason: str


def other_sensor(sensor: Sensor | None) -> Refusal | None:
    """Why `TouchPrediction` cannot hold predictions for a sensor; None for the BioTac SP, and without a model."""
    if sensor is None or sensor.is_biotac:
        return None
    text = f"the model predicts {sensor.config.name}, not {BIOTAC.sensor}: its predictions are on the topic {PREDICTED_TOPIC}"
    return Refusal(Status.REFUSED, text)


@dataclass(eq=False)
class TouchAnswer:
    """What is known of the grasps of a request, in their order."""

    header: Header  # of the cloud
    grasps: Sequence[GraspMsg]
    outcomes: Sequence[TouchPrediction | Refusal]  # predictions have a value
    flags: tuple[str, ...] = ()  # of all, beside those of each
    age: Duration = field(default_factory=Duration)  # of the cloud
    model: str = ""  # its name
    model_sha256: str = ""
    sensor: Sensor | None = None  # whose readings are predicted; None without a model

    @cached_property
    def summary(self) -> Refusal:
        """OK without a reason if any prediction is, else the refusal of the first."""
        refused = [one for one in self.outcomes if isinstance(one, Refusal)]
        return refused[0] if refused and len(refused) == len(self.outcomes) else Refusal(Status.OK, "")

    @property
    def answered(self) -> list[GraspMsg]:
        """The grasps that have a prediction."""
        return [grasp for grasp, outcome in self._pairs if not isinstance(outcome, Refusal)]

    def prediction(self, k: int) -> TouchPredictionMsg:
        """The message of one of them."""
        outcome, grasp = self.outcomes[k], self.grasps[k]
        if isinstance(outcome, Refusal):
            message = refusal_to_msg(grasp, self.header, *outcome)
        else:
            message = prediction_to_msg(outcome, grasp, self.header)
        message.flags = [*message.flags, *self.flags]
        message.input_age = self.age
        message.model, message.model_sha256 = self.model, self.model_sha256
        return message

    @property
    def message(self) -> TouchPredictionArray:
        """The message of all."""
        return TouchPredictionArray(
            header=self.header,
            predictions=[self.prediction(k) for k in range(len(self.outcomes))],
            **self.summary._asdict(),
        )

    @property
    def tactile(self) -> TactilePredictionArray:
        """The message of all for any sensor; without predictions if there is no model."""
        made = [] if self.sensor is None else [self._tactile(self.sensor, *one) for one in self._pairs]
        return TactilePredictionArray(header=self.header, predictions=made, **self.summary._asdict())

    @property
    def _pairs(self) -> "zip[tuple[GraspMsg, TouchPrediction | Refusal]]":
        return zip(self.grasps, self.outcomes, strict=True)

    def _tactile(self, sensor: Sensor, grasp: GraspMsg, outcome: TouchPrediction | Refusal) -> TactilePrediction:
        ends: tuple[Touch | None, ...] = (None, None, None)
        flags: tuple[str, ...] = ()
        if isinstance(outcome, Refusal):
            fields: dict[str, Any] = {**outcome._asdict(), **evidence_fields(Evidence())}
        else:
            ends, flags = (outcome.value, outcome.lower, outcome.upper), outcome.flags
            fields = {"reference": REFERENCE_CODES[outcome.reference], **evidence_fields(outcome.evidence)}
        for name, touch in zip(("values", "lower", "upper"), ends, strict=True):
            fields[name] = _floats(touch, sensor.taxel_columns)
        for name, touch in zip(("scalars", "scalars_lower", "scalars_upper"), ends, strict=True):
            fields[name] = _floats(touch, sensor.scalar_columns)
        return TactilePrediction(
            header=self.header,
            grasp=grasp,
            sensor=sensor.config.name,
            sensor_sha256=sensor.sha256,
            fingers=sensor.channels.fingers,
            channels=[one.name for one in sensor.taxel_channels],
            valid=array.array("B", sensor.valid.tobytes()),
            scalar_channels=[one.name for one in sensor.scalar_channels],
            flags=[*flags, *self.flags],
            model=self.model,
            model_sha256=self.model_sha256,
            input_age=self.age,
            **fields,
        )

    def encoded(self) -> bytes:
        """The message of all as the middleware sends it."""
        parts: list[bytes] = [self._begin, struct.pack("<I", len(self.outcomes))]
        at = sum(map(len, parts))
        tails: dict[Any, bytes] = {}
        for outcome, names, numbers in zip(self.outcomes, *self._fixed, strict=True):
            key = outcome if isinstance(outcome, Refusal) else (outcome.flags, outcome.reference, outcome.evidence)
            if (tail := tails.get(key)) is None:
                tail = tails[key] = self._tail(outcome)
            gap = -(at + len(names)) % 8  # doubles begin at multiples of their size
            parts += (names, bytes(gap), numbers, tail)
            at += len(names) + gap + len(numbers) + len(tail)
        status, reason = self.summary
        end = _text(reason)[: 4 + len(reason.encode()) + 1]  # nothing follows
        return b"".join((b"\0\1\0\0", *parts, struct.pack("<B3x", status), end))  # the header: little-endian

    @cached_property
    def _begin(self) -> bytes:
        stamp = self.header.stamp
        return struct.pack("<iI", stamp.sec, stamp.nanosec) + _text(self.header.frame_id)

    @cached_property
    def _fixed(self) -> tuple[list[bytes], list[bytes]]:
        """Of each prediction what does not depend on flags and age: the part before its numbers, and these."""
        names = [self._begin + _text(one.id) + _text(one.object_id) for one in self.grasps]
        doubles = _rows(grasp_numbers(self.grasps).astype("<f8"))
        scores = _rows(np.array([one.score for one in self.grasps], "<f4")[:, None])
        numbers = [
            b"".join((pose, score, struct.pack("<B3x", one.status), _text(one.reason), counts))
            for one, pose, score, counts in zip(
                self.grasps, doubles, scores, _rows(_intervals(self.outcomes)), strict=True
            )
        ]
        return names, numbers

    def _tail(self, outcome: TouchPrediction | Refusal) -> bytes:
        """The fields after the intervals."""
        if isinstance(outcome, Refusal):
            reference, flags, status, reason = TouchPredictionMsg.NONE, self.flags, *outcome
            evidence: dict[str, Any] = {}
        else:
            reference, flags = REFERENCE_CODES[outcome.reference], (*outcome.flags, *self.flags)
            status, reason, evidence = Status.OK, "", evidence_fields(outcome.evidence)
        ages = [evidence.get(name) or Duration() for name in ("touch_age", "reading_age")]
        return b"".join((
            struct.pack("<BB2x", reference, status),
            _text(reason),
            struct.pack("<I", len(flags)),
            *map(_text, flags),
            _text(self.model),
            _text(self.model_sha256),
            struct.pack("<iI", self.age.sec, self.age.nanosec),
            struct.pack("<IiI", evidence.get("touches", 0), ages[0].sec, ages[0].nanosec),
            struct.pack("<IiI", evidence.get("readings", 0), ages[1].sec, ages[1].nanosec),
        ))  # fmt: skip


@cache
def middleware_reads_cdr() -> bool:
    """Whether the middleware of this process reads what `TouchAnswer.encoded` writes; tried once."""
    touch = biotac_touch(np.arange(float(TOUCH_SIZE)))
    grasps = [GraspMsg(id="x" * k, score=0.5, reason="y") for k in range(3)]
    known = TouchPrediction(
        None,  # type: ignore[arg-type]
        *(touch, touch, touch),
        reference="touches",
        flags=("a",),
        evidence=Evidence(1, 2.5, 3, 4.5),
    )
    answer = TouchAnswer(Header(frame_id="cam"), grasps, [known] * len(grasps), ("late",), Duration(sec=5), "m", "s")
    try:
        return bool(deserialize_message(answer.encoded(), TouchPredictionArray) == answer.message)
    except Exception:  # noqa: BLE001  rclpy declares no type for it
        return False


def _text(text: str) -> bytes:
    """A string, filled up to a multiple of four bytes."""
    data = text.encode().partition(b"\0")[0] + b"\0"
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


def _rows(array: Any) -> list[bytes]:
    """The bytes of each row."""
    data = array.tobytes()
    size = len(data) // max(1, len(array))
    return [data[k * size : (k + 1) * size] for k in range(len(array))]


def _intervals(outcomes: Sequence[TouchPrediction | Refusal]) -> Any:
    """(K, 50, 3) little-endian float32: value, lower and upper bound of each; NaN where there is none [counts]."""
    table = np.full((len(outcomes), TOUCH_SIZE, 3), np.nan, "<f4")
    known = [(k, one) for k, one in enumerate(outcomes) if not isinstance(one, Refusal)]
    for column, name in enumerate(("value", "lower", "upper")):
        rows = [(k, touch) for k, one in known if (touch := getattr(one, name)) is not None]
        if rows:
            with np.errstate(over="ignore"):  # becomes infinity, as in rclpy
                table[[k for k, _ in rows], :, column] = _vectors([touch for _, touch in rows])
    return table


def _floats(touch: Touch | None, columns: Index) -> "array.array[float]":
    """Values of a touch as float32, which rclpy takes over as they are; NaN without one."""
    values = np.full(columns.size, np.nan) if touch is None else touch.values[columns.ravel()]
    with np.errstate(over="ignore"):
        return array.array("f", values.astype(np.float32).tobytes())


def _vectors(touches: Sequence[Touch]) -> Float64:
    """(K, 50) float64, the values of each."""
    return np.concatenate([one.values for one in touches]).reshape(len(touches), -1)
