# SPDX-License-Identifier: Apache-2.0
"""The predictions of one request as messages: one for each grasp, or arrays of all."""

import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration
from std_msgs.msg import Header

from foretouch.ros.messages.conversions import REFERENCE_CODES, evidence_fields
from foretouch.tactile.description import Sensor
from foretouch.types import Evidence, Float32, Float64, Grasp, Index, TouchPrediction, TouchPredictions, prediction_rows
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TouchPredictionArray, TouchPredictionBatch
from foretouch_msgs.msg import TouchPrediction as TouchPredictionMsg

_ENDS = (("values", "scalars"), ("lower", "scalars_lower"), ("upper", "scalars_upper"))  # of `prediction_rows`


class Refusal(NamedTuple):
    """Why a grasp gets no prediction: a status of `foretouch_msgs/Status`, and the reason as text."""

    status: int
    reason: str


_OK = Refusal(Status.OK, "")


@dataclass(eq=False)
class TouchAnswer:
    """What is known of the grasps of a request, in their order."""

    header: Header  # of the cloud
    grasps: Sequence[GraspMsg | Grasp | Refusal]  # messages; of a request that holds arrays what was read from them
    outcomes: Sequence[TouchPrediction | Refusal]  # predictions have a value; `TouchPredictions` are never made objects
    flags: tuple[str, ...] = ()  # of all, beside those of each
    age: Duration = field(default_factory=Duration)  # of the cloud
    model: str = ""  # its name
    model_sha256: str = ""
    sensor: Sensor | None = None  # whose readings are predicted; None without a model
    arrays: bool = False  # whether the request holds arrays
    rotations: Float64 | None = None  # (K, 3, 3) that were computed for it, in the frame of the header; zeros for none

    @cached_property
    def summary(self) -> Refusal:
        """OK without a reason if any prediction is, else the refusal of the first."""
        refused = [refusal for refusal, _ in self._states if refusal.status != Status.OK]
        return refused[0] if refused and len(refused) == len(self.outcomes) else _OK

    @property
    def answered(self) -> list[Any]:
        """The grasps that have a prediction."""
        return [grasp for grasp, (refusal, _) in zip(self.grasps, self._states, strict=True) if refusal is _OK]

    @property
    def _states(self) -> list[tuple[Refusal, tuple[str, ...]]]:
        """Refusal, or `_OK`, and flags of each grasp."""
        if isinstance(self.outcomes, TouchPredictions):
            return [(_OK, flags) for flags in self.outcomes.flags]
        return [(one, ()) if isinstance(one, Refusal) else (_OK, one.flags) for one in self.outcomes]

    @property
    def reply(self) -> TouchPredictionArray | TouchPredictionBatch:
        """The answer in the form of the request."""
        return self.batch if self.arrays else self.message

    @property
    def message(self) -> TouchPredictionArray:
        """A message for each grasp."""
        shared, numbers = self._shared, self._numbers
        rows = {name: [array.array("f", row.tobytes()) for row in table] for name, table in numbers.items()}
        made = []
        for k, (grasp, ((status, reason), flags)) in enumerate(zip(self.grasps, self._states, strict=True)):
            made.append(
                TouchPredictionMsg(
                    header=self.header,
                    grasp=grasp,
                    status=status,
                    reason=reason,
                    flags=[*flags, *self.flags],
                    **_adapted(self.outcomes[k]),
                    **shared,
                    **{name: table[k] for name, table in rows.items()},
                )
            )
        return TouchPredictionArray(header=self.header, predictions=made, **self.summary._asdict())

    @property
    def batch(self) -> TouchPredictionBatch:
        """All grasps of a request that holds arrays."""
        refusals, flags = [one for one, _ in self._states], [(*own, *self.flags) for _, own in self._states]
        names = list(dict.fromkeys(flag for one in set(flags) for flag in sorted(one)))
        flagged = np.array([[name in one for name in names] for one in flags], np.uint8)
        rotations = np.zeros(0) if self.rotations is None else self.rotations
        first = next((k for k, one in enumerate(refusals) if one is _OK), 0)
        return TouchPredictionBatch(
            header=self.header,
            rotations=array.array("d", rotations.tobytes()),
            statuses=array.array("B", [one.status for one in refusals]),
            reasons=[one.reason for one in refusals],
            flags=names,
            flagged=array.array("B", flagged.tobytes()),
            **self.summary._asdict(),
            **_adapted(self.outcomes[first]),
            **self._shared,
            **{name: array.array("f", table.tobytes()) for name, table in self._numbers.items()},
        )

    @property
    def _shared(self) -> dict[str, Any]:
        """Fields that are the same for all grasps."""
        fields = {"model": self.model, "model_sha256": self.model_sha256, "input_age": self.age}
        return fields if self.sensor is None else fields | _sensor_fields(self.sensor)

    @property
    def _numbers(self) -> dict[str, Float32]:
        """(K, F N C) and (K, F S) float32 by field: values, scalars and their bounds; NaN where there is none."""
        if self.sensor is None or not self.outcomes:
            return {}
        with np.errstate(over="ignore"):  # becomes infinity, as in rclpy
            table = prediction_rows(self.outcomes, self.sensor.channels.size).astype(np.float32)
        taxels, scalars = (table[..., columns] for columns in _columns(self.sensor))
        ends = zip(_ENDS, taxels, scalars, strict=True)
        return {name: part for names, *parts in ends for name, part in zip(names, parts, strict=True)}


@cache
def _sensor_fields(sensor: Sensor) -> dict[str, Any]:
    """The fields that describe the arrays."""
    return {
        "sensor": sensor.config.name,
        "sensor_sha256": sensor.sha256,
        "fingers": list(sensor.channels.fingers),
        "channels": [one.name for one in sensor.taxel_channels],
        "valid": array.array("B", sensor.valid.tobytes()),
        "scalar_channels": [one.name for one in sensor.scalar_channels],
    }


@cache
def _columns(sensor: Sensor) -> tuple[Index, Index]:
    """Columns of a touch in the order of a message: (F N C,) of the taxels, (F S,) of the scalars."""
    return sensor.taxel_columns.ravel(), sensor.scalar_columns.ravel()


def _adapted(outcome: TouchPrediction | Refusal) -> dict[str, Any]:
    """The fields that hold what a prediction was adapted to."""
    if isinstance(outcome, Refusal):
        return evidence_fields(Evidence())
    return {"reference": REFERENCE_CODES[outcome.reference], **evidence_fields(outcome.evidence)}
