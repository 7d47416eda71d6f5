# SPDX-License-Identifier: Apache-2.0
"""Arrays in a safetensors file, checked against the hash that a card names. Such a file holds numbers and no code."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.errors import ModelError
from foretouch.models.card import file_sha256

__all__ = ["packed", "read_tensors"]


def packed(tensors: Mapping[str, npt.NDArray[Any]]) -> tuple[bytes, str]:
    """Arrays as the content of a safetensors file, and its SHA-256; the same arrays make the same bytes."""
    from safetensors.numpy import save

    content: bytes = save({name: np.asarray(value, order="C") for name, value in tensors.items()})
    return content, hashlib.sha256(content).hexdigest()


def read_tensors(path: Path, sha256: str, named_by: str) -> dict[str, npt.NDArray[Any]]:
    """Arrays by name.

    Args:
        path: The file.
        sha256: That it must have.
        named_by: The card's name, for the message.

    Raises:
        ModelError: Names the file: absent, damaged, or another than the hash tells.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    if not path.is_file():
        raise ModelError(f"{path}: no such weights; {named_by} names them")
    if (found := file_sha256(path)) != sha256:
        raise ModelError(f"{path}: sha256: {found} is not {sha256} of {named_by}; damaged or replaced")
    try:
        tensors: dict[str, npt.NDArray[Any]] = load_file(path)
    except (SafetensorError, OSError, ValueError) as err:
        raise ModelError(f"{path}: damaged: {' '.join(str(err).split())}") from err
    return tensors
