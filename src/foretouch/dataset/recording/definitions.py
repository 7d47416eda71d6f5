# SPDX-License-Identifier: Apache-2.0
"""Definitions of message types, found without ROS: a recording stores them beside the messages.

Search order: ROS 2 Kilted as included in `rosbags`, the texts included in foretouch (copies of those in
`foretouch_msgs`, so that datasets can be read without ROS), then every installed message package on
`AMENT_PREFIX_PATH` and in the Python environment.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from foretouch.errors import DatasetError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


_OWN: Final = Path(__file__).parent / "definitions"
_TYPE_NAME = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*")


class Definitions:
    """Message types, looked up on request; `store` holds those found so far, and serialises their messages."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store: Typestore = get_typestore(Stores.ROS2_KILTED)

    def register(self, type_name: str, text: str) -> None:
        """Register a type by the text of its `.msg` file, which definitions of the types in it may follow, as in MCAP.

        Raises a `DatasetError` if the text is no definition, or contradicts a registered one.
        """
        from rosbags.typesys import TypesysError, get_types_from_msg

        try:
            self.store.register(get_types_from_msg(text, type_name))
        except TypesysError as err:
            raise DatasetError(f"{type_name}: {' '.join(str(err).split())}") from err

    def text(self, type_name: str) -> str:
        """The definition with those of all types in it (`ros2msg`); a `DatasetError` if one cannot be found."""
        self._require(type_name)
        return self.store.generate_msgdef(type_name, ros_version=2)[0]

    def _require(self, type_name: str) -> None:
        if type_name not in self.store.fielddefs:
            if not _TYPE_NAME.fullmatch(type_name):
                raise DatasetError(f"{type_name!r} is no message type, such as std_msgs/msg/String")
            self.register(type_name, _find(type_name))
        for needed in _types_in(self.store, type_name):
            self._require(needed)


def _find(type_name: str) -> str:
    package, _, name = type_name.split("/")
    if package == "foretouch_msgs" and (_OWN / f"{name}.msg").is_file():
        return (_OWN / f"{name}.msg").read_text(encoding="utf-8")
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    for prefix in prefixes:
        file = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise DatasetError(f"{type_name}: no definition is known, and {package} is not installed")


def _types_in(store: Typestore, type_name: str) -> Iterator[str]:
    from rosbags.interfaces import Nodetype

    for _, field in store.fielddefs[type_name][1]:
        kind, detail = cast("tuple[Any, Any]", field)
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (kind, detail), _ = detail
        if kind == Nodetype.NAME:
            yield detail
