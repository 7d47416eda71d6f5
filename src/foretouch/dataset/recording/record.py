# SPDX-License-Identifier: Apache-2.0
"""What a recording keeps of one grasp: the sample that models train on, and what is needed to judge it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from foretouch.errors import DatasetError
from foretouch.types import TOUCH_SIZE, Float32, Grasp, GraspSample

__all__ = ["APPROACH", "DISCARDED", "HOLD", "REST", "Identity", "Outcome", "SampleRecord", "TouchSeries", "check_name"]

REST: Final = 0
APPROACH: Final = 1
HOLD: Final = 2

DISCARDED: Final = "discarded"
"""Flag of a sample that the operator does not want; it stays in the recording and goes no further."""

Outcome = Literal["unknown", "success", "failure"]

_FORBIDDEN = re.compile(r"[\x00-\x1f\x7f/\\:]")


@dataclass(frozen=True, kw_only=True)
class Identity:
    """Which hand and which camera; a dataset holds recordings of one of each.

    Attributes:
        hand: Facts by name, such as model, serial number and which of its fingers are thumb and middle finger.
        camera: Such as model, serial number and image size.
    """

    hand: Mapping[str, str]
    camera: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class TouchSeries:
    """The readings around one grasp, in the order of their stamps.

    Attributes:
        stamps_ns: (T,) int64, of the sensor's headers [ns]; equal ones are kept.
        counts: (T, 50) float32: PDC_TH, PDC_MF, E_TH, E_MF [counts].
        phases: (T,) uint8 of REST, APPROACH and HOLD.
        others: Further channels by name, such as `PAC0_TH`: (T,) float32 each [counts].

    Raises:
        DatasetError: If a length or a width is another.
    """

    stamps_ns: npt.NDArray[np.int64]
    counts: Float32
    phases: npt.NDArray[np.uint8]
    others: Mapping[str, Float32] = field(default_factory=dict)

    def __post_init__(self) -> None:
        length = len(self.stamps_ns)
        shapes = {"counts": (length, TOUCH_SIZE), "phases": (length,)}
        found: dict[str, npt.NDArray[Any]] = {"counts": self.counts, "phases": self.phases}
        for name in self.others:
            shapes[f"others.{name}"], found[f"others.{name}"] = (length,), self.others[name]
        for name, shape in shapes.items():
            if found[name].shape != shape:
                raise DatasetError(f"series.{name}: shape {found[name].shape} is not {shape}")


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleRecord:
    """One grasp as it is recorded; labelled where `sample.touch` is there.

    Attributes:
        sample: Its id may be "": the writer then gives `<object>/<number>`. Unlabelled: `grasp` is the best planned.
        candidates: The other grasps planned on the same cloud.
        outcome: As the operator judged it.
        note: Of the operator.
        series: The readings around the grasp.
        contact_ns: Stamp of the first contact [ns].
        detector: What found it, in words.
        pairing_error_ns: Widest gap between the interval that was asked for and the readings found [ns].
        flags: Such as `arrival_stamped`.
    """

    sample: GraspSample
    candidates: tuple[Grasp, ...] = ()
    outcome: Outcome = "unknown"
    note: str = ""
    series: TouchSeries | None = None
    contact_ns: int | None = None
    detector: str = ""
    pairing_error_ns: int | None = None
    flags: tuple[str, ...] = ()


def check_name(name: str, what: str) -> str:
    """A label that can stand in an id and as the name of a folder.

    Args:
        name: The label.
        what: Of what, for the message.

    Returns:
        `name`.

    Raises:
        DatasetError: If it is empty, longer than 100 characters, `.` or `..`, or holds a slash, a colon or a control character.
    """
    if not name or len(name) > 100 or name.strip(".") == "" or _FORBIDDEN.search(name):
        raise DatasetError(
            f"{what}: {name[:100]!r} is no plain name (1 to 100 characters, no slash, colon or dots alone)"
        )
    return name
