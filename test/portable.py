# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: T201
"""Run all tests that read committed numbers as other processors and machines would: `make test-portable`.

Each line of `ENVIRONMENTS` is one run of the tests with the marker `committed_numbers`; every one that fails is reported.
Further words are passed to pytest. A processor without the instructions of an environment skips it.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

ENVIRONMENTS = (
    # instructions of PyTorch, of OpenBLAS and of NumPy
    "ATEN_CPU_CAPABILITY=default",
    "ATEN_CPU_CAPABILITY=avx2",
    "OPENBLAS_CORETYPE=Haswell",
    "OPENBLAS_CORETYPE=SkylakeX",
    "OPENBLAS_CORETYPE=Zen",
    "OPENBLAS_CORETYPE=Prescott",
    "NPY_DISABLE_CPU_FEATURES=X86_V4,AVX512_ICL,AVX512_SPR",
    # threads
    "OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1",
    "OMP_NUM_THREADS=4 OPENBLAS_NUM_THREADS=4",
    # locale and time
    "LC_ALL=C",
    "TZ=Asia/Kolkata",
    # draws of the tests
    "FORETOUCH_TEST_SEED=1",
    "FORETOUCH_TEST_SEED=2",
    "FORETOUCH_TEST_SEED=3",
)
NEEDED = {"Haswell": "avx2", "Zen": "avx2", "SkylakeX": "avx512f", "=avx2": "avx2"}  # flag of the processor


def missing(environment: str) -> str:
    """The flag of the processor that an environment needs and this one lacks."""
    flags = next((line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("flags")), "")
    return next((flag for word, flag in NEEDED.items() if word in environment and flag not in flags.split()), "")


def main(words: list[str]) -> int:
    """Run the tests in each environment; returns 1 if they fail in one."""
    failed = []
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "-m", "committed_numbers", *words]
    for environment in ENVIRONMENTS:
        if flag := missing(environment):
            print(f"{environment}: skipped, the processor has no {flag}", flush=True)
            continue
        began = time.monotonic()
        added = dict(pair.split("=", 1) for pair in environment.split())
        done = subprocess.run(command, env={**os.environ, **added}, capture_output=True, text=True, check=False)
        lines = done.stdout.strip().splitlines() or [done.stderr.strip()]
        print(f"{environment}: {lines[-1]} ({time.monotonic() - began:.0f} s)", flush=True)
        if done.returncode:
            failed.append(environment)
            print("\n".join(f"  {line}" for line in lines if line.startswith(("FAILED", "ERROR"))), flush=True)
    print(f"failed in: {'; '.join(failed)}" if failed else "passed in all environments")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
