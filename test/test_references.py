# SPDX-License-Identifier: Apache-2.0
"""The short form of `benchmarks/references/bench.py`: every numerical kernel stays within its bound C ε κ."""

from __future__ import annotations

import csv
import importlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.committed_numbers

FOLDER = Path(__file__).parents[1] / "benchmarks" / "references"
LEVELS = 3  # the benign end of each family, its middle and its hard end
sys.path.insert(0, str(FOLDER))
reference = importlib.import_module("reference")
for group in ("clouds", "grasps", "models", "touch"):
    importlib.import_module(f"kernels_of_{group}")
sys.path.remove(str(FOLDER))


@pytest.mark.parametrize("one", reference.KERNELS, ids=lambda one: one.name)
def test_the_error_is_within_its_bound(one) -> None:
    for case in reference.measure(one, LEVELS, 1, seed=1):
        assert reference.ratio(one, case) <= one.constant, case


def test_a_difference_of_large_numbers_breaks_the_bound() -> None:
    def family(t: float, rng: np.random.Generator) -> tuple[float, float]:
        x = 1e4 + 0.05 * rng.normal(size=50)
        exact = reference.exact(x)
        variance = (exact**2).sum() / 50 - (exact.sum() / 50) ** 2
        computed = (x**2).mean() - x.mean() ** 2  # the mistake
        return 1e4 / 0.05, reference.relative_gap(computed, variance)

    broken = replace(next(one for one in reference.KERNELS if one.name == "object identity: grasp"), family=family)
    assert max(reference.ratio(broken, case) for case in reference.measure(broken, 3, 1)) > 100.0 * broken.constant


def test_an_error_that_is_not_a_number_breaks_the_bound() -> None:
    assert reference.ratio(reference.KERNELS[0], reference.Case(1.0, float("nan"))) == float("inf")


def test_the_committed_table_has_every_kernel_with_its_bound() -> None:
    readme = (FOLDER / "README.md").read_text(encoding="utf-8")
    with (FOLDER / "results.csv").open(encoding="utf-8") as file:
        rows = {row["kernel"]: row for row in csv.DictReader(file)}
    assert list(rows) == [one.name for one in reference.KERNELS]
    for one in reference.KERNELS:
        row = rows[one.name]
        assert (row["of"], row["error"], row["kappa"]) == (one.of, one.error, one.condition)
        assert (float(row["C"]), float(row["epsilon"])) == (one.constant, float(f"{one.epsilon:.3g}"))
        assert float(row["worst"]) <= one.constant
        error, condition = (text.replace("|", "\\|") for text in (one.error, one.condition))
        assert f"| {one.name} | `{one.of}` | {error} | {condition} |" in readme
