# SPDX-License-Identifier: Apache-2.0
"""The card beside a model's weights: what the model is, what it was trained on, how well it performs.

A card is plain JSON, which names the weights.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from foretouch.errors import ConfigError, FileError, ModelError, TactileError, quoted, shown
from foretouch.files import COUNT, Number, read_json, require_schema
from foretouch.tactile.description import Sensor, require_same, sensor_in
from foretouch.types.channels import Channels

CARD_FORMAT: Final = "foretouch-model"
CARD_VERSION: Final = 2

_Fields = Mapping[str, Any]  # of a schema
_SKILLS: Final = {"*": {"*": {"*": Number(float, optional=True)}}}  # of each split, modality and measure
_GROUP: Final = {
    "objects?": COUNT,
    "samples?": COUNT,
    "coverage?": {"*": {"*": Number(float, 0.0, 1.0, optional=True)}},
}
_COMMON: Final[_Fields] = {"name": str, "kind": str, "sha256": str}
_TRAINED: Final[_Fields] = {
    "weights": str,
    "config": dict,
    "data": {"samples?": COUNT},
    "split": {"train?": COUNT, "unlabelled?": COUNT, "validation?": COUNT, "test?": COUNT},
    "skill": _SKILLS,
    "baselines": dict,
    "limits": list,
    "calibration": (dict, type(None)),
}


KINDS: Final[Mapping[str, _Fields]] = {
    "network": {**_TRAINED, "familiar": (dict, type(None))},
    "contact": {**_TRAINED, "ranges": dict},
    "hold": _TRAINED,
}
"""Fields that the cards of each kind hold besides `_COMMON`, with their types."""


def read_card(path: str | Path) -> dict[str, Any]:
    """Read and check a card.

    Raises:
        ModelError: Names the card and the field: unreadable, no JSON, another format or version, a field
            that is missing or of another type.
    """
    path = Path(path)
    try:
        card = read_json(path)
    except FileError as err:
        missing = isinstance(err.__cause__, FileNotFoundError)
        rule = "no such model card" if missing else err.rule.replace("is not JSON", "not JSON")
        raise ModelError(f"{shown(path)}: {rule}") from err
    if not isinstance(card, dict) or card.get("format") != CARD_FORMAT:
        raise ModelError(f"{path}: format: is not a {CARD_FORMAT} card")
    if card.get("format_version") != CARD_VERSION:
        raise ModelError(f"{path}: format_version: {quoted(card.get('format_version'))} is not {CARD_VERSION}")
    kind = card.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise ModelError(f"{path}: kind: {quoted(kind)} is not one of {', '.join(KINDS)}")
    try:
        require_schema(path, card, {**_COMMON, **KINDS[kind]})
        if card["calibration"] is not None:
            schema = {"level?": Number(float, 0.0, 1.0), "regimes?": {"*": _GROUP}}
            require_schema(path, card["calibration"], schema, "calibration")
    except FileError as err:
        raise ModelError(str(err)) from err
    return card


def card_sensor(card: Mapping[str, Any], where: str | Path) -> Sensor:
    """The sensor whose readings a model predicts.

    Raises:
        ModelError: Names `where` the card was read: its description is damaged, or has changed since the card was written.
    """
    try:
        sensor = sensor_in(card, where)
        name, sha256 = (
            card.get(f"sensor_{key}", own) for key, own in (("name", sensor.config.name), ("sha256", sensor.sha256))
        )
        require_same(Channels(str(name), str(sha256), (), ()), sensor.channels, f"{shown(where)}: sensor_sha256")
    except (ConfigError, TactileError) as err:
        raise ModelError(str(err)) from err
    return sensor


def card_text(card: Mapping[str, Any]) -> str:
    """The content of a card's file."""
    return json.dumps(card, indent=1) + "\n"
