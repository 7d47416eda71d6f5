# SPDX-License-Identifier: Apache-2.0
"""Default names of the topics that samples are made of, for nodes, commands and the import of bags alike."""

from typing import Final

NAMESPACE: Final = "/foretouch"
"""Namespace of the nodes; names below without a slash are relative to it."""

TACTILE_TOPIC: Final = "/rh/tactile"
COLOUR_TOPIC: Final = "color/image"
CLOUD_TOPIC: Final = "object_cloud"
TABLE_TOPIC: Final = "table"
GRASPS_TOPIC: Final = "grasps"
EXECUTED_TOPIC: Final = "executed_grasp"


def full_name(topic: str) -> str:
    """Return the name of a topic in the default namespace."""
    return topic if topic.startswith("/") else f"{NAMESPACE}/{topic}"
