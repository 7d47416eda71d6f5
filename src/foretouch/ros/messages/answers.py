# SPDX-License-Identifier: Apache-2.0
"""The predictions of one request as messages: one for each grasp, or arrays of all."""

import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration
from std_msgs.msg import Header

from foretouch.ros.messages.conversions import REFERENCE_CODES, evidence_fields
from foretouch.tactile.description import Sensor
from foretouch.types import AnyArray, Evidence, Float32, Float64, Grasp, TouchPrediction
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TouchPredictionArray, TouchPredictionBatch
from foretouch_msgs.msg import TouchPrediction as TouchPredictionMsg

_ENDS = {"value": ("values", "scalars"), "lower": ("lower", "scalars_lower"), "upper": ("upper", "scalars_upper")}


class Refusal(NamedTuple):
    """Why a grasp gets no prediction: a status of `foretouch_msgs/Status`, and the reason as text."""

    status: int
    reason: str


@dataclass(eq=False)
class TouchAnswer:
    """What is known of the grasps of a request, in their order."""

    header: Header  # of the cloud
    grasps: Sequence[GraspMsg | Grasp | Refusal]  # messages; of a request that holds arrays what was read from them
    outcomes: Sequence[TouchPrediction | Refusal]  # predictions have a value
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
        refused = [one for one in self.outcomes if isinstance(one, Refusal)]
        return refused[0] if refused and len(refused) == len(self.outcomes) else Refusal(Status.OK, "")

    @property
    def answered(self) -> list[Any]:
        """The grasps that have a prediction."""
        pairs = zip(self.grasps, self.outcomes, strict=True)
        return [grasp for grasp, outcome in pairs if not isinstance(outcome, Refusal)]

    @property
    def message(self) -> TouchPredictionArray:
        """A message for each grasp."""
        shared, numbers = self._shared, self._numbers
        rows = {name: [array.array("f", row.tobytes()) for row in table] for name, table in numbers.items()}
        made = []
        for k, (grasp, outcome) in enumerate(zip(self.grasps, self.outcomes, strict=True)):
            (status, reason), flags = _refusal_and_flags(outcome)
            made.append(
                TouchPredictionMsg(
                    header=self.header,
                    grasp=grasp,
                    status=status,
                    reason=reason,
                    flags=[*flags, *self.flags],
                    **_adapted(outcome),
                    **shared,
                    **{name: table[k] for name, table in rows.items()},
                )
            )
        return TouchPredictionArray(header=self.header, predictions=made, **self.summary._asdict())

    @property
    def batch(self) -> TouchPredictionBatch:
        """All grasps of a request that holds arrays."""
        found = [_refusal_and_flags(one) for one in self.outcomes]
        refusals, flags = [one for one, _ in found], [(*own, *self.flags) for _, own in found]
        names = list(dict.fromkeys(flag for one in set(flags) for flag in sorted(one)))
        flagged = np.array([[name in one for name in names] for one in flags], np.uint8)
        rotations = np.zeros(0) if self.rotations is None else self.rotations
        first = next((one for one in self.outcomes if not isinstance(one, Refusal)), refusals[0])
        return TouchPredictionBatch(
            header=self.header,
            rotations=array.array("d", rotations.tobytes()),
            statuses=array.array("B", [one.status for one in refusals]),
            reasons=[one.reason for one in refusals],
            flags=names,
            flagged=array.array("B", flagged.tobytes()),
            **self.summary._asdict(),
            **_adapted(first),
            **self._shared,
            **{name: array.array("f", table.tobytes()) for name, table in self._numbers.items()},
        )

    @property
    def _shared(self) -> dict[str, Any]:
        """Fields that are the same for all grasps."""
        fields = {"model": self.model, "model_sha256": self.model_sha256, "input_age": self.age}
        if (sensor := self.sensor) is None:
            return fields
        return {
            **fields,
            "sensor": sensor.config.name,
            "sensor_sha256": sensor.sha256,
            "fingers": list(sensor.channels.fingers),
            "channels": [one.name for one in sensor.taxel_channels],
            "valid": array.array("B", sensor.valid.tobytes()),
            "scalar_channels": [one.name for one in sensor.scalar_channels],
        }

    @property
    def _numbers(self) -> dict[str, Float32]:
        """(K, F N C) and (K, F S) float32 by field: values, scalars and their bounds; NaN where there is none."""
        if (sensor := self.sensor) is None:
            return {}
        found: dict[str, AnyArray] = {}
        known = [(k, one) for k, one in enumerate(self.outcomes) if not isinstance(one, Refusal)]
        for end, names in _ENDS.items():
            table = np.full((len(self.outcomes), sensor.channels.size), np.nan, np.float32)
            rows = [(k, touch.values) for k, one in known if (touch := getattr(one, end)) is not None]
            if rows:
                with np.errstate(over="ignore"):  # becomes infinity, as in rclpy
                    table[[k for k, _ in rows]] = np.concatenate([row for _, row in rows]).reshape(len(rows), -1)
            for name, columns in zip(names, (sensor.taxel_columns, sensor.scalar_columns), strict=True):
                found[name] = table[:, columns.ravel()]
        return found


def _refusal_and_flags(outcome: TouchPrediction | Refusal) -> tuple[Refusal, tuple[str, ...]]:
    return (outcome, ()) if isinstance(outcome, Refusal) else (Refusal(Status.OK, ""), outcome.flags)


def _adapted(outcome: TouchPrediction | Refusal) -> dict[str, Any]:
    """The fields that hold what a prediction was adapted to."""
    if isinstance(outcome, Refusal):
        return evidence_fields(Evidence())
    return {"reference": REFERENCE_CODES[outcome.reference], **evidence_fields(outcome.evidence)}
