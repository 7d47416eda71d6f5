# SPDX-License-Identifier: Apache-2.0
"""Which topics of a recording can go along with its clouds, and why the others cannot."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable
from typing import Any

from ament_index_python import has_resource

from foretouch.dataset.bag import Topic

__all__ = ["message_class", "playable"]

_TYPE = re.compile(r"([a-z]\w*)/msg/([A-Z]\w*)")
_LIVE_ONLY = frozenset({"/diagnostics", "/parameter_events", "/rosout"})
_INPUTS = frozenset({"executed_grasp"})  # of the graph's own namespace, sent by the robot


def playable(topics: Iterable[Topic], namespace: str) -> tuple[dict[Topic, type], dict[str, str]]:
    """Sort the topics of a recording.

    Args:
        topics: Without that of the clouds.
        namespace: Of the graph: what its nodes publish now must not be mixed with what they published then.

    Returns:
        The message class of each topic that can be played, and for each other topic with messages the reason.
    """
    classes: dict[Topic, type] = {}
    reasons: dict[str, str] = {}
    for topic in topics:
        if not topic.count:
            continue
        reason = _kept_back(topic.name, namespace)
        if not reason:
            found, reason = message_class(topic)
            if found is not None:
                classes[topic] = found
                continue
        reasons[topic.name] = f"{reason} ({topic.count} messages)"
    return classes, reasons


def message_class(topic: Topic) -> tuple[type | None, str]:
    """The class of a topic's messages where this machine has it with the same fields; else None and the reason."""
    match = _TYPE.fullmatch(topic.type)
    if match is None:
        return None, f"type {topic.type or 'mixed'} is no message type"
    package, name = match.groups()
    # A recording may name any module: only what is installed as ROS interfaces is imported.
    if not has_resource("rosidl_interfaces", package):
        return None, f"type {topic.type} is not installed"
    try:
        found: Any = getattr(importlib.import_module(f"{package}.msg"), name)
        fields = tuple(found.get_fields_and_field_types())
    except (ImportError, AttributeError):
        return None, f"type {topic.type} is not installed"
    recorded = tuple(field.lower() for field in topic.fields)  # some names of ROS 1 had capitals
    if recorded != fields:
        return None, f"type {topic.type} had other fields when it was recorded"
    return found, ""


def _kept_back(name: str, namespace: str) -> str:
    if name in _LIVE_ONLY:
        return "tells of nodes that run"
    prefix = namespace.rstrip("/") + "/"
    if name.startswith(prefix) and name.removeprefix(prefix) not in _INPUTS:
        return f"under {namespace} this graph publishes itself"
    return ""
