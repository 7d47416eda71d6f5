# SPDX-License-Identifier: Apache-2.0
"""Answers as `predict --json` and `run --json` print them: written from messages, and read back from a file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foretouch.errors import ConfigError, FileError, ForetouchError, TactileError, shown
from foretouch.files import TEXT_LIMIT, parse_json, read_bytes, require_schema
from foretouch.tactile.channels import BIOTAC, BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Float64, Grasp, Touch, TouchPrediction
from foretouch.types.channels import Channels

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from foretouch_msgs.msg import TouchPrediction as TouchPredictionMsg
    from foretouch_msgs.msg import TouchPredictionArray


ANSWER_SUFFIXES = (".json", ".jsonl")


def grasp_record(grasp: Grasp) -> dict[str, Any]:
    """A grasp for JSON: contacts [m], rotation row by row, score (null if undefined)."""
    return {
        "g1": grasp.g1,
        "g2": grasp.g2,
        "rotation": grasp.rotation.reshape(9),
        "score": None if math.isnan(grasp.score) else grasp.score,
    }


def prediction_record(prediction: TouchPrediction, channels: Channels = BIOTAC) -> dict[str, Any]:
    """One prediction for JSON: values and bounds of each of the modalities, bounds null without a calibration."""
    ends = {"value": prediction.value, "lower": prediction.lower, "upper": prediction.upper}
    columns = {name: {} if touch is None else touch.parts() for name, touch in ends.items()}
    return {
        "grasp": grasp_record(prediction.grasp),
        **{name: {key: parts.get(name) for key, parts in columns.items()} for name in channels.modalities},
        "reference": prediction.reference,
        "evidence": asdict(prediction.evidence),
        "flags": list(prediction.flags),
        "status": prediction.status,
        "reason": prediction.reason,
    }


def answer_record(message: TouchPredictionArray, sensor: Sensor = BIOTAC_SP) -> dict[str, Any]:
    """A `touch` message of a sensor as `run --json` prints it."""
    from foretouch.ros.messages.requests import status_name

    return {
        "stamp_ns": stamp_ns(message.header.stamp),
        "frame_id": message.header.frame_id,
        "status": status_name(message.status),
        "reason": message.reason,
        "predictions": [_message_record(one, sensor) for one in message.predictions],
    }


def _message_record(message: TouchPredictionMsg, sensor: Sensor) -> dict[str, Any]:
    """A prediction for JSON; one that cannot be read, such as on a grasp that is not finite, gets its reason alone."""
    from foretouch.ros.messages.conversions import prediction_from_msg
    from foretouch.ros.messages.requests import status_name

    try:
        return prediction_record(prediction_from_msg(message, sensor), sensor.channels)
    except ForetouchError as err:
        status = status_name(message.status) if message.status else "failed"
        return {"status": status, "reason": message.reason or str(err)}


def modality_text(
    value: ArrayLike, lower: ArrayLike | None, upper: ArrayLike | None, text: Callable[[float], str] = "{:.0f}".format
) -> str:
    """Value and half width of a single number; of several, least and largest value and mean half width."""
    if value is None:
        return "refused"
    values = np.atleast_1d(value)
    found = f"{text(values.min())}–{text(values.max())}" if values.size > 1 else text(values[0])
    if lower is None or upper is None or np.isnan(lower).any():  # not calibrated
        return found
    return f"{found} ±{text(float(np.mean(np.subtract(upper, lower))) / 2.0)}"  # no space: a table folds there


def read_answers(path: Path) -> list[dict[str, Any]]:
    """The answers in a file, one JSON object a line; other objects, such as the counts of `run`, are left out.

    Raises:
        FileError: As `read_bytes`; also if there is none, or a line is not a JSON object.
    """
    records = []
    for number, line in enumerate(read_bytes(path, TEXT_LIMIT).splitlines(), 1):
        if not line.strip():
            continue
        try:
            record = parse_json(line)
        except ValueError as err:
            raise FileError(path, f"is not JSON: {err}", field=f"line {number}") from err
        types = {"stamp_ns?": (int, type(None)), "predictions?": list, "status?": str}
        require_schema(path, record, types, f"line {number}")
        if "predictions" in record or "status" in record:
            records.append(record)
    if not records:
        raise FileError(path, "holds no answers of `predict --json` or `run --json`")
    return records


def prediction_from_record(record: Any, channels: Channels = BIOTAC) -> TouchPrediction:
    """A prediction for a sensor from the JSON of `predict` and `run`.

    Raises:
        ConfigError: Names the field that is missing or wrong.
    """
    if isinstance(record, dict) and (missing := [name for name in channels.modalities if name not in record]):
        raise ConfigError(
            f"predictions: {missing[0]}: is missing; not of {channels.sensor}; name the model or its data"
        )
    try:
        field = "grasp"
        shapes = {"g1": (3,), "g2": (3,), "rotation": (3, 3)}
        g1, g2, rotation = (_numbers(record["grasp"][name]).reshape(shape) for name, shape in shapes.items())
        score = record["grasp"].get("score")
        grasp = Grasp(g1, g2, rotation, score=math.nan if score is None else float(_numbers(score)))
        touches: list[Touch | None] = []
        for end in ("value", "lower", "upper"):
            known = []
            for field in channels.modalities:
                part = record[field][end]
                known += [] if part is None else [np.atleast_1d(_numbers(part))]
            touches.append(Touch(np.concatenate(known), channels) if len(known) == len(channels.modalities) else None)
        field = "status"
        value, lower, upper = touches
        others: dict[str, Any] = {name: record[name] for name in ("reference", "status", "reason")}
        return TouchPrediction(grasp, value, lower, upper, flags=tuple(record["flags"]), **others)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, TactileError) as err:
        raise ConfigError(
            f"predictions: {field}: is not as `predict --json` writes it ({type(err).__name__}: {err})"
        ) from err


def _numbers(value: Any) -> Float64:
    """The array of a number of JSON, or of nested lists of numbers; a ValueError for anything else, and beyond 1e12."""
    flat = [value]
    while any(isinstance(one, list) for one in flat):
        flat = [one for part in flat for one in (part if isinstance(part, list) else [part])]
    if wrong := [one for one in flat if type(one) not in (int, float) or not abs(one) <= 1e12]:
        raise ValueError(f"{shown(wrong[0], 40)} is not a number that can be used")
    return np.array(value, np.float64)
