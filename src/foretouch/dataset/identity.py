# SPDX-License-Identifier: Apache-2.0
"""What identifies a recording: its hand and camera, and the ids of its samples."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from foretouch.errors import DatasetError, shown
from foretouch.types.arrays import is_missing

_LARGEST: Final = 2**63  # of a number that is a name


@dataclass(frozen=True, kw_only=True)
class Identity:
    """The hand and the camera; all recordings of a dataset share them."""

    hand: Mapping[str, str] = field(default_factory=dict)  # such as model, serial number and names of its two fingers
    camera: Mapping[str, str] = field(default_factory=dict)  # such as model, serial number and image size


def name_of(value: Any, what: str) -> str:
    """Return a name as tables hold it as a text: bytes are decoded, and whole numbers written without a point.

    Args:
        value: The name.
        what: What it is the name of, for the error.

    Raises:
        DatasetError: If it is missing (None, NaN, masked), or something else than a text or a whole number.
    """
    if is_missing(value):
        raise DatasetError(f"{what}: is missing ({shown(value)}): give a text, or leave the sample out")
    if isinstance(value, np.ndarray | np.generic) and value.ndim == 0:
        value = value.item()
    if isinstance(value, bytes):
        try:
            return value.decode()
        except UnicodeDecodeError as err:
            raise DatasetError(f"{what}: {shown(value)} is not text in UTF-8") from err
    if isinstance(value, str):
        if re.search("[\ud800-\udfff]", value):
            raise DatasetError(f"{what}: {shown(value)} holds half of a surrogate pair, which is no text")
        return str.__str__(value)  # of a member of an enumeration its value
    whole = (
        isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST and value == int(value)
    )
    if not whole:
        raise DatasetError(f"{what}: {shown(value)} of type {type(value).__name__} is not a name: give a text")
    return str(int(value))


def check_name(name: str, what: str) -> str:
    """Check a label that becomes part of an id and the name of a folder, and return it.

    Raises a `DatasetError` that names `what` it is if it is empty, longer than 100 characters, `.` or `..`, or holds a
    slash, a colon, a control character or half of a surrogate pair.
    """
    if not isinstance(name, str):
        raise DatasetError(f"{what}: {shown(name)} is not a text")
    if not name or len(name) > 100 or name.strip(".") == "" or re.search(r"[\x00-\x1f\x7f/\\:\ud800-\udfff]", name):
        raise DatasetError(
            f"{what}: {name[:100]!r} is not a plain name (1 to 100 characters, no slash, colon or dots alone)"
        )
    return name


def numbered_id(label: str, number: int) -> str:
    """Return the id of a sample that was given none: `<object>/<number>`."""
    return f"{label}/{number:06d}"


def renamed_id(sample_id: str, label: str) -> str:
    """Return the id of a sample that is assigned to another object."""
    return f"{label}/{sample_id.partition('/')[2]}"


def id_number(sample_id: str) -> int:
    """Return the number in an id of `numbered_id`, else 0; names of 10 digits are unix times."""
    name = sample_id.rpartition("/")[2]
    return int(name) if 6 <= len(name) <= 9 and name.isdecimal() and name.isascii() else 0


def check_id(sample_id: str, label: str) -> None:
    """Check that an id is `<object>/<name>` for the object `label`; a `DatasetError` if it is not; names the rule."""
    check_name(label, "object")
    if not isinstance(sample_id, str):
        raise DatasetError(f"id: {shown(sample_id)} is not a text")
    head, slash, name = sample_id.partition("/")
    if not slash or head != label:
        raise DatasetError(
            f"id: {sample_id[:200]!r} is not {label[:100]!r}, a slash and a name; leave it empty for a number"
        )
    check_name(name, "id")
