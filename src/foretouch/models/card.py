# SPDX-License-Identifier: Apache-2.0
"""The card beside a model's weights: what it is, what it was trained on, how well it does.

A card is plain JSON. Three kinds exist: a `network` and a `contact` model name their weights, and an `ensemble` names
the cards of other networks that together predict all modalities.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from foretouch.errors import ModelError
from foretouch.models.files import replace_files

__all__ = [
    "CARD_FORMAT",
    "CARD_VERSION",
    "card_text",
    "combined_sha256",
    "new_card",
    "read_card",
    "write_text",
]

CARD_FORMAT: Final = "foretouch-model"
CARD_VERSION: Final = 1

_COMMON: Final[dict[str, type | tuple[type, ...]]] = {"name": str, "kind": str, "sha256": str}
_TRAINED: Final[dict[str, type | tuple[type, ...]]] = {
    "weights": str,
    "config": dict,
    "data": dict,
    "split": dict,
    "skill": dict,
    "baselines": dict,
    "limits": list,
    "calibration": (dict, type(None)),
}
_OF_KIND: Final[dict[str, dict[str, type | tuple[type, ...]]]] = {
    "network": {**_TRAINED, "familiar": (dict, type(None))},
    "contact": _TRAINED,
    "ensemble": {"members": list},
}


def new_card(name: str, kind: str, **fields: Any) -> dict[str, Any]:
    """A card with the head that every card has; checked when it is read back."""
    return {"format": CARD_FORMAT, "format_version": CARD_VERSION, "kind": kind, "name": name, **fields}


def read_card(path: str | Path) -> dict[str, Any]:
    """Read and check a card.

    Raises:
        ModelError: Names the card and the field: unreadable, no JSON, another format or version, a field
            that is missing or of another type.
    """
    path = Path(path)
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as err:
        raise ModelError(f"{path}: no such model card") from err
    except OSError as err:
        raise ModelError(f"{path}: {err.strerror or err}") from err
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as err:
        raise ModelError(f"{path}: not JSON: {' '.join(str(err).split())}") from err
    if not isinstance(card, dict) or card.get("format") != CARD_FORMAT:
        raise ModelError(f"{path}: format: is no {CARD_FORMAT} card")
    if card.get("format_version") != CARD_VERSION:
        raise ModelError(f"{path}: format_version: {card.get('format_version')!r} is not {CARD_VERSION}")
    kind = card.get("kind")
    if kind not in _OF_KIND:
        raise ModelError(f"{path}: kind: {kind!r} is none of {', '.join(_OF_KIND)}")
    _check_fields(path, card, {**_COMMON, **_OF_KIND[kind]})
    return card


def combined_sha256(hashes: Sequence[str]) -> str:
    """One hash over several, in order: that of an ensemble over its members."""
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def write_text(path: Path, text: str) -> None:
    """Write a file so that a reader sees the old or the new one, never a part.

    Raises:
        FileError: If it cannot be written, such as on a full disk; the one before is kept.
    """
    replace_files({path: text.encode()})


def card_text(card: Mapping[str, Any]) -> str:
    """A card as it stands in its file."""
    return json.dumps(card, indent=1) + "\n"


def _check_fields(path: Path, card: Mapping[str, Any], wanted: Mapping[str, type | tuple[type, ...]]) -> None:
    for field, kind in wanted.items():
        if field not in card:
            raise ModelError(f"{path}: {field}: is missing")
        if not isinstance(card[field], kind):
            raise ModelError(f"{path}: {field}: {card[field]!r} is of type {type(card[field]).__name__}")
