# SPDX-License-Identifier: Apache-2.0
"""Prepared clouds on the disk: those of a large dataset exceed memory, and an epoch uses them in any order."""

import os
import tempfile
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.files import open_regular, system_errors
from foretouch.types import Float32


class CloudFile(Sequence[Float32]):
    """Clouds (N_i, C) float32 in a temporary file without a name, which is removed with the last process that reads it.

    They are read, not mapped: the pages of a mapping count as memory of the process. A pickle of it is for processes of
    this machine while this one lives.

    Raises:
        FileError: If the folder of temporary files (`TMPDIR`) has no room.
    """

    def __init__(self) -> None:
        with system_errors(Path("TMPDIR"), "names no folder that can be written"):
            self._folder = Path(tempfile.gettempdir())
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  open as long as this object
        weakref.finalize(self, self._file.close)
        self._ends = [0]  # in values
        self._columns = 0

    def append(self, cloud: Float32) -> None:
        """Write one more cloud, of the same C."""
        with system_errors(self._folder, "cannot hold the prepared clouds; set TMPDIR to a folder with more space"):
            rest = np.ascontiguousarray(cloud).data.cast("B")
            while rest:
                rest = rest[self._file.write(rest) :]
        self._ends.append(self._ends[-1] + cloud.size)
        self._columns = cloud.shape[1]

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __getitem__(self, index: Any) -> Any:
        """One cloud, read-only; slices are not supported."""
        k = range(len(self))[index]
        start, end = self._ends[k : k + 2]
        content = os.pread(self._file.fileno(), 4 * (end - start), 4 * start)
        return np.frombuffer(content, np.float32).reshape(-1, self._columns)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_file": f"/proc/{os.getpid()}/fd/{self._file.fileno()}"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update({**state, "_file": open_regular(state["_file"])})
        weakref.finalize(self, self._file.close)
