# SPDX-License-Identifier: Apache-2.0
"""Training with too little to learn: one sample, one object, constant labels, readings beyond their ranges."""

import pytest

from foretouch.selftest.case import HardCase, fault
from foretouch.selftest.training import training_cases


@pytest.mark.parametrize("case", list(training_cases()), ids=lambda case: case.name)
def test_case(case: HardCase) -> None:
    assert not fault(case)
