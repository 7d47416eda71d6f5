# SPDX-License-Identifier: Apache-2.0
"""Tactile readings, and predictions of them, one or K of them as columns."""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Final, Literal, NamedTuple, Self, overload

import numpy as np
import numpy.typing as npt

from foretouch.errors import ForetouchError, TactileError, checked, require_type, shown
from foretouch.types.arrays import (
    FLAGS,
    TEXT,
    Bool,
    ByValue,
    Columns,
    Float64,
    Objects,
    Rows,
    column,
    numbers,
    objects,
    plain,
)
from foretouch.types.channels import NO_CHANNELS, Channel, Channels
from foretouch.types.grasps import Grasp, Grasps
from foretouch.types.summary import Summarised, counted, names_of, spread, summary_text, tallied
from foretouch.types.tables import LabelledTable, Tabular, Variable, labels_of, texts

Reference = Literal["none", "tare", "touches", "history"]

LATE: Final = "late"
"""Flag of a prediction of an old cloud."""

UNKNOWN_FRAME: Final = "unknown_frame"
"""Flag of the answer to a request in another frame than the graph's clouds, where no transform is known."""


_NO_CHANNELS: Final = "not Channels, such as model.sensor.channels"


@dataclass(frozen=True, eq=False, repr=False)
class Touch(Summarised, ByValue):
    """A tactile reading of both fingers, in the unit of each channel.

    Raises:
        TactileError: If the shape is wrong. Values are checked by `foretouch.tactile.touch_faults`.
    """

    values: Float64  # (D,) float64, in the order of `channels`; for the BioTac SP (50,): PDC_TH, PDC_MF, E_TH, E_MF
    channels: Channels  # what they are

    def __post_init__(self) -> None:
        require_type(self.channels, Channels, "channels", _NO_CHANNELS, TactileError)
        values = numbers(self.values, "touch", TactileError)
        if values.shape != (self.channels.size,):
            raise TactileError(f"touch: shape {values.shape} is not ({self.channels.size},) of {self.channels.sensor}")
        object.__setattr__(self, "values", values)

    @classmethod
    @checked
    def of(cls, channels: Channels, /, **parts: npt.ArrayLike) -> Self:
        """Make a reading of named parts, so that no order of values has to be known.

        Args:
            channels: What the values are, such as `model.sensor.channels`.
            parts: By modality a number or (N,), such as `PDC_TH=…, PDC_MF=…, E_TH=…, E_MF=…`; or by channel of both fingers
                (F,) or (F, N), such as `PDC=…, E=…`.

        Raises:
            TactileError: If a part is unknown, missing, given twice, or of another shape.
        """
        require_type(channels, Channels, "channels", _NO_CHANNELS, TactileError)
        values, given = np.full(channels.size, np.nan), np.zeros(channels.size, np.bool_)
        for name, part in parts.items():
            array = numbers(part, name, TactileError)
            places = channels.part(np.arange(channels.size, dtype=np.float64), name).astype(np.intp)
            if array.shape != places.shape and not (array.size == places.size == 1):
                raise TactileError(f"{name}: shape {array.shape} is not {places.shape}")
            if given[places].any():
                raise TactileError(f"{name}: is given twice, as a channel and as a modality")
            values[places], given[places] = array, True
        if missing := [name for name, own in channels.modality_columns.items() if not given[own].all()]:
            raise TactileError(f"touch: {', '.join(missing)} of {channels.sensor} is missing")
        return cls(values, channels)

    def _instead(self, name: str) -> str:
        return f'touch["{name}"]' if name in self.channels.part_names else super()._instead(name)

    def _summary(self) -> tuple[str, dict[str, str]]:
        return shown(self.channels.sensor, 60), {
            name: _range_text(self[name], channel) or "unknown" for name, channel in self.channels.channel_of.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON: by modality a number or a list; None for what is NaN."""
        return {name: plain(part) for name, part in self.parts().items()}

    @classmethod
    def unknown(cls, channels: Channels) -> Self:
        """Return a reading of which nothing is known: all NaN."""
        return cls(np.full(channels.size, np.nan), channels)

    def __getitem__(self, name: str) -> Float64:
        """Return values of a channel, such as E: (F, N), or (F,) of a scalar; or of a modality, such as E_TH: (M,).

        A `TactileError` if no channel or modality has that name.
        """
        return self.channels.part(self.values, name)

    def parts(self) -> dict[str, float | Float64]:
        """Return values by modality: a number where it has one, else (M,) float64."""
        parts = {name: self[name] for name in self.channels.modalities}
        return {name: float(part[0]) if len(part) == 1 else part for name, part in parts.items()}


@dataclass(frozen=True)
class Evidence:
    """How many readings a prediction was adapted to, and how old they are."""

    touches: int = 0  # of the same object
    touch_age_s: float | None = None  # since the last touch of the object [s]; None without, or if it is not known
    readings: int = 0  # of the hand in all, touches of any object and tares
    reading_age_s: float | None = None  # since the last of them [s]; None without, or if it is not known


_NO_EVIDENCE: Final = Evidence()


class Predicted(NamedTuple):
    """Predicted values of one channel, arrays of the same shape: (F, N) of taxels, (F,) of a scalar; (K, …) of K grasps."""

    value: Float64
    lower: Float64  # bounds of the prediction intervals; NaN without calibration
    upper: Float64

    def __repr__(self) -> str:
        return summary_text(
            "Predicted", str(np.shape(self.value)), {name: spread(end) for name, end in self._asdict().items()}
        )


@dataclass(frozen=True, eq=False, repr=False)
class Predictions(Summarised, Tabular, Columns, Sequence["Prediction"]):
    """Predicted readings of both fingertips for K grasps, as columns.

    `predictions["E"]` has arrays by finger of one channel, `predictions[k]` is the prediction for one grasp, and a slice
    or a mask selects several. Numbers are NaN where there is no prediction or no calibration, in the unit of each channel.
    """

    fault: ClassVar[type[ForetouchError]] = TactileError

    value: Float64 = column(None)  # (K, D) float64, in the order of `channels`
    grasps: Grasps = column()  # K grasps
    channels: Channels = NO_CHANNELS  # what the D values are
    lower: Float64 = column(None, default=np.nan)  # (K, D) float64, lower bounds of the prediction intervals
    upper: Float64 = column(None, default=np.nan)  # (K, D) float64, upper bounds
    # (K,) tuples of `out_of_range`, `unfamiliar` and its reasons, `similar_touches`, `equal_pressure`, `off_object`,
    # `assumed_table`, `late`, `fallback_model`, `ambiguous_target`, `selected`, `unknown_frame` (docs/planners.md)
    flags: Objects = column(default=(), dtype=FLAGS)
    status: Objects = column(default="ok", dtype=TEXT)  # (K,) `ok`, `bad_grasp`: no hand can execute it, or `refused`
    reason: Objects = column(default="", dtype=TEXT)  # (K,) why it was refused; "" if ok
    reference: Objects = column(default="none", dtype=TEXT)  # (K,) kind of the readings that it was adapted to
    evidence: Objects = column(
        default=_NO_EVIDENCE, dtype=(Evidence, "Evidence")
    )  # (K,) `Evidence`, the readings behind `reference`

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", numbers(self.value, "value", TactileError))
        require_type(self.channels, Channels, "channels", _NO_CHANNELS, TactileError)
        require_type(self.grasps, Grasps, "grasps", "not Grasps, such as Grasps.of([grasp])", TactileError)
        for name in ("lower", "upper"):
            if (end := numbers(getattr(self, name), name, TactileError)).ndim == 0 and np.isnan(end):
                object.__setattr__(self, name, np.full(np.shape(self.value), np.nan))
        super().__post_init__()
        size = self.channels.size
        for name in ("value", "lower", "upper"):
            if (shape := getattr(self, name).shape) != (len(self), size):
                rule = f"({len(self)}, {size}) of {self.channels.sensor or 'no sensor: pass channels'}"
                raise TactileError(f"{name}: shape {shape} is not {rule}")

    def _instead(self, name: str) -> str:
        return f'predictions["{name}"]' if name in self.channels.part_names else super()._instead(name)

    def _summary(self) -> tuple[str, dict[str, str]]:
        return f"{counted(len(self), 'grasp')}: {tallied(self.status)}", {
            **_range_texts(self),
            "adapted to": tallied(self.reference),
            "flags": tallied(flag for flags in self.flags for flag in flags),
            "refused": names_of(list(dict.fromkeys(filter(None, self.reason)))[:1]),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON: the sensor, and `predictions`, each as `Prediction.to_dict`."""
        sensor = {"sensor": self.channels.sensor, "sensor_sha256": self.channels.sha256}
        return {**sensor, "predictions": [prediction.to_dict() for prediction in self]}

    def _table(self) -> LabelledTable:
        channels = self.channels
        variables = dict(self.grasps._table().variables)  # noqa: SLF001  of the same base
        for channel in channels.channels:
            part = np.stack(self[channel.name], axis=-1)
            dims = ("grasp", "finger", "taxel")[: part.ndim - 1]
            variables[channel.name] = Variable((*dims, "end"), part, channel.unit)
        for name in ("status", "reason", "flags", "reference"):
            variables[name] = Variable(("grasp",), texts(getattr(self, name)))
        facts = {"sensor": channels.sensor, "sensor_sha256": channels.sha256}
        return LabelledTable(variables, labels_of(channels), facts)

    @classmethod
    def refused(
        cls, grasps: Grasps, channels: Channels, status: str | list[str], reason: str | list[str]
    ) -> "Predictions":
        """Make rows without a value, of grasps that were refused.

        Args:
            grasps: K grasps.
            channels: What the values would be.
            status: Of all, or a list of K.
            reason: Of all, or a list of K.
        """
        require_type(channels, Channels, "channels", _NO_CHANNELS, TactileError)
        columns: dict[str, Any] = {"status": status, "reason": reason}
        return cls(np.full((len(grasps), channels.size), np.nan), grasps, channels, **columns)

    @property
    def ok(self) -> Bool:
        """(K,) bool, which grasps have a prediction."""
        return np.asarray(self.status == "ok", np.bool_)

    def flagged(self, flag: str, rows: Bool | bool = True) -> "Predictions":
        """Return the same predictions with another flag.

        Args:
            flag: Its name.
            rows: (K,) bool, the rows that get it; True for all.
        """
        return self.marked((flag, rows))

    def marked(self, *marks: tuple[str, Bool | bool]) -> "Predictions":
        """Return the same predictions with further flags: pairs of a name, and of the rows as of `flagged`; in this order."""
        flags = self.flags.tolist()
        for mark in marks:
            flag, rows = mark if isinstance(mark, tuple) and len(mark) == 2 else (mark, None)
            mask = _mask_of(flag, rows, len(flags))
            if mask is False or not (mask is True or mask.any()):
                continue
            if mask is True or mask.all():
                flags = [(*own, flag) for own in flags]
            else:
                flags = [(*own, flag) if mark else own for own, mark in zip(flags, mask.tolist(), strict=True)]
        result = copy.copy(self)  # whose other columns are checked
        object.__setattr__(result, "flags", objects(flags))
        return result

    @overload
    def __getitem__(self, rows: int) -> "Prediction": ...
    @overload
    def __getitem__(self, rows: str) -> Predicted: ...
    @overload
    def __getitem__(self, rows: Rows) -> "Predictions": ...
    def __getitem__(self, rows: int | str | Rows) -> "Prediction | Predicted | Predictions":
        if isinstance(rows, int | np.integer):
            return Prediction(self, rows)
        if isinstance(rows, str):
            return Predicted(*(self.channels.part(end, rows) for end in (self.value, self.lower, self.upper)))
        return self.take(rows)

    def __iter__(self) -> Iterator["Prediction"]:
        return (Prediction(self, k) for k in range(len(self)))


class Prediction(Summarised):
    """The predicted reading of both fingertips if one grasp were executed: a row of `Predictions`."""

    __slots__ = ("_k", "_rows")

    def __init__(self, rows: Predictions, k: int = 0) -> None:
        require_type(
            rows, Predictions, "rows", "not Predictions, such as of model.predict(object, grasps)", TactileError
        )
        self._rows, self._k = rows, rows.place_of(k)

    @classmethod
    def of(
        cls, grasp: Grasp, value: Touch, lower: Touch | None = None, upper: Touch | None = None, **others: Any
    ) -> Self:
        """Make a prediction of its parts.

        Args:
            grasp: The grasp.
            value: The predicted reading.
            lower: Lower bounds; NaN by default.
            upper: Upper bounds; NaN by default.
            others: Further columns of `Predictions` by name, such as `flags` and `reference`.
        """
        for name, end in {"value": value, "lower": lower or value, "upper": upper or value}.items():
            require_type(end, Touch, name, "not a Touch, such as Touch(values, model.sensor.channels)", TactileError)
        lower, upper = (end or Touch.unknown(value.channels) for end in (lower, upper))
        columns: dict[str, Any] = {name: [cell] for name, cell in others.items()}
        ends = {"lower": lower.values[None], "upper": upper.values[None]}
        return cls(Predictions(value.values[None], Grasps.of([grasp]), value.channels, **ends, **columns))

    def __eq__(self, other: object) -> bool:
        return self.row == other.row if isinstance(other, Prediction) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.row)

    def __getitem__(self, name: str) -> Predicted:
        """Return values and bounds of a channel, such as E: (F, N), or (F,) of a scalar; a `TactileError` names an unknown one."""
        return Predicted(*(self.channels.part(end.values, name) for end in (self.value, self.lower, self.upper)))

    def _instead(self, name: str) -> str:
        return f'prediction["{name}"]' if name in self.channels.part_names else super()._instead(name)

    def _summary(self) -> tuple[str, dict[str, str]]:
        touches = self.evidence.touches
        return self.status, {
            **_range_texts(self.row),
            "adapted to": f"{self.reference} {touches}" if touches else self.reference,
            "flags": names_of(self.flags),
            "refused": self.reason,
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, as `foretouch predict --json` prints it.

        The grasp (None if its numbers are none); `value`, `lower` and `upper` of each modality, None where there is no prediction
        or no calibration; reference, evidence, flags, status and reason.
        """
        ends = {"value": self.value.to_dict() if self.ok else {}}
        ends |= {"lower": self.lower.to_dict(), "upper": self.upper.to_dict()} if self.calibrated else {}
        return {
            "grasp": self.row.grasps.to_dict()["grasps"][0],
            **{
                name: {end: ends.get(end, {}).get(name) for end in ("value", "lower", "upper")}
                for name in self.channels.modalities
            },
            "reference": self.reference,
            "evidence": asdict(self.evidence),
            "flags": list(self.flags),
            "status": self.status,
            "reason": self.reason,
        }

    @property
    def row(self) -> Predictions:
        """The prediction as columns of one row."""
        return self._rows.take(slice(self._k, self._k + 1))

    @property
    def channels(self) -> Channels:
        """What the values are."""
        return self._rows.channels

    @property
    def grasp(self) -> Grasp:
        """The grasp; a `GraspError` if its numbers are none."""
        return self._rows.grasps[self._k]

    @property
    def value(self) -> Touch:
        """The predicted reading; NaN unless `status` is "ok"."""
        return Touch(self._rows.value[self._k], self.channels)

    @property
    def lower(self) -> Touch:
        """Lower bounds of the prediction intervals; NaN without calibration."""
        return Touch(self._rows.lower[self._k], self.channels)

    @property
    def upper(self) -> Touch:
        """Upper bounds of the prediction intervals; NaN without calibration."""
        return Touch(self._rows.upper[self._k], self.channels)

    @property
    def calibrated(self) -> bool:
        """Whether there are bounds."""
        return bool(np.isfinite(self._rows.lower[self._k]).all())

    @property
    def ok(self) -> bool:
        """Whether there is a prediction."""
        return self.status == "ok"

    @property
    def flags(self) -> tuple[str, ...]:
        """Flags such as `out_of_range` and `unfamiliar`; `Predictions.flags` lists all."""
        return tuple(self._rows.flags[self._k])

    @property
    def status(self) -> str:
        """`ok`, `bad_grasp` (no hand can execute it), or `refused`; in a message also what else its sender had to refuse."""
        return str(self._rows.status[self._k])

    @property
    def reason(self) -> str:
        """Why it was refused; "" if ok."""
        return str(self._rows.reason[self._k])

    @property
    def reference(self) -> Reference:
        """Kind of the tactile readings to which it was adapted."""
        reference: Reference = self._rows.reference[self._k]
        return reference

    @property
    def evidence(self) -> Evidence:
        """The readings behind `reference`."""
        evidence: Evidence = self._rows.evidence[self._k]
        return evidence


def _mask_of(flag: Any, rows: Any, count: int) -> Bool | bool:
    """Return the rows that get a flag; a `TactileError` if they are no mask, or the flag is no text."""
    mask = rows if isinstance(rows, bool) else np.asarray(rows)
    if (
        not isinstance(mask, bool)
        and mask.dtype.kind in "iu"
        and mask.shape == (count,)
        and np.isin(mask, (0, 1)).all()
    ):
        mask = mask.astype(np.bool_)
    fits = isinstance(mask, bool) or (mask.dtype.kind == "b" and mask.shape in ((), (count,)))
    if not fits or not isinstance(flag, str):
        rule = f"is no name with True, or with a mask of shape ({count},)"
        raise TactileError(f"flag: {shown(flag, 60)}, {shown(rows, 60)}: {rule}")
    return mask


_MODALITIES: Final = 5  # of a summary


def _range_text(values: Float64, channel: Channel, half: Float64 | None = None) -> str:
    """Return the range of values of a channel with their mean half width and unit, for a summary; "" of none."""
    if not (text := spread(values, channel.text)):
        return ""
    known = np.empty(0) if half is None else half[np.isfinite(half)]
    return f"{text}{f' ± {channel.text(float(known.mean()))}' if known.size else ''} {channel.unit}".rstrip()


def _range_texts(rows: Predictions) -> dict[str, str]:
    """Return the ranges of the first modalities of K predictions."""
    texts_ = {}
    for name, channel in list(rows.channels.channel_of.items())[:_MODALITIES]:
        value, lower, upper = rows[name]
        texts_[name] = _range_text(value, channel, (upper - lower) / 2.0)
    return texts_


def evidence_text(reference: str, touches: int, readings: int) -> str:
    """Describe a reference.

    Args:
        reference: Its name, such as `touches`.
        touches: Number of touches that a prediction was adapted to.
        readings: Number of readings that it was adapted to.
    """
    texts = {
        "none": "cloud only",
        "touches": f"{touches} touch{'' if touches == 1 else 'es'}",
        "history": f"history of {readings} readings",
    }
    return texts.get(reference, reference)
