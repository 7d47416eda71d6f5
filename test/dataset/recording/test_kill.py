# SPDX-License-Identifier: Apache-2.0
"""The short form of the campaign of `benchmarks/recorder`: a recorder killed at random instants loses nothing."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

CAMPAIGN = Path(__file__).parents[3] / "benchmarks" / "recorder" / "kill.py"


@pytest.mark.slow
def test_eight_kills_lose_no_acknowledged_sample() -> None:
    command = [sys.executable, CAMPAIGN, "--rounds", "8", "--seed", "5", "--json"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    result = json.loads(ended.stdout)
    assert (result["kills"], result["lost"], result["wrong"], result["not_clean"]) == (8, 0, 0, 0)
    assert result["acknowledged"] >= 4  # every second kill waits for a sample, however slow the machine is
    assert any(one["found"] for one in result["rounds"])
