# SPDX-License-Identifier: Apache-2.0
"""Compiled loops for what NumPy cannot do quickly: C functions in one library, called through ctypes.

Each function has a NumPy form beside its caller, which is used where the library is absent (no compiler when the package
was installed, another platform, or `FORETOUCH_KERNELS=0`) and which the tests compare it with. ctypes releases the
interpreter's lock during a call, so that other threads run meanwhile. Loading takes 0.2 ms, nothing is compiled at run
time, and no build needs more than a C compiler; Numba would take 0.65 s at each start and 200 MB.

    _count = Kernel("count_range", np.float32, int, float, float, np.int64)
    if _count:
        _count(xyz, len(xyz), low, high, counts)
"""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any, Final

import numpy as np

_SCALARS: Final[dict[Any, type[Any]]] = {int: ctypes.c_int64, float: ctypes.c_double}


def _load() -> tuple[ctypes.CDLL | None, str]:
    if os.environ.get("FORETOUCH_KERNELS") == "0":
        return None, "switched off by FORETOUCH_KERNELS=0"
    folder = Path(__file__).parent
    for suffix in EXTENSION_SUFFIXES:
        path = folder / f"_kernels{suffix}"
        if path.is_file():
            try:
                library = ctypes.CDLL(str(path))
            except OSError as err:
                return None, f"{path}: {err}"
            if not _is_current(library, folder):
                return None, "compiled from other sources than those beside it: install foretouch again (make setup)"
            return library, ""
    return None, "not compiled when the package was installed (no C compiler?)"


def _is_current(library: ctypes.CDLL, folder: Path) -> bool:
    """Whether the library was compiled from the sources beside it; a checkout has some, an installed package none."""
    files = sorted(folder.glob("*.[ch]"))
    if not files:
        return True
    try:
        library.sources.restype = ctypes.c_char_p
        compiled: bytes = library.sources()
    except AttributeError:  # before it was stored
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
_library, why_absent = _load()
_enabled = _library is not None


@contextmanager
def disabled() -> Iterator[None]:
    """Use the NumPy forms within the context, in all threads: for tests and benchmarks."""
    global _enabled  # noqa: PLW0603
    before, _enabled = _enabled, False
    try:
        yield
    finally:
        _enabled = before


class Kernel:
    """A C function without a result; false where it is not available, so that the caller uses its NumPy form.

    Args:
        name: Of the function.
        types: Of its arguments: a NumPy type for a contiguous array of it, `int` for int64, `float` for double.
    """

    def __init__(self, name: str, *types: type[Any]) -> None:
        self._name = name
        kinds = [_SCALARS.get(one) or np.dtype(one) for one in types]
        self._arrays = tuple((i, one) for i, one in enumerate(kinds) if isinstance(one, np.dtype))
        self._call: Any = None
        if _library is not None:
            self._call = getattr(_library, name)
            self._call.restype = None
            self._call.argtypes = [ctypes.c_void_p if isinstance(one, np.dtype) else one for one in kinds]

    def __bool__(self) -> bool:
        return _enabled

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
        if self._call is None:
            raise RuntimeError(f"{self._name}: {why_absent}")
        self._call(*passed)
