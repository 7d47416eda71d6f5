# SPDX-License-Identifier: Apache-2.0
"""Losses, metrics, preparation, calibration and contact at their limits."""

import pytest

from foretouch.selftest.case import HardCase, fault
from foretouch.selftest.numbers import number_cases


@pytest.mark.parametrize("case", list(number_cases()), ids=lambda case: case.name)
def test_case(case: HardCase) -> None:
    assert not fault(case)
