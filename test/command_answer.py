# SPDX-License-Identifier: Apache-2.0
"""What a command or code in a process of its own returned and printed."""

import json
import subprocess
import sys
from dataclasses import dataclass
from typing import Any


def run_python(code: str, timeout: float = 120.0, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh interpreter."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout, **options)


@dataclass
class Answer:
    """What a command returned and printed."""

    status: int
    out: str
    err: str

    def check_refused(self, text: str) -> None:
        """Exit status 1, and one line on stderr that contains a text."""
        assert (self.status, self.err.count("\n")) == (1, 1), self.err
        assert text in self.err

    @property
    def records(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.out.splitlines()]
