# SPDX-License-Identifier: Apache-2.0
"""Arrays in safetensors files that are verified against a SHA-256; such files hold numbers and no code.

The file that keeps the readings of a hand across restarts is one, too. It is replaced as a whole, and holds a hash of its content. Its age
needs no limit: while nothing is read, the tracker's variance grows back to the variance of an unknown sensor.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar, Final, Self, TypeVar

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from foretouch.base.files import read_bytes
from foretouch.errors import FileError, ModelError, TactileError, shown
from foretouch.tactile import BIOTAC
from foretouch.tactile.description import require_same
from foretouch.types import AnyArray, UInt8
from foretouch.types.channels import Channels

_HISTORY_VERSION: Final = 2
"""Of the file's format."""
_LARGEST_HISTORY: Final = 10_000_000  # bytes; a file has about 200 kB


def packed(tensors: Mapping[str, AnyArray]) -> tuple[bytes, str]:
    """Arrays as the content of a safetensors file, and its SHA-256; the same arrays make the same bytes."""
    content: bytes = save({name: np.asarray(value, order="C") for name, value in tensors.items()})
    return content, hashlib.sha256(content).hexdigest()


def read_tensors(card_path: Path, facts: Mapping[str, Any], group: str = "") -> tuple[Path, dict[str, AnyArray]]:
    """Read the file that a card names, which is beside it; folders in the name are ignored.

    Args:
        card_path: The card.
        facts: Name and hash of the file, `weights` and `sha256`: the card, or a group of it.
        group: Name of that group with a dot, for the message.

    Returns:
        The path of the file, and its arrays by name.

    Raises:
        ModelError: Names the field that is no file name, or the file: absent, damaged, or with another hash.
    """
    name, sha256 = facts["weights"], facts["sha256"]
    base = Path(name).name if isinstance(name, str) else ""
    if not base or "\0" in base:
        raise ModelError(f"{shown(card_path)}: {group}weights: {shown(name)} is not a valid file name")
    path = card_path.with_name(base)
    try:
        content = read_bytes(path)
    except FileError as err:
        missing = isinstance(err.__cause__, FileNotFoundError)
        rule = f"no such weights; {card_path.name} names them"
        raise ModelError(f"{shown(path)}: {rule}" if missing else str(err)) from err
    digest = hashlib.sha256(content).hexdigest()
    if digest != sha256:
        raise ModelError(f"{path}: sha256: {digest} is not {shown(sha256)} of {card_path.name}; damaged or replaced")
    try:
        return path, load(content)
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError) as err:  # or an unknown dtype
        raise ModelError(f"{path}: damaged: {' '.join(str(err).split())}") from err


Rules = Mapping[str, str | tuple[str, float, float]]


class TensorRecord:
    """Base of a dataclass whose fields are arrays, stored in a file under the names of the fields.

    A field `channels` is not stored: the sensor is stated by the card.

    Attributes:
        RULES: By array, a letter for each axis of its shape and, if other than ±1e12, its least and largest value. D, M and F are
            the values, modalities and fingers of `channels`, a digit is itself, and other letters are equal in all arrays.
    """

    RULES: ClassVar[Rules]

    def to_tensors(self) -> dict[str, AnyArray]:
        """Arrays by name, for a file."""
        names = (member.name for member in fields(self) if member.name != "channels")  # type: ignore[arg-type]
        return {name: np.asarray(getattr(self, name)) for name in names}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, AnyArray], **stated: Channels) -> Self:
        """Make the record of the arrays of `to_tensors`, with `channels` where it has that field.

        Raises:
            ModelError: Names the array that is missing, or breaks a rule of `_check`.
        """
        known = [member for member in fields(cls) if member.name not in stated]  # type: ignore[arg-type]
        if missing := next((member.name for member in known if member.name not in tensors), None):
            raise ModelError(f"{missing}: is missing")
        record = cls(**{member.name: tensors[member.name] for member in known}, **stated)
        record._check()
        return record

    def _check(self) -> None:
        """Raise ModelError, which names the array, if a shape or a value breaks a rule."""
        sizes, channels = {str(n): n for n in range(10)}, getattr(self, "channels", None)
        if channels is not None:
            sizes |= {"D": channels.size, "M": len(channels.modalities), "F": len(channels.fingers)}
        for name, rule in self._rules().items():
            letters, low, high = (rule, -1e12, 1e12) if isinstance(rule, str) else rule
            array = getattr(self, name)
            sizes |= {letter: n for letter, n in zip(letters, array.shape, strict=False) if letter not in sizes}
            wanted = tuple(sizes.get(letter, -1) for letter in letters)
            if array.shape != wanted:
                raise ModelError(f"{name}: shape {array.shape} is not {wanted}")
            if not ((array >= low) & (array <= high)).all():  # NaN fails too
                raise ModelError(f"{name}: holds a value that is not within [{low:g}, {high:g}]")

    def _rules(self) -> Rules:
        """Return `RULES`, or rules that depend on the record."""
        return self.RULES


Record = TypeVar("Record", bound=TensorRecord)
Value = TypeVar("Value")


def under(prefix: str, tensors: Mapping[str, Value]) -> dict[str, Value]:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def read_part(record: type[Record], tensors: Mapping[str, AnyArray], prefix: str, **stated: Channels) -> Record:
    """Return the record whose arrays are stored under names that begin with a prefix, which errors name too; see `from_tensors`."""
    try:
        return record.from_tensors(under(prefix, tensors), **stated)
    except ModelError as err:
        raise ModelError(f"{prefix}{err}") from err


def pack_history(tensors: Mapping[str, AnyArray], hand: str, model: str, channels: Channels) -> bytes:
    """Return the content of a hand's file.

    Args:
        tensors: Of the history.
        hand: Name of the hand.
        model: Name of the model that its readings were compared with.
        channels: Of the sensor.
    """
    content = dict(tensors)
    content |= {"version": np.array([_HISTORY_VERSION], np.int64), "hand": to_bytes(hand), "model": to_bytes(model)}
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
        tensors = load(read_bytes(path, _LARGEST_HISTORY))
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise FileError(path, f"damaged: {' '.join(str(err).split())}") from err
    digest = tensors.pop("sha256", None)
    if digest is None or bytes(digest) != hashlib.sha256(packed(tensors)[0]).digest():
        raise FileError(path, "damaged: its content has another hash")
    version = tensors.get("version", np.array([-1]))
    if version.shape != (1,) or version.dtype.kind not in "iu" or int(version[0]) != _HISTORY_VERSION:
        raise FileError(path, f"version: {version.tolist()} is not [{_HISTORY_VERSION}]")
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
