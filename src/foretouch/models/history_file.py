# SPDX-License-Identifier: Apache-2.0
"""The content of the file that keeps the readings of a hand across restarts.

It is a safetensors file that is replaced as a whole and holds a hash of its content. Its age needs no limit: while nothing
is read, the tracker's variance grows back to the variance of an unknown sensor.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load

from foretouch.errors import FileError, TactileError
from foretouch.files import read_bytes
from foretouch.models.files import packed
from foretouch.tactile import BIOTAC
from foretouch.tactile.description import require_same
from foretouch.types import AnyArray, UInt8
from foretouch.types.channels import Channels

VERSION: Final = 2
"""Of the file's format."""

_LARGEST: Final = 10_000_000  # bytes; a file has about 200 kB


def pack_history(tensors: Mapping[str, AnyArray], hand: str, model: str, channels: Channels) -> bytes:
    """Return the content of a hand's file.

    Args:
        tensors: Of the history.
        hand: Name of the hand.
        model: Name of the model that its readings were compared with.
        channels: Of the sensor.
    """
    content = dict(tensors)
    content |= {"version": np.array([VERSION], np.int64), "hand": to_bytes(hand), "model": to_bytes(model)}
    if channels != BIOTAC:  # files of the BioTac SP state none
        content["sensor"] = to_bytes(f"{channels.sensor} {channels.sha256}")
    sha256 = hashlib.sha256(packed(content)[0]).digest()
    return packed({**content, "sha256": np.frombuffer(sha256, np.uint8)})[0]


def unpack_history(path: Path, hand: str | None, model: str, channels: Channels) -> dict[str, AnyArray]:
    """Read what `pack_history` made.

    Args:
        path: The file.
        hand: Name of the hand; None accepts any.
        model: Name of the model.
        channels: Of the model's sensor.

    Raises:
        FileError: If the file is absent or damaged, or of another version, sensor, hand or model.
    """
    try:
        tensors = load(read_bytes(path, _LARGEST))
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise FileError(path, f"damaged: {' '.join(str(err).split())}") from err
    digest = tensors.pop("sha256", None)
    if digest is None or bytes(digest) != hashlib.sha256(packed(tensors)[0]).digest():
        raise FileError(path, "damaged: its content has another hash")
    version = tensors.get("version", np.array([-1]))
    if version.shape != (1,) or version.dtype.kind not in "iu" or int(version[0]) != VERSION:
        raise FileError(path, f"version: {version.tolist()} is not [{VERSION}]")
    try:
        name, _, sha256 = to_text(tensors, "sensor").partition(" ")
        require_same(Channels(name, sha256, (), ()) if name else BIOTAC, channels, "sensor")
    except TactileError as err:
        raise FileError(path, str(err)) from err
    for name, own in (("hand", hand), ("model", model)):
        stored = to_text(tensors, name)
        if own is not None and stored != own:
            raise FileError(path, f"{name}: is of {stored!r}, not of {own!r}")
    return tensors


def to_bytes(text: str) -> UInt8:
    """Return a text as an array of its bytes."""
    return np.frombuffer(text.encode(), np.uint8)


def to_text(tensors: Mapping[str, AnyArray], name: str) -> str:
    """Return the text of an array of `to_bytes`, "" where it is missing."""
    return bytes(tensors.get(name, to_bytes(""))).decode("utf-8", "replace")
