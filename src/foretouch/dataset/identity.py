# SPDX-License-Identifier: Apache-2.0
"""What identifies a recording: its hand and camera, and the ids of its samples."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from foretouch.errors import DatasetError


@dataclass(frozen=True, kw_only=True)
class Identity:
    """The hand and the camera; all recordings of a dataset share them."""

    hand: Mapping[str, str] = field(default_factory=dict)  # such as model, serial number and names of its two fingers
    camera: Mapping[str, str] = field(default_factory=dict)  # such as model, serial number and image size


def check_name(name: str, what: str) -> str:
    """Check a label that becomes part of an id and the name of a folder, and return it.

    Raises a `DatasetError` that names `what` it is if it is empty, longer than 100 characters, `.` or `..`, or holds a
    slash, a colon or a control character.
    """
    if not name or len(name) > 100 or name.strip(".") == "" or re.search(r"[\x00-\x1f\x7f/\\:]", name):
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
    head, slash, name = sample_id.partition("/")
    if not slash or head != label:
        raise DatasetError(f"id: {sample_id[:200]!r} is not {label[:100]!r}, a slash and a name")
    check_name(name, "id")
