# SPDX-License-Identifier: Apache-2.0
"""What a command returned and printed, for tests of the command line."""

import json
from dataclasses import dataclass
from typing import Any


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
