# SPDX-License-Identifier: Apache-2.0
"""Files of a contact model and of the calibration that any model may have: `<name>.json` names them and their hashes.

<name>.json               the card
<name>.safetensors        forests, kernel, novelty
<name>.trust.safetensors  rest level, adaptation, half widths: `calibration` in the card
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foretouch.errors import ConfigError, ModelError
from foretouch.models.card import new_card, read_card, write_text
from foretouch.models.contact_estimator import ContactEstimator
from foretouch.models.fallback import Fallback
from foretouch.models.tensor_file import read_tensors, write_tensors
from foretouch.models.trust import Trust
from foretouch.tactile.ranges import TactileRanges

__all__ = ["add_trust", "load_contact", "load_trust", "save_contact"]

_FALLBACK = "fallback/"


def save_contact(folder: str | Path, name: str, estimator: ContactEstimator, facts: Mapping[str, Any]) -> Path:
    """Write weights and card.

    Args:
        folder: Made if absent.
        name: Of the model and of its files.
        estimator: The fitted model.
        facts: The rest of the card: `summary`, `config`, `data`, `split`, `skill`, `baselines`, `limits`; what is left
            out is empty.

    Returns:
        Path of the card.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    weights = folder / f"{name}.safetensors"
    sha256 = write_tensors(weights, estimator.to_tensors())
    empty: dict[str, Any] = {"summary": "", "config": {}, "data": {}, "split": {}, "skill": {}, "baselines": {}}
    rest: dict[str, Any] = {"limits": [], "calibration": None, "ranges": estimator.ranges.to_mapping()}
    card = new_card(name, "contact", weights=weights.name, sha256=sha256, **{**empty, **rest, **facts})
    path = folder / f"{name}.json"
    write_text(path, json.dumps(card, indent=1) + "\n")
    return path


def add_trust(card_path: Path, trust: Trust, facts: Mapping[str, Any], fallback: Fallback | None = None) -> None:
    """Write a calibration beside a model and name it in the card.

    Args:
        card_path: The card of a network or a contact model.
        trust: The calibration.
        facts: What the card tells of it: level, objects, coverage, promise.
        fallback: For a network.
    """
    card = read_card(card_path)
    path = card_path.with_name(f"{card_path.stem}.trust.safetensors")
    tensors = trust.to_tensors()
    if fallback is not None:
        tensors |= {_FALLBACK + key: value for key, value in fallback.to_tensors().items()}
    card["calibration"] = {"weights": path.name, "sha256": write_tensors(path, tensors), **facts}
    write_text(card_path, json.dumps(card, indent=1) + "\n")


def load_trust(card_path: Path, card: Mapping[str, Any]) -> tuple[Trust | None, Fallback | None]:
    """The calibration that a card names, and the fallback in it; None where there is none.

    Raises:
        ModelError: Names the file and the field: absent, damaged, another than the card's hash, or not fitting.
    """
    facts = card.get("calibration")
    if facts is None:
        return None, None
    for field in ("weights", "sha256"):
        if not isinstance(facts.get(field), str):
            raise ModelError(f"{card_path}: calibration.{field}: is missing")
    path = card_path.with_name(Path(facts["weights"]).name)
    tensors = read_tensors(path, facts["sha256"], card_path.name)
    held = {key.removeprefix(_FALLBACK): value for key, value in tensors.items() if key.startswith(_FALLBACK)}
    try:
        return Trust.from_tensors(tensors), Fallback.from_tensors(held) if held else None
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err


def load_contact(card_path: Path, card: Mapping[str, Any]) -> ContactEstimator:
    """The weights that a card of kind `contact` names.

    Raises:
        ModelError: Names the file and the field: absent, damaged, another than the card's hash, or not fitting.
    """
    told = card.get("ranges", {})
    if not isinstance(told, dict):
        raise ModelError(f"{card_path}: ranges: {told!r} is of type {type(told).__name__}")
    try:
        ranges = TactileRanges.from_mapping(told, f"{card_path}: ranges")
    except ConfigError as err:
        raise ModelError(str(err)) from err
    path = card_path.with_name(Path(card["weights"]).name)
    tensors = read_tensors(path, card["sha256"], card_path.name)
    try:
        return ContactEstimator.from_tensors(tensors, ranges)
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
