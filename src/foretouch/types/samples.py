# SPDX-License-Identifier: Apache-2.0
"""One grasp of a dataset, with its cloud and the readings around it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import NoneType
from typing import Any, Final, Literal, get_args

import numpy as np

from foretouch.errors import DatasetError, none_of, require_type, shown
from foretouch.types.arrays import FLAGS, TEXT, AnyArray, Float32, Int64, UInt8, plain, require_types
from foretouch.types.cloud import NO_CLOUD, Cloud, Plane
from foretouch.types.grasps import NO_GRASP, Grasp, Grasps
from foretouch.types.predictions import Touch
from foretouch.types.summary import Summarised, briefly, counted, names_of

REST: Final = 0
APPROACH: Final = 1
HOLD: Final = 2

DISCARDED: Final = "discarded"
"""Flag of a sample that the operator discarded: it stays in the recording, and builds and exports leave it out."""

_LATEST_NS: Final = 2**63  # where stamps end

Outcome = Literal["unknown", "success", "failure"]

OUTCOMES: Final[tuple[Outcome, ...]] = get_args(Outcome)
"""In the order of their numbers in messages."""


@dataclass(frozen=True, eq=False, repr=False)
class TouchSeries(Summarised):
    """The readings around one grasp, in the order of their stamps.

    Raises:
        DatasetError: If the shape of an array is wrong.
    """

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


_STAMPS: Final = ("stamp_ns", "contact_ns", "pairing_error_ns")
_TYPES: Final[dict[str, tuple[Any, str]]] = {
    **dict.fromkeys(("id", "object", "note", "detector", "outcome"), TEXT),
    "grasp": (Grasp, "a Grasp, such as grasps[0]"),
    "candidates": ((tuple, list, Grasps), "a tuple of grasps"),
    "extra": (Mapping, "numbers by name"),
    "flags": FLAGS,
    **dict.fromkeys(("touch", "tare"), ((Touch, NoneType), "a Touch")),
    "series": ((TouchSeries, NoneType), "a TouchSeries"),
    "table": ((Plane, NoneType), "a Plane"),
    "stamp_ns": ((int, np.integer), "a whole number of nanoseconds"),
    **dict.fromkeys(_STAMPS[1:], ((int, np.integer, NoneType), "a whole number of nanoseconds")),
}
"""Types of fields, and what they are in words; the cloud may not have been read yet."""


@dataclass(frozen=True, eq=False, repr=False)
class Sample(Summarised):
    """One grasp of the dataset (P2: <C, g1, g2, R, PDC_TH, PDC_MF, E_TH, E_MF>), and what was recorded with it.

    It is labelled if it has a touch. Without, its grasp is the best planned one.

    Raises:
        DatasetError: If the series is not of the sensor of the touch.
    """

    id: str  # `<object>/<name>`, another for each sample; if it is "", `write` assigns `<object>/<number>`
    object: str  # label of the object
    # By factories, since subclasses read their cloud when it is asked for, and must not find a default in the class.
    cloud: Cloud = field(default_factory=lambda: NO_CLOUD)  # the object's cloud on which the grasp was planned
    grasp: Grasp = field(default_factory=lambda: NO_GRASP)
    touch: Touch | None = None  # reading in contact; None for an unlabelled sample
    tare: Touch | None = None  # reading without contact; None without one
    stamp_ns: int = 0  # time of recording [ns]
    extra: Mapping[str, float] = field(default_factory=dict)  # further values of the source, by name
    candidates: tuple[Grasp, ...] = ()  # the other grasps planned on the same cloud
    outcome: Outcome = "unknown"  # the operator's verdict
    note: str = ""  # the operator's remark
    series: TouchSeries | None = None  # the readings around the grasp
    contact_ns: int | None = None  # stamp of the first contact [ns]
    detector: str = ""  # description of the method that detected the contact
    pairing_error_ns: int | None = None  # widest gap between the requested interval and the readings found [ns]
    flags: tuple[str, ...] = ()  # such as `arrival_stamped`
    # The table in the frame of the cloud. None if it is not known, also where an assumed one is given: then the camera is taken to
    # look straight down on it.
    table: Plane | None = None

    def __post_init__(self) -> None:
        if isinstance(self.table, Plane) and self.table.assumed:
            object.__setattr__(self, "table", None)
        require_types(self, _TYPES, DatasetError)
        values = vars(self)
        if "cloud" in values:
            require_type(self.cloud, Cloud, "cloud", "not a Cloud, such as object.cloud", DatasetError)
        for name in _STAMPS:
            if not -_LATEST_NS < (values[name] or 0) < _LATEST_NS:
                raise DatasetError(f"{name}: {shown(values[name])} is no time [ns]")
        if self.outcome not in OUTCOMES:
            raise DatasetError(f"outcome: {none_of(self.outcome, OUTCOMES)}")
        if self.series is not None and self.touch is not None:
            shape = (len(self.series.stamps_ns), self.touch.channels.size)
            if self.series.counts.shape != shape:
                raise DatasetError(f"series.counts: shape {self.series.counts.shape} is not {shape}")

    def _summary(self) -> tuple[str, dict[str, str]]:
        series = self.series
        return f"{shown(self.id, 40)!r}, {'not ' if self.touch is None else ''}labelled", {
            "object": shown(self.object, 60),
            "cloud": briefly(vars(self)["cloud"]) if "cloud" in vars(self) else "is read when it is used",
            "table": "not known" if self.table is None else briefly(self.table),
            "grasp": briefly(self.grasp) if self.grasp.is_known else "not known",
            "touch": "" if self.touch is None else briefly(self.touch),
            "tare": "" if self.tare is None else briefly(self.tare),
            "series": "" if series is None else counted(len(series.stamps_ns), "reading"),
            "outcome": "" if self.outcome == "unknown" else self.outcome,
            "flags": names_of(self.flags),
            "note": shown(self.note, 60),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON: grasp, table [m], readings by modality (None without), and facts; not cloud and series."""
        return {
            "id": self.id,
            "object": self.object,
            "stamp_ns": self.stamp_ns,
            "grasp": self.grasp.to_dict(),
            "table": None if self.table is None else self.table.coefficients.tolist(),
            "touch": None if self.touch is None else self.touch.to_dict(),
            "tare": None if self.tare is None else self.tare.to_dict(),
            "extra": plain(self.extra),
            "outcome": self.outcome,
            "note": self.note,
            "flags": list(self.flags),
        }

    @property
    def readings(self) -> TouchSeries | None:
        """The series; without one the touch as the only reading, and None without a touch."""
        if self.series is not None or self.touch is None:
            return self.series
        others = {name: np.array([value], np.float32) for name, value in self.extra.items()}
        counts = self.touch.values[None].astype(np.float32)
        return TouchSeries(np.array([self.stamp_ns]), counts, np.array([HOLD], np.uint8), others)
