# SPDX-License-Identifier: Apache-2.0
"""The short form of `benchmarks/references`: every numerical kernel stays within its bound C ε κ."""

from dataclasses import replace

import numpy as np
import pytest
from every_case import every_case

from benchmarks.references import bench, reference

pytestmark = pytest.mark.committed_numbers

LEVELS = 3  # the benign end of each family, its middle and its hard end


def test_errors_are_within_their_bounds() -> None:
    def check(one: reference.Kernel) -> None:
        for case in reference.measure(one, LEVELS, 1, seed=1):
            assert reference.ratio(one, case) <= one.constant, case

    assert [one.name for one in bench.KERNELS] == list(reference.TABLE)
    every_case({one.name: one for one in reference.KERNELS}, check)
    assert all(float(row["worst"]) <= float(row["C"]) for row in reference.TABLE.values())


def test_a_difference_of_large_numbers_and_what_is_no_number_break_the_bound() -> None:
    def family(t: float, rng: np.random.Generator) -> tuple[float, float]:
        x = 1e4 + 0.05 * rng.normal(size=50)
        exact = reference.exact(x)
        variance = (exact**2).sum() / 50 - (exact.sum() / 50) ** 2
        computed = (x**2).mean() - x.mean() ** 2  # the mistake
        return 1e4 / 0.05, reference.relative_gap(computed, variance)

    broken = replace(next(one for one in reference.KERNELS if one.name == "object identity: grasp"), family=family)
    assert max(reference.ratio(broken, case) for case in reference.measure(broken, 3, 1)) > 100.0 * broken.constant
    assert reference.ratio(broken, reference.Case(1.0, float("nan"))) == float("inf")
