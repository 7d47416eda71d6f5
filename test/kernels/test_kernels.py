# SPDX-License-Identifier: Apache-2.0
"""The compiled functions: loaded here, refused arguments, switched off, and the same answers without them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from foretouch import kernels
from foretouch.cloud.segmentation.crop import CropConfig, count_range


def test_they_are_compiled_and_loaded_here() -> None:
    """`make setup` compiles them; without a C compiler everything below would compare NumPy with itself."""
    assert kernels.why_absent == ""
    assert kernels.Kernel("count_range", np.float32, int, float, float, np.int64)


@pytest.mark.parametrize(
    "xyz", [np.zeros((4, 3)), np.zeros((4, 6), np.float32)[:, ::2]], ids=["of another dtype", "not contiguous"]
)
def test_an_array_that_would_be_misread_is_refused(xyz: np.ndarray) -> None:
    kernel = kernels.Kernel("count_range", np.float32, int, float, float, np.int64)
    with pytest.raises(TypeError, match="count_range: an array of"):
        kernel(xyz, 4, 0.1, 2.0, np.zeros(2, np.int64))


def test_a_library_of_other_sources_is_not_called(tmp_path: Path) -> None:
    """As in a checkout that was updated and not installed again: its functions may take other arguments."""
    copy = tmp_path / "copied_kernels"
    shutil.copytree(Path(kernels.__file__).parent, copy)
    code = "import copied_kernels; print(copied_kernels.why_absent)"
    reasons = []
    for addition in ("", "/* changed */"):
        with (copy / "crop.c").open("a") as file:
            file.write(addition)
        done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
        reasons.append(done.stdout.strip())
    assert reasons[0] == ""
    assert reasons[1].startswith("compiled from other sources than those beside it")


def test_switched_off_within_a_context() -> None:
    kernel = kernels.Kernel("count_range", np.float32, int, float, float, np.int64)
    with kernels.disabled():
        assert not kernel
    assert kernel


def test_switched_off_by_the_environment() -> None:
    code = "from foretouch import kernels; print(kernels.why_absent); assert not kernels.Kernel('count_range')"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "FORETOUCH_KERNELS": "0"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "switched off by FORETOUCH_KERNELS=0"


@pytest.mark.parametrize("shape", [(0, 3), (1, 3), (7, 9, 3), (70_000, 3)])
def test_count_range_equals_numpy(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    xyz = rng.normal(1.0, 1.0, shape).astype(np.float32)
    flat = xyz.reshape(-1)
    flat[rng.random(flat.size) < 0.2] = np.nan
    flat[:1], flat[-1:] = np.inf, np.float32(2.0)
    compiled = count_range(xyz, CropConfig())
    with kernels.disabled():
        assert compiled == count_range(xyz, CropConfig())
