# SPDX-License-Identifier: Apache-2.0
"""The state of a training on disk: one safetensors file, tensors and JSON, replaced as a whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from foretouch.errors import FileError
from foretouch.models.atomic_file import replace_files

__all__ = ["read_state", "write_state"]

_KEY = "foretouch-training"


def write_state(path: Path, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> None:
    """Replace the state on disk; the one before survives any failure.

    Args:
        path: Of the file.
        tensors: By name.
        plain: What JSON holds.

    Raises:
        FileError: If it cannot be written, such as on a full disk.
    """
    replace_files({path: save(dict(tensors), {_KEY: json.dumps(plain)})})


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
