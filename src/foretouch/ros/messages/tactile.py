# SPDX-License-Identifier: Apache-2.0
"""The topic, the settings and the class of tactile messages, which `foretouch.tactile.messages` decodes."""

import importlib
from dataclasses import dataclass, field

from foretouch.config import Settings, setting
from foretouch.errors import MissingDependencyError
from foretouch.tactile.messages.table import TactileConfig
from foretouch.topics import TACTILE_TOPIC


@dataclass(frozen=True, kw_only=True)
class TactileInput(Settings):
    """Settings of nodes that receive tactile messages."""

    tactile_topic: str = setting(TACTILE_TOPIC, "Topic of the tactile messages", read_only=True)
    tactile: TactileConfig = field(default_factory=TactileConfig)


def message_class(type_name: str) -> type:
    """Import the class of a message such as `std_msgs/String` or `std_msgs/msg/String`; a `MissingDependencyError` without its package."""
    package, name = type_name.replace("/msg/", "/").split("/")
    try:
        message: type = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as err:
        raise MissingDependencyError(
            f"{type_name}: {package} is not installed; source the workspace that holds it"
        ) from err
    return message
