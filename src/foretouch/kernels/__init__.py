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
from collections.abc import Iterator
from contextlib import contextmanager
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
                return ctypes.CDLL(str(path)), ""
            except OSError as err:
                return None, f"{path}: {err}"
    return None, "not compiled when the package was installed (no C compiler?)"


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
        self._types = tuple(_SCALARS.get(one) or np.dtype(one) for one in types)
        self._call: Any = None
        if _library is not None:
            self._call = getattr(_library, name, None)  # a library that was compiled from older sources may lack it
        if self._call is not None:
            self._call.restype = None
            self._call.argtypes = [ctypes.c_void_p if isinstance(one, np.dtype) else one for one in self._types]

    def __bool__(self) -> bool:
        return _enabled and self._call is not None

    def __call__(self, *arguments: Any) -> None:
        """Call the function.

        Raises:
            TypeError: If an array has another dtype, or is not contiguous; a pointer to it would be read as garbage.
        """
        passed = []
        for kind, value in zip(self._types, arguments, strict=True):
            if not isinstance(kind, np.dtype):
                passed.append(value)
            elif value.dtype == kind and value.flags.c_contiguous:
                passed.append(value.ctypes.data)
            else:
                raise TypeError(f"{self._name}: an array of {value.dtype} is not a contiguous one of {kind}")
        if self._call is None:
            raise RuntimeError(f"{self._name}: {why_absent or 'the library was compiled from older sources'}")
        self._call(*passed)
