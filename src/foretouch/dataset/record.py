# SPDX-License-Identifier: Apache-2.0
"""The record of one grasp: the sample that models train on, and what is needed to assess it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from foretouch.errors import DatasetError
from foretouch.types import AnyArray, Float32, Grasp, Int64, Sample, UInt8

REST: Final = 0
APPROACH: Final = 1
HOLD: Final = 2

#: Flag of a sample that the operator discarded: it stays in the recording, and builds and exports leave it out.
DISCARDED: Final = "discarded"

Outcome = Literal["unknown", "success", "failure"]


@dataclass(frozen=True, kw_only=True)
class Identity:
    """The hand and the camera; all recordings of a dataset share them."""

    hand: Mapping[str, str] = field(default_factory=dict)  # such as model, serial number and names of its two fingers
    camera: Mapping[str, str] = field(default_factory=dict)  # such as model, serial number and image size


@dataclass(frozen=True, eq=False)
class TouchSeries:
    """The readings around one grasp, in the order of their stamps; a `DatasetError` if a shape is another."""

    stamps_ns: Int64  # (T,) int64, from the sensor's headers [ns]; equal stamps are kept
    counts: Float32  # (T, D) float32, each as `Touch.values`
    phases: UInt8  # (T,) uint8: REST, APPROACH or HOLD
    others: Mapping[str, Float32] = field(default_factory=dict)  # such as `PAC0_TH`: (T,) float32 each

    def __post_init__(self) -> None:
        length = len(self.stamps_ns)
        arrays: dict[str, AnyArray] = {"counts": self.counts, "phases": self.phases}
        arrays |= {f"others.{name}": values for name, values in self.others.items()}
        for name, array in arrays.items():
            shape = (length, *array.shape[1:2]) if name == "counts" else (length,)
            if array.shape != shape or array.ndim != 1 + (name == "counts"):
                raise DatasetError(f"series.{name}: shape {array.shape} is not {shape}")


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleRecord:
    """One recorded grasp; it is labelled if `sample.touch` is set, else its grasp is the best planned one.

    Raises:
        DatasetError: If the readings are not of the sensor of the touch.
    """

    sample: Sample  # if its id is "", the writer assigns `<object>/<number>`
    candidates: tuple[Grasp, ...] = ()  # the other grasps planned on the same cloud
    outcome: Outcome = "unknown"  # the operator's verdict
    note: str = ""  # the operator's remark
    series: TouchSeries | None = None  # the readings around the grasp
    contact_ns: int | None = None  # stamp of the first contact [ns]
    detector: str = ""  # description of the method that detected the contact
    pairing_error_ns: int | None = None  # widest gap between the requested interval and the readings found [ns]
    flags: tuple[str, ...] = ()  # such as `arrival_stamped`

    def __post_init__(self) -> None:
        series, touch = self.series, self.sample.touch
        if series is not None and touch is not None and series.counts.shape[1] != touch.channels.size:
            shape = (len(series.stamps_ns), touch.channels.size)
            raise DatasetError(f"series.counts: shape {series.counts.shape} is not {shape}")


def readings(record: SampleRecord) -> TouchSeries | None:
    """Return the readings around a grasp; of a sample without a series its touch as the only one, or None without a touch."""
    sample = record.sample
    if record.series is not None or sample.touch is None:
        return record.series
    others = {name: np.array([value], np.float32) for name, value in sample.extra.items()}
    counts = sample.touch.values[None].astype(np.float32)
    return TouchSeries(np.array([sample.stamp_ns]), counts, np.array([HOLD], np.uint8), others)


def check_name(name: str, what: str) -> str:
    """Check a label that becomes part of an id and the name of a folder, and return it.

    Raises a `DatasetError` that names `what` it is if it is empty, longer than 100 characters, `.` or `..`, or holds a
    slash, a colon or a control character.
    """
    if not name or len(name) > 100 or name.strip(".") == "" or re.search(r"[\x00-\x1f\x7f/\\:]", name):
        raise DatasetError(
            f"{what}: {name[:100]!r} is not a plain name (1 to 100 characters, no slash, colon or dots alone)"
        )
    return name


def numbered_id(label: str, number: int) -> str:
    """Return the id of a sample that was given none: `<object>/<number>`."""
    return f"{label}/{number:06d}"


def renamed_id(sample_id: str, label: str) -> str:
    """Return the id of a sample that is assigned to another object."""
    return f"{label}/{sample_id.partition('/')[2]}"


def id_number(sample_id: str) -> int:
    """Return the number in an id of `numbered_id`, else 0; names of 10 digits are unix times."""
    name = sample_id.rpartition("/")[2]
    return int(name) if 6 <= len(name) <= 9 and name.isdecimal() and name.isascii() else 0


def check_id(sample_id: str, label: str) -> None:
    """Check that an id is `<object>/<name>` for the object `label`; a `DatasetError` if it is not; names the rule."""
    head, slash, name = sample_id.partition("/")
    if not slash or head != label:
        raise DatasetError(f"id: {sample_id[:200]!r} is not {label[:100]!r}, a slash and a name")
    check_name(head, "object")
    check_name(name, "id")
