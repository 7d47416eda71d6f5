# SPDX-License-Identifier: Apache-2.0
"""The figures of a training for TensorBoard, which is an extra; the run's own log stays the source."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foretouch.errors import ConfigError

__all__ = ["TensorBoardLogger", "open_tensorboard"]


class TensorBoardLogger:
    """Writes one epoch's record after the other.

    Args:
        writer: Of `torch.utils.tensorboard`.
    """

    def __init__(self, writer: Any) -> None:
        self._writer = writer

    def write(self, record: Mapping[str, Any]) -> None:
        """An epoch's `losses` and, where it has one, its `validation`."""
        for name, value in record["losses"].items():
            self._writer.add_scalar(f"losses/{name}", value, record["epoch"])
        if "validation" in record:
            self._writer.add_scalar("validation", record["validation"], record["epoch"])

    def close(self) -> None:
        """Write out what is still held."""
        self._writer.close()


def open_tensorboard(folder: Path) -> TensorBoardLogger:
    """A board in `folder`, beside what an earlier part of the same run wrote.

    Raises:
        ConfigError: If TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as err:
        raise ConfigError("RunConfig.tensorboard: needs TensorBoard: pip install 'foretouch[tensorboard]'") from err
    return TensorBoardLogger(SummaryWriter(str(folder)))
