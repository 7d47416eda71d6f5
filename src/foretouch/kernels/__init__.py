# SPDX-License-Identifier: Apache-2.0
"""Compiled loops for what NumPy cannot do quickly: the C functions of `kernels.h`, called through cffi.

The library is compiled when foretouch is installed, and required: importing this package without it, or with one of
other sources than those beside it, raises a `MissingDependencyError` with the fix. `test/kernels` compares each function
with a plain NumPy or SciPy reference, but for `find_background`, whose tests are rooms. The interpreter's lock is released during a call, so that other threads run
meanwhile. No build needs more than a C compiler; Numba would take 0.65 s at each start and 200 MB.

    count_range = Kernel("count_range")
    count_range(xyz, len(xyz), low, high, counts)
"""

from hashlib import sha256
from pathlib import Path
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np

from foretouch.errors import MissingDependencyError

_FOLDER: Final = Path(__file__).parent
_AGAIN: Final = "(make setup, or pip install .)"
_FIX: Final = f"install a C compiler (apt install gcc), then foretouch again {_AGAIN}"

try:
    from ._kernels import ffi, lib
except ImportError as err:
    raise MissingDependencyError(f"{_FOLDER}: the compiled kernels cannot be loaded: {err}: {_FIX}") from err

_from_buffer: Final = ffi.from_buffer
_POINTERS: Final = {
    np.dtype(kind): ffi.typeof(f"{name}[]")
    for kind, name in (
        (np.float32, "float"),
        (np.float64, "double"),
        (np.int32, "int32_t"),
        (np.int64, "int64_t"),
        (np.uint8, "uint8_t"),
        (np.uint16, "uint16_t"),
    )
}

_TYPES: Final = {pointer.item.cname: (dtype, pointer) for dtype, pointer in _POINTERS.items()}
_KEPT: Final = WeakKeyDictionary[Any, Any]()  # what structs point to


def _check_sources() -> None:
    """Refuse a library of other sources than those beside it; a checkout has some, an installed package none."""
    files = sorted(_FOLDER.glob("*.[ch]"))
    expected = sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
    if files and ffi.string(lib.sources()).decode() != expected:
        fix = f"after an update of the sources install foretouch again {_AGAIN}"
        raise MissingDependencyError(f"{_FOLDER}: the kernels were compiled from other sources: {fix}")


_check_sources()


def struct(name: str, **fields: Any) -> Any:
    """Make a C struct of `kernels.h`, as an argument of a kernel.

    Args:
        name: Name of the struct.
        fields: Numbers, and contiguous arrays of the types that the struct declares. They are kept as long as the struct.

    Returns:
        A pointer to the struct.

    Raises:
        TypeError: If an array has another dtype or is not contiguous, or a number is of another type.
    """
    parts = {field: _argument(value) for field, value in fields.items()}
    pointer = ffi.new(f"{name} *", parts)
    _KEPT[pointer] = parts
    return pointer


def _argument(value: Any) -> Any:
    return _from_buffer(_POINTERS[value.dtype], value) if isinstance(value, np.ndarray) else value


class Kernel:
    """A C function without a result.

    Args:
        name: Name of the function in `kernels.h`.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._call = getattr(lib, name)
        kinds = ffi.typeof(self._call).args
        self._count = len(kinds)
        self._arrays = [  # place among the arguments, type of the numbers, and pointer to them
            (place, *_TYPES[kind.item.cname])
            for place, kind in enumerate(kinds)
            if kind.kind == "pointer" and kind.item.kind == "primitive"
        ]

    def __call__(self, *arguments: Any) -> None:
        """Call the function.

        Args:
            arguments: Numbers, structs (see `struct`), and contiguous arrays of the types that the function is declared with.

        Raises:
            TypeError: If an array has another dtype or is not contiguous, or a number is of another type.
        """
        values = list(arguments)
        try:
            if len(values) != self._count:
                raise TypeError(f"{len(values)} arguments, not {self._count}")
            for place, dtype, pointer in self._arrays:
                if values[place].dtype != dtype:
                    raise TypeError(f"argument {place} is an array of {values[place].dtype!r}, not of {dtype!r}")
                values[place] = _from_buffer(pointer, values[place])
            self._call(*values)
        except (AttributeError, TypeError, ValueError) as err:
            raise TypeError(f"{self._name}: {err}") from err
