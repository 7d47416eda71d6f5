# SPDX-License-Identifier: Apache-2.0
"""The state of a training on disk: one safetensors file, tensors and JSON, replaced as a whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from foretouch.errors import FileError

__all__ = ["read_state", "write_state"]

_KEY = "foretouch-training"


def write_state(path: Path, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> None:
    """Write a state beside its place and move it there; the one before survives any failure until then.

    Args:
        path: Of the file.
        tensors: By name.
        plain: What JSON holds.

    Raises:
        FileError: If it cannot be written, such as on a full disk.
    """
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            file.write(save(dict(tensors), {_KEY: json.dumps(plain)}))
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as err:
        part.unlink(missing_ok=True)
        raise FileError(path, f"cannot be written, the one before is kept: {err.strerror or err}") from err


def read_state(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and plain data of `write_state`.

    Raises:
        FileError: If there is none, or it is damaged.
    """
    try:
        with safe_open(path, framework="pt") as file:
            plain = json.loads(file.metadata()[_KEY])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError as err:
        raise FileError(path, "does not exist: there is nothing to resume") from err
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as err:
        raise FileError(path, f"is no state of training: {' '.join(str(err).split())}") from err
    return tensors, plain
