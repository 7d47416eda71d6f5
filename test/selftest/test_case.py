# SPDX-License-Identifier: Apache-2.0
"""What counts as a fault of a hard case."""

import warnings

import numpy as np
import pytest

from foretouch.errors import CloudError
from foretouch.selftest.case import HardCase, fault, nearly


def _raise(error: Exception) -> None:
    raise error


class _TwoLinesError(CloudError):
    """Errors of the package have one line, whatever they are made of."""

    def __str__(self) -> str:
        return "too\nsmall"


@pytest.mark.parametrize(
    ("case", "expected"),
    [
        (HardCase("a", lambda: 1.0, right=nearly(1.0)), ""),
        (HardCase("a", lambda: 2.0, right=nearly(1.0)), "the answer is wrong: 2.0"),
        (HardCase("a", lambda: [np.ones(3), {"x": np.nan}]), "the answer is not finite"),
        (HardCase("a", lambda: 1.0, "too small"), "is answered, not refused as 'too small'"),
        (HardCase("a", lambda: _raise(CloudError("is too small")), "too small"), ""),
        (HardCase("a", lambda: _raise(CloudError("is red")), "too small"), "for another reason than 'too small': is red"),
        (HardCase("a", lambda: _raise(CloudError("is red"))), "is refused: is red"),
        (HardCase("a", lambda: _raise(_TwoLinesError("too small")), "too"), "several lines"),
        (HardCase("a", lambda: _raise(ValueError("x"))), "ValueError: x at test_case.py"),
        (HardCase("a", lambda: warnings.warn("dubious", stacklevel=1)), "UserWarning: dubious"),
    ],
)  # fmt: skip
def test_fault(case: HardCase, expected: str) -> None:
    found = fault(case)
    assert expected in found
    assert bool(found) == bool(expected)
