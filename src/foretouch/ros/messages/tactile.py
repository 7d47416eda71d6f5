# SPDX-License-Identifier: Apache-2.0
"""Tactile messages as drivers send them: `BiotacAll`, and those of a described sensor; their topic and classes.

Tactile messages are decoded in `foretouch.tactile.messages`.
"""

import array
import importlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import MissingDependencyError
from foretouch.ros.messages.conversions import header_to_msg, stamp_to_msg
from foretouch.tactile import ELECTRODES
from foretouch.tactile.description import STAMP_UNITS, Sensor
from foretouch.tactile.field_path import FieldPath
from foretouch.tactile.messages.biotac_all import FINGER_ORDER, OTHERS
from foretouch.tactile.messages.table import TactileConfig
from foretouch.topics import TACTILE_TOPIC
from foretouch.types import Float64
from foretouch_msgs.msg import Biotac, BiotacAll

Counts = npt.NDArray[np.int16]

_ABSENT: Counts = np.zeros(1 + ELECTRODES, np.int16)


@dataclass(frozen=True, kw_only=True)
class TactileInput(Settings):
    """Settings of nodes that receive tactile messages."""

    tactile_topic: str = setting(TACTILE_TOPIC, "Topic of the tactile messages", read_only=True)
    tactile: TactileConfig = field(default_factory=TactileConfig)


def biotac_all_to_msg(fingers: Mapping[str, Counts], frame_id: str, nanoseconds: int) -> BiotacAll:
    """A message of all five fingers with a frame and a stamp [ns].

    `fingers` holds (25,) int16 counts by finger, PDC then electrodes, or (29,) with PAC0, PAC1, TAC and TDC, which are
    0 otherwise. An absent finger sends zeros, as one without a BioTac does.
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
    """A message that the decoder of a described sensor reads (`foretouch.tactile.messages.described`).

    Args:
        kind: Class of the message (see `tactile_class`).
        sensor: The description, by whose field paths the message is filled.
        readings: (V,) values of each grasping finger, in the order of the channels of a touch.
        nanoseconds: Stamp [ns].

    Other scalars are 0, or as near to it as their range allows.
    """
    message, config = kind(), sensor.config
    for finger, values in zip(config.chosen_fingers(), readings, strict=True):
        ends = np.cumsum([size for _, size in sensor.predicted])
        parts = {one.name: part for (one, _), part in zip(sensor.predicted, np.split(values, ends), strict=False)}
        for channel in (*config.scalars, *config.values):
            path = ".".join(filter(None, (finger.field, channel.field))).replace(".[", "[")
            size = sensor.size if channel in config.values else 1
            absent = np.full(size, np.clip(0.0, *channel.limits))
            _write(message, FieldPath(path).steps, parts.get(channel.name, absent).tolist())
    if config.source.stamp:
        _write(message, FieldPath(config.source.stamp).steps, nanoseconds, STAMP_UNITS[config.source.stamp_unit])
    return message


def _write(owner: Any, steps: Sequence[Any], data: Any, unit: int = 0) -> None:
    """Write numbers, or a stamp [ns] in some unit [ns], where a field path leads to; elements that are missing are made."""
    name, *rest = steps
    kind = owner.get_fields_and_field_types()[name]
    if not rest:
        if unit:
            data = stamp_to_msg(data) if "/" in kind else data // unit if "int" in kind else data / unit
        elif isinstance(data, list) and not (kind.startswith("sequence") or kind.endswith("]")):
            (data,) = data
        setattr(owner, name, data if unit else _cast(kind, data))
    elif isinstance(rest[0], str):
        _write(getattr(owner, name), rest, data, unit)
    else:
        setattr(owner, name, _with_elements(list(getattr(owner, name)), kind, rest, data, unit))


def _with_elements(items: list[Any], kind: str, steps: Sequence[Any], data: Any, unit: int) -> list[Any]:
    """The elements of a list after numbers were written into some of them."""
    step, *rest = steps
    if isinstance(step, slice):
        start, stride = step.start or 0, step.step or 1
        places = range(start, start + stride * len(data), stride)
    elif isinstance(step, int):
        places, data = range(step, step + 1), [data]
    else:
        key, wanted = step
        known = [str(getattr(one, key)) for one in items]
        at = known.index(wanted) if wanted in known else len(items)
        places, data = range(at, at + 1), [data]
    while len(items) <= places[-1]:
        items.append(_new(kind))
    for place, one in zip(places, data, strict=True):
        if not isinstance(step, slice | int):
            setattr(items[place], key, _cast(items[place].get_fields_and_field_types()[key], wanted))
        if rest:
            _write(items[place], rest, one, unit)
        else:
            items[place] = _cast(kind, one)
    return items


def _new(kind: str) -> Any:
    """An element of a list of messages or numbers, by the type of the list, such as `sequence<std_msgs/Header>`."""
    element = re.sub(r"^sequence<([^,>]*).*|\[\d+\]$", r"\1", kind)
    return tactile_class(element)() if "/" in element else _cast(element, 0)


def _cast(kind: str, data: Any) -> Any:
    if isinstance(data, list):
        return [_cast(kind, one) for one in data]
    return int(data) if "int" in kind else str(data) if "string" in kind else float(data)


def tactile_class(type_name: str) -> type:
    """The message class of a type such as `std_msgs/String`; a `MissingDependencyError` without its package."""
    package, _, name = type_name.partition("/")
    try:
        message: type = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as err:
        raise MissingDependencyError(
            f"{type_name}: {package} is not installed; source the workspace that holds it"
        ) from err
    return message
