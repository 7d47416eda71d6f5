# SPDX-License-Identifier: Apache-2.0
"""The predictions of one request as messages: one for each grasp, or arrays of all."""

import array
import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from std_msgs.msg import Header

from foretouch.ros.messages.conversions import REFERENCE_CODES, evidence_fields
from foretouch.ros.messages.placement import Placement, moved_grasp
from foretouch.ros.messages.requests import status_code
from foretouch.tactile.description import Sensor
from foretouch.types import Float32, Float64, Grasp, Index, Predictions
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TouchPredictionArray, TouchPredictionBatch
from foretouch_msgs.msg import TouchPrediction as TouchPredictionMsg

_ENDS = (("values", "scalars"), ("lower", "scalars_lower"), ("upper", "scalars_upper"))


@dataclass(eq=False)
class TouchAnswer:
    """What is known of the grasps of a request, in their order."""

    header: Header  # of the cloud
    grasps: Sequence[GraspMsg | Grasp]  # messages; of a request that holds arrays what was read from them
    predictions: Predictions  # of the grasps
    flags: tuple[str, ...] = ()  # of all grasps, beside the flags of each
    age: Duration = field(default_factory=Duration)  # of the cloud
    model: str = ""  # its name
    model_sha256: str = ""
    sensor: Sensor | None = None  # whose readings are predicted; None without a model
    arrays: bool = False  # whether the request holds arrays
    rotations: Float64 | None = None  # (K, 3, 3) that were computed for it, in the frame of the header; zeros for none

    def placed(self, placement: Placement) -> "TouchAnswer":
        """Return the same answer in another frame."""
        if placement.pose is None:
            return self
        pose = placement.pose
        grasps = [moved_grasp(one, pose) if isinstance(one, GraspMsg) else one.moved(pose) for one in self.grasps]
        rotations = None if self.rotations is None else pose[:3, :3] @ self.rotations
        return replace(self, header=placement.header, grasps=grasps, rotations=rotations)

    @cached_property
    def summary(self) -> tuple[int, str]:
        """OK without a reason if any prediction is, else status and reason of the first."""
        if self.predictions.ok.any() or not len(self.predictions):
            return Status.OK, ""
        return status_code(self.predictions.status[0]), self.predictions.reason[0]

    @property
    def answered(self) -> list[GraspMsg | Grasp]:
        """The grasps that have a prediction."""
        return [self.grasps[k] for k in np.flatnonzero(self.predictions.ok).tolist()]

    @property
    def reply(self) -> TouchPredictionArray | TouchPredictionBatch:
        """The answer in the form of the request."""
        return self.batch if self.arrays else self.message

    @property
    def message(self) -> TouchPredictionArray:
        """A message for each grasp."""
        shared, numbers = self._shared, self._numbers
        rows = {name: [array.array("f", row.tobytes()) for row in table] for name, table in numbers.items()}
        columns = self.predictions
        # A copy takes half of the time of a new message, which makes its defaults first.
        one = TouchPredictionMsg(header=self.header, **shared)
        made = []
        for k, grasp in enumerate(self.grasps):
            message = copy.copy(one)
            message.grasp, message.status, message.reason = grasp, status_code(columns.status[k]), columns.reason[k]
            message.flags = [*columns.flags[k], *self.flags]
            for name, value in (*_adapted(columns, k).items(), *((name, table[k]) for name, table in rows.items())):
                setattr(message, name, value)
            made.append(message)
        status, reason = self.summary
        return TouchPredictionArray(header=self.header, predictions=made, status=status, reason=reason)

    @property
    def batch(self) -> TouchPredictionBatch:
        """All grasps of a request that holds arrays."""
        columns = self.predictions
        flags = [(*own, *self.flags) for own in columns.flags]
        names = list(dict.fromkeys(flag for row in set(flags) for flag in sorted(row)))
        flagged = np.array([[name in row for name in names] for row in flags], np.uint8)
        rotations = np.zeros(0) if self.rotations is None else self.rotations
        return TouchPredictionBatch(
            header=self.header,
            rotations=array.array("d", rotations.tobytes()),
            statuses=array.array("B", [status_code(status) for status in columns.status]),
            reasons=columns.reason.tolist(),
            flags=names,
            flagged=array.array("B", flagged.tobytes()),
            status=self.summary[0],
            reason=self.summary[1],
            **_adapted(columns, int(columns.ok.argmax())),
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
        """(K, F N C) and (K, F S) float32 by field: values, scalars and their bounds; NaN where no number is known."""
        if self.sensor is None or not len(self.predictions):
            return {}
        with np.errstate(over="ignore"):  # becomes infinity, as in rclpy
            columns = self.predictions
            table = np.stack([columns.value, columns.lower, columns.upper]).astype(np.float32)
        taxels, scalars = (table[..., part] for part in _columns(self.sensor))
        ends = zip(_ENDS, taxels, scalars, strict=True)
        return {name: part for names, *parts in ends for name, part in zip(names, parts, strict=True)}


@cache
def _sensor_fields(sensor: Sensor) -> dict[str, Any]:
    """Make the fields that describe the arrays."""
    return {
        "sensor": sensor.config.name,
        "sensor_sha256": sensor.sha256,
        "fingers": list(sensor.channels.fingers),
        "channels": [channel.name for channel in sensor.taxel_channels],
        "valid": array.array("B", sensor.valid.tobytes()),
        "scalar_channels": [channel.name for channel in sensor.scalar_channels],
    }


@cache
def _columns(sensor: Sensor) -> tuple[Index, Index]:
    """Return columns of a touch in the order of a message: (F N C,) of the taxels, (F S,) of the scalars."""
    return sensor.taxel_columns.ravel(), sensor.scalar_columns.ravel()


def _adapted(predictions: Predictions, k: int) -> dict[str, Any]:
    """Make the fields that hold what a prediction was adapted to."""
    return {"reference": REFERENCE_CODES[predictions.reference[k]], **evidence_fields(predictions.evidence[k])}
