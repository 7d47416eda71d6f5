# SPDX-License-Identifier: Apache-2.0
"""Tactile messages as drivers send them: `BiotacAll`, and messages of a described sensor.

They are decoded in `foretouch.tactile.messages`.
"""

import array
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.ros.messages.conversions import header_to_msg, stamp_to_msg
from foretouch.ros.messages.tactile import message_class
from foretouch.tactile import ELECTRODES
from foretouch.tactile.description import STAMP_UNITS, Sensor
from foretouch.tactile.field_path import FieldPath
from foretouch.tactile.messages.biotac import FINGER_ORDER, OTHERS
from foretouch.types import Float64
from foretouch_msgs.msg import Biotac, BiotacAll

Counts = npt.NDArray[np.int16]

_ABSENT: Counts = np.zeros(1 + ELECTRODES, np.int16)


def biotac_all_to_msg(fingers: Mapping[str, Counts], frame_id: str, nanoseconds: int) -> BiotacAll:
    """Make a message of all five fingers. An absent finger sends zeros, as one without a BioTac does.

    Args:
        fingers: (25,) int16 counts by finger, PDC then electrodes, or (29,) with PAC0, PAC1, TAC and TDC, which are 0 otherwise.
        frame_id: Of the header.
        nanoseconds: Stamp [ns].
    """
    # rclpy takes over an array.array of the right type as it is; it checks any other sequence element by element.
    tactiles = [
        Biotac(
            pdc=int(counts[0]),
            electrodes=array.array("h", counts[1 : 1 + ELECTRODES].tobytes()),
            **{name.lower(): int(value) for name, value in zip(OTHERS, counts[1 + ELECTRODES :], strict=False)},
        )
        for counts in (fingers.get(name, _ABSENT) for name in FINGER_ORDER)
    ]
    return BiotacAll(header=header_to_msg(frame_id, nanoseconds), tactiles=tactiles)


def sensor_to_msg(kind: type, sensor: Sensor, readings: Sequence[Float64], nanoseconds: int) -> Any:
    """Return a message that the decoder of a described sensor reads (`foretouch.tactile.messages.described`).

    Args:
        kind: Class of the message (see `message_class`).
        sensor: The description, by whose field paths the message is filled.
        readings: (V,) values of each grasping finger, in the order of the channels of a touch.
        nanoseconds: Stamp [ns].

    Other numbers of a finger are 0, or as near to it as their range allows.
    """
    message, config = kind(), sensor.config
    ends = np.cumsum([size for _, size in sensor.predicted])
    for finger, values in zip(config.chosen_fingers(), readings, strict=True):
        known = dict(zip((described.name for described, _ in sensor.predicted), np.split(values, ends), strict=False))
        for channel in (*config.scalars, *config.values):
            path = f"{finger.field}.{channel.field}".strip(".").replace(".[", "[")
            sent = np.full(sensor.series_size if channel in config.values else 1, np.clip(0.0, *channel.limits))
            if channel.name in known:
                sent[sensor.places if channel in config.values else slice(None)] = known[channel.name]
            _write(message, FieldPath(path).steps, sent.tolist(), _number)
    if config.source.stamp:
        unit_ns = STAMP_UNITS[config.source.stamp_unit]
        _write(message, FieldPath(config.source.stamp).steps, [nanoseconds], partial(_stamp, unit_ns))
    return message


def _write(owner: Any, steps: Sequence[Any], data: Sequence[Any], convert: Callable[[str, Any], Any]) -> None:
    """Write numbers where a field path leads to, as the type there asks for; elements that are missing are made."""
    name, *rest = steps
    kind = owner.get_fields_and_field_types()[name]
    if not rest:
        values = [convert(kind, value) for value in data]
        setattr(owner, name, values if kind[-1] in ">]" else values[0])
        return
    if isinstance(rest[0], str):
        _write(getattr(owner, name), rest, data, convert)
        return
    items, step, *rest = list(getattr(owner, name)), *rest
    places, parts = [step], [data]
    if isinstance(step, slice):
        first, stride = step.start or 0, step.step or 1
        places, parts = list(range(first, first + stride * len(data), stride)), [[value] for value in data]
    elif isinstance(step, tuple):
        places = [next((k for k, item in enumerate(items) if str(getattr(item, step[0])) == step[1]), len(items))]
    element = re.split("[<>,[]", kind)[1 if "<" in kind else 0]
    while len(items) <= places[-1]:
        items.append(message_class(element)() if "/" in element else 0)
    for place, part in zip(places, parts, strict=True):
        if isinstance(step, tuple):
            text = items[place].get_fields_and_field_types()[step[0]] == "string"
            setattr(items[place], step[0], step[1] if text else int(step[1]))
        if rest:
            _write(items[place], rest, part, convert)
        else:
            items[place] = convert(kind, part[0])
    setattr(owner, name, items)


def _number(kind: str, value: float) -> float:
    return int(value) if "int" in kind else value


def _stamp(unit_ns: int, kind: str, nanoseconds: int) -> Any:
    if "/" in kind:
        return stamp_to_msg(nanoseconds)
    return nanoseconds // unit_ns if "int" in kind else nanoseconds / unit_ns
