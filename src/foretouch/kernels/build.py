# SPDX-License-Identifier: Apache-2.0
"""Describe the library of compiled loops for cffi, as setup.py builds it (`cffi_modules`)."""

import re
from hashlib import sha256
from pathlib import Path

from cffi import FFI

FOLDER = Path("src/foretouch/kernels")  # from setup.py, as setuptools wants it
FILES = sorted(FOLDER.glob("*.[ch]"))

builder = FFI()
builder.cdef(re.sub(r"^#.*$", "", (FOLDER / "kernels.h").read_text(encoding="utf-8"), flags=re.MULTILINE))
builder.set_source(
    "foretouch.kernels._kernels",
    '#include "kernels.h"',
    sources=[str(path) for path in FILES if path.suffix == ".c"],
    depends=[str(path) for path in FILES if path.suffix == ".h"],
    include_dirs=[str(FOLDER)],
    define_macros=[("SOURCES", f'"{sha256(b"".join(path.read_bytes() for path in FILES)).hexdigest()}"')],
    # -Wno-psabi: vectors are only passed between functions that are inlined.
    extra_compile_args=[
        "-std=gnu11",
        "-O3",
        "-ffp-contract=off",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-fno-wrapv",
        "-Wno-psabi",
    ],
    libraries=["m"],
    py_limited_api=False,
)
