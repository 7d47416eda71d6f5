# SPDX-License-Identifier: Apache-2.0
"""What a person or a program sees: one JSON object a line, or tables."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["print_json", "print_table", "warn"]


def print_json(record: Mapping[str, Any]) -> None:
    """One line on stdout. Numbers that are not finite become null, as JSON knows none."""
    sys.stdout.write(json.dumps(_plain(record), allow_nan=False, ensure_ascii=False) + "\n")


def print_table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """A title and, if it has rows, a table; numbers are formatted with their units by the caller."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    console.print(title, style="bold", highlight=False, markup=False, soft_wrap=True)
    if not rows:
        return
    table = Table()
    for column in columns:
        table.add_column(Text(column), justify="left" if column == columns[0] else "right")
    for row in rows:
        table.add_row(*map(Text, row))  # as it is: rich would take `[m]` for a style
    console.print(table)


def warn(message: str) -> None:
    """One line on stderr."""
    print(f"foretouch: {message}", file=sys.stderr)


def _plain(value: Any) -> Any:
    """Arrays, mappings and numbers as what JSON holds."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
