# SPDX-License-Identifier: Apache-2.0
"""Compiled loops for what NumPy cannot do quickly: C functions in one library, called through ctypes.

The library is compiled when foretouch is installed, and required: importing this package without it, or with one of
other sources than those beside it, raises a `MissingDependencyError` with the fix. `test/kernels` compares each function
with a plain NumPy or SciPy reference. ctypes releases the interpreter's lock during a call, so that other threads run
meanwhile. Loading takes 0.2 ms, and no build needs more than a C compiler; Numba would take 0.65 s at each start and
200 MB.

    _count = Kernel("count_range", np.float32, int, float, float, np.int64)
    _count(xyz, len(xyz), low, high, counts)
"""

import ctypes
import sys
from hashlib import sha256
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import MissingDependencyError

_SCALARS: Final[dict[Any, type[Any]]] = {int: ctypes.c_int64, float: ctypes.c_double}
_FIX: Final = "install a C compiler (apt install gcc), then foretouch again (make setup, or pip install .)"


def _load() -> ctypes.CDLL:
    folder = Path(__file__).parent
    path = next((one for suffix in EXTENSION_SUFFIXES if (one := folder / f"_kernels{suffix}").is_file()), None)
    if path is None:
        raise MissingDependencyError(f"{folder}: the compiled kernels are absent: {_FIX}")
    try:
        library = ctypes.CDLL(str(path))
    except OSError as err:
        raise MissingDependencyError(f"{path}: {err}: {_FIX}") from err
    if not _is_current(library, folder):
        raise MissingDependencyError(f"{path}: compiled from other sources than those beside it: {_FIX}")
    return library


def _is_current(library: ctypes.CDLL, folder: Path) -> bool:
    """Whether the library was compiled from the sources beside it; a checkout has some, an installed package none."""
    files = sorted(folder.glob("*.[ch]"))
    if not files:
        return True
    try:
        library.sources.restype = ctypes.c_char_p
        compiled: bytes = library.sources()
    except AttributeError:
        return False
    return compiled.decode() == sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


_at = ctypes.c_size_t.from_address
_HEAD: Final = object.__basicsize__


def _is_first_field() -> bool:
    """Whether the address of its numbers is an array's first field after Python's own, as in all of CPython's NumPy so far.

    To read it there takes 0.2 us; `array.ctypes.data` takes 1 us of each argument.
    """
    if sys.implementation.name != "cpython":
        return False
    probe = np.zeros(4)
    return all(
        _at(id(one) + _HEAD).value == one.ctypes.data for one in (probe, probe[1:], np.zeros((2, 3), np.float32))
    )


_first_field = _is_first_field()
_library = _load()


class Kernel:
    """A C function without a result.

    Args:
        name: Of the function.
        types: Of its arguments: a NumPy type for a contiguous array of it, `int` for int64, `float` for double.
    """

    def __init__(self, name: str, *types: type[Any]) -> None:
        self._name = name
        kinds = [_SCALARS.get(one) or np.dtype(one) for one in types]
        self._arrays = tuple((i, one) for i, one in enumerate(kinds) if isinstance(one, np.dtype))
        self._call = getattr(_library, name)
        self._call.restype = None
        self._call.argtypes = [ctypes.c_void_p if isinstance(one, np.dtype) else one for one in kinds]

    def __call__(self, *arguments: Any) -> None:
        """Call the function.

        Raises:
            TypeError: If an array has another dtype, or is not contiguous; a pointer to it would be read as garbage.
        """
        passed = list(arguments)
        for i, kind in self._arrays:
            value = passed[i]
            if value.dtype != kind or not value.flags.c_contiguous:
                raise TypeError(f"{self._name}: an array of {value.dtype} is not a contiguous one of {kind}")
            passed[i] = _at(id(value) + _HEAD).value if _first_field else value.ctypes.data
        self._call(*passed)
