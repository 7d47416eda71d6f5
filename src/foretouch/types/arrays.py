# SPDX-License-Identifier: Apache-2.0
"""Types of arrays, and classes whose fields are columns: arrays with one row for each of K things."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from dataclasses import replace as replace_fields
from functools import cache
from typing import Any, ClassVar, Final, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from foretouch.errors import ForetouchError, NoSuchRowError, require_type, shown

AnyArray = npt.NDArray[Any]
Bool = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Floating = npt.NDArray[np.floating]
Index = npt.NDArray[np.intp]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
Integer = npt.NDArray[np.integer]
Objects = npt.NDArray[Any]
UInt8 = npt.NDArray[np.uint8]
Rows: TypeAlias = slice | Index | Bool | Sequence[int]

_ROW: Final = "row"  # key of the metadata of a column
_REQUIRED: Final = object()
TEXT: Final = (str, "a text")
FLAGS: Final = ((tuple, list), "a tuple of texts, such as ('late',)")
"""Types of what is no number, and what they are in words."""
_NO_NUMBERS: Final = {"c": "complex numbers", "U": "texts", "S": "texts", "M": "times", "m": "times"}


def numbers(value: Any, name: str, fault: type[ForetouchError]) -> Float64:
    """Convert numbers to float64: arrays, lists, and columns of tables, also of vectors. What is missing or masked is NaN.

    Args:
        value: The numbers.
        name: What they are, for the error.
        fault: Type of the error.

    Raises:
        ForetouchError: Of the type `fault`, if they are no numbers.
    """
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    try:
        return _as_float64(unmasked(value))
    except OverflowError:
        why = "a number is too large"
    except (TypeError, ValueError) as err:
        why = str(err) if str(err) in _NO_NUMBERS.values() else ""
        if "inhomogeneous" in str(err):
            why = "rows of different lengths"
    given = f"an array of {value.dtype}" if isinstance(value, np.ndarray) and value.ndim else shown(value)
    raise fault(f"{name}: {given} is not of numbers{why and ': '}{why}")


def scalar(value: Any, name: str, fault: type[ForetouchError]) -> float:
    """Convert one number to float, as `numbers` does, with its errors; also one if there are several."""
    if type(value) is float:
        return value
    array = numbers(value, name, fault)
    if array.ndim:
        raise fault(f"{name}: shape {array.shape} is not a single number")
    return float(array)


def require_types(record: Any, types: Mapping[str, tuple[Any, str]], fault: type[ForetouchError]) -> None:
    """Check fields of a record.

    Args:
        record: Holds them as attributes.
        types: By name of the field, its type or types, and what that is in words.
        fault: Type of the error.

    Raises:
        ForetouchError: Of the type `fault`; names the first field of another type.
    """
    values = vars(record)
    for name, kind in types.items():
        _require(values[name], kind, name, fault)


def _require(value: Any, kind: tuple[Any, str], name: str, fault: type[ForetouchError]) -> None:
    """Refuse a value of another type, and a flag that is no text."""
    require_type(value, kind[0], name, f"not {kind[1]}", fault)
    for flag in value if kind is FLAGS else ():
        require_type(flag, str, name, "not a text", fault)


def as_pose(pose: Any, fault: type[ForetouchError]) -> Float64:
    """Return a pose as (4, 4) float64; an error of the type `fault` if it is no such matrix, or not finite."""
    matrix = numbers(pose, "pose", fault)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise fault(f"pose: {shown(pose, 60)} is not a matrix (4, 4) of finite numbers")
    return matrix


def as_rows(rows: Any, count: int, name: str) -> slice | Index:
    """Return selected rows as a slice or (n,) indices.

    Args:
        rows: A slice, a mask (count,) bool, or whole numbers, of which negative ones count from the end.
        count: Number of all rows.
        name: Of what they are, for the error.

    Raises:
        NoSuchRowError: If it is something else, or there is no such row.
    """
    array = np.array(None)
    with suppress(TypeError, ValueError):  # of bounds that are no numbers, and rows of different lengths
        if isinstance(rows, slice):
            rows.indices(count)
            return rows
        array = np.asarray(rows)
    if array.dtype == np.bool_ and array.shape == (count,):
        array = np.flatnonzero(array)
    whole = array.ndim == 1 and array.dtype.kind in ("iu" if array.size else "iuf")
    if not whole or (array.size and not -count <= array.min() <= array.max() < count):
        rule = f"it is no slice, mask of shape ({count},) or list of numbers below {count}"
        raise NoSuchRowError(f"{name}[{shown(rows, 60)}]: selects no rows: {rule}")
    return array.astype(np.intp, copy=False)


def unmasked(value: Any) -> AnyArray:
    """Return what NumPy makes an array of as an array, in which what is masked is missing: NaN, NaT or None.

    Raises:
        ValueError: If it is a list of rows of different lengths.
    """
    if isinstance(value, list | tuple) and any(isinstance(part, np.ma.MaskedArray) for part in value):
        value = np.ma.array(value)
    if not isinstance(value, np.ma.MaskedArray):
        return np.asarray(value)
    if not np.ma.getmaskarray(value).any():
        return np.asarray(value.data)
    if value.dtype.kind in "iub":
        value = value.astype(np.float64)
    if value.dtype.kind not in "fcmM":
        return np.asarray(np.where(np.ma.getmaskarray(value), None, value.data.astype(object)), object)
    return np.asarray(value.filled(np.array("NaT", value.dtype) if value.dtype.kind in "mM" else np.nan))


def is_missing(value: Any) -> bool:
    """Return whether a single value is a missing one: None, NaN, NaT, masked, or NA of pandas."""
    if value is None or value is np.ma.masked or type(value).__name__ in ("NAType", "NaTType"):
        return True
    return isinstance(value, float | np.floating | np.datetime64 | np.timedelta64) and bool(value != value)  # noqa: PLR0124


def _as_float64(array: AnyArray) -> Float64:
    """Return an array as float64, missing objects in it as NaN, and objects that are vectors with their dimensions behind its own.

    Raises:
        TypeError, ValueError, OverflowError: If it holds something else than numbers.
    """
    if array.dtype.kind in "fiub":
        return np.asarray(array, np.float64)
    if array.dtype != object:
        raise TypeError(_NO_NUMBERS.get(array.dtype.kind, ""))
    items = [None if is_missing(item) else item for item in array.ravel()]
    if any(isinstance(item, str | bytes) for item in items):
        raise TypeError(_NO_NUMBERS["U"])
    if not any(isinstance(item, np.ndarray | list | tuple) for item in items):
        return np.array([np.nan if item is None else item for item in items], np.float64).reshape(array.shape)
    rows = [None if item is None else _as_float64(unmasked(item)) for item in items]
    nothing = np.full(next(row.shape for row in rows if row is not None), np.nan)
    filled = np.array([nothing if row is None else row for row in rows])
    return filled.reshape(*array.shape, *nothing.shape)


def plain(value: Any) -> Any:
    """Return arrays, tuples and mappings as JSON types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def objects(rows: Sequence[Any] | AnyArray) -> Objects:
    """Return a (K,) column of texts, tuples or other values."""
    return np.fromiter(rows, object, len(rows))


def column(*row: int | None, default: Any = _REQUIRED, dtype: Any = np.float64) -> Any:
    """Declare a column of a `Columns` class.

    Args:
        row: Shape of one row; None for a length that is not fixed.
        default: What all rows hold where no column is given; without a default, the column is required.
        dtype: Of the array; or the type of rows that are no numbers, and what it is in words, such as `TEXT`. A field may also
            hold other `Columns` of the same number of rows.
    """
    if default is _REQUIRED:
        return field(metadata={_ROW: (row, dtype)})
    return field(default=default, metadata={_ROW: (row, dtype)})


class ByValue:
    """Base of dataclasses that are equal where all their fields are, arrays number by number; NaN equals NaN."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return all(_equal(getattr(self, name), getattr(other, name)) for name in _fields(type(self)))

    def __hash__(self) -> int:
        first = getattr(self, _fields(type(self))[0])
        return hash((type(self).__name__, (first + 0.0).tobytes()))  # of -0 as of 0


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if one.dtype != object:
            return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
        one, other = one.tolist(), other.tolist()
    return bool(one == other or (one != one and other != other))  # noqa: PLR0124


@dataclass(frozen=True, eq=False)
class Columns(ByValue):
    """Base of frozen dataclasses with columns; what is given is converted, and one value fills a column.

    Raises:
        ForetouchError: Names a column whose shape does not fit; of the type `fault`.
    """

    fault: ClassVar[type[ForetouchError]] = ForetouchError

    def __post_init__(self) -> None:
        count = -1
        for name, row, dtype in _layout(type(self)):
            value, fits = getattr(self, name), True
            if isinstance(value, Columns):
                shape: tuple[int, ...] = (len(value),)
            else:
                value = self._array(name, dtype, count, row)
                shape = value.shape
                fits = bool(shape) and _fits(shape[1:], row)
            count = shape[0] if count < 0 and shape else count
            if not fits or shape[0] != count:
                wanted = ", ".join([str(count) if count >= 0 else "K", *(str(size or "D") for size in row)])
                raise self.fault(f"{name}: shape {shape} is not ({wanted}{'' if row else ','})")
            object.__setattr__(self, name, value)

    def _array(self, name: str, dtype: Any, count: int, row: tuple[int | None, ...]) -> AnyArray:
        """Return a column as an array; a single value is repeated for each row, where their number is known."""
        value = getattr(self, name)
        if isinstance(dtype, tuple):
            if isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 1:
                return value
            several = isinstance(value, np.ndarray | list)
            for one in value if several else [value]:
                _require(one, dtype, name, self.fault)
            return objects(value if several else [value] * max(count, 0))
        if type(value) is np.ndarray and value.dtype == dtype:
            array = value
        else:
            array = numbers(value, name, self.fault).astype(dtype, copy=False)
        if array.ndim or count < 0:
            return array
        if (
            row and value != type(self).__dataclass_fields__[name].default
        ):  # one number is no direction, and no pressure
            wanted = ", ".join(str(size or "D") for size in (count, *row))
            raise self.fault(f"{name}: {shown(value)} is one number; give an array of shape ({wanted})")
        return np.full((count, *(size or 0 for size in row)), array)

    def __len__(self) -> int:
        return len(getattr(self, _layout(type(self))[0][0]))

    @classmethod
    def column_names(cls) -> tuple[str, ...]:
        """Return names of the columns, in order."""
        return tuple(name for name, *_ in _layout(cls))

    def place_of(self, number: int) -> int:
        """Return the place of a row, which counts from the end if it is negative; a `NoSuchRowError` if it is not there."""
        count = len(self)
        whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if not whole or not -count <= number < count:
            there = f"they are 0 to {count - 1}" if count else "there are none"
            raise NoSuchRowError(f"{type(self).__name__}[{shown(number, 60)}]: is not one of the {count} rows; {there}")
        return range(count)[number]

    def take(self, rows: Rows) -> Self:
        """Select rows by a slice, a mask (K,) or indices; a `NoSuchRowError` if one is not there."""
        rows = as_rows(rows, len(self), type(self).__name__)
        parts = {name: getattr(self, name) for name in self.column_names()}
        taken = {name: part.take(rows) if isinstance(part, Columns) else part[rows] for name, part in parts.items()}
        return self.replace(**taken)

    def put(self, rows: Rows, other: Self) -> Self:
        """Exchange rows, selected by a slice, a mask (K,) or indices, for all rows of another one, as many."""
        name = type(self).__name__
        require_type(other, type(self), "other", f"not {name}", self.fault)
        rows = as_rows(rows, len(self), name)
        if (count := len(np.arange(len(self))[rows])) != len(other):
            raise self.fault(f"other: {len(other)} rows do not take the place of {count}")
        columns: dict[str, Any] = {}
        for name in self.column_names():
            part, new = getattr(self, name), getattr(other, name)
            if isinstance(part, Columns):
                columns[name] = part.put(rows, new)
            else:
                part = part.copy()
                part[rows] = new
                columns[name] = part
        return self.replace(**columns)

    def replace(self, **changes: Any) -> Self:
        """Exchange columns or other fields, as `dataclasses.replace`."""
        return replace_fields(self, **changes)

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Return rows of several of these, one after the other; what is not a column is of the first, and there is at least one."""
        if not parts:
            raise cls.fault(f"parts: there is none; {cls.__name__}.join takes at least one")
        for part in parts:
            require_type(part, cls, "parts", f"not {cls.__name__}", cls.fault)
        if len(parts) == 1:
            return parts[0]
        joined = {}
        for name in cls.column_names():
            columns = [getattr(part, name) for part in parts]
            first = columns[0]
            joined[name] = type(first).join(columns) if isinstance(first, Columns) else np.concatenate(columns)
        return parts[0].replace(**joined)


_layout: "Callable[[Any], tuple[tuple[str, tuple[int | None, ...], Any], ...]]" = cache(
    lambda kind: tuple((info.name, *info.metadata[_ROW]) for info in fields(kind) if _ROW in info.metadata)
)
"""Returns name, shape of a row and dtype of each column of a class."""


_fields: "Callable[[Any], tuple[str, ...]]" = cache(lambda kind: tuple(info.name for info in fields(kind)))


def _fits(shape: tuple[int, ...], row: tuple[int | None, ...]) -> bool:
    if shape == row:
        return True
    return len(shape) == len(row) and all(size in (None, own) for size, own in zip(row, shape, strict=True))
