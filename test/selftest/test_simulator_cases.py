# SPDX-License-Identifier: Apache-2.0
"""The simulator at its limits: degenerate meshes and scenes, and every effect at its bounds."""

import pytest

from foretouch.selftest.case import HardCase, fault
from foretouch.selftest.simulator import simulator_cases


@pytest.mark.parametrize("case", list(simulator_cases()), ids=lambda case: case.name)
def test_case(case: HardCase) -> None:
    assert not fault(case)
