# SPDX-License-Identifier: Apache-2.0
"""Hard clouds in every file format: equal to the bit, or refused by name."""

import pytest

from foretouch.selftest.case import HardCase, fault
from foretouch.selftest.files import file_cases


@pytest.mark.parametrize("case", list(file_cases()), ids=lambda case: case.name)
def test_case(case: HardCase) -> None:
    assert not fault(case)
