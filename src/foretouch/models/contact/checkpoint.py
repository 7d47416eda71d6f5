# SPDX-License-Identifier: Apache-2.0
"""Files of a contact model and of the calibration that any model may have: `<name>.json` names them and their hashes.

<name>.json               the card
<name>.safetensors        forests, kernel, novelty
<name>.trust.safetensors  rest level, adaptation, half widths: `calibration` in the card
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy.typing as npt

from foretouch.errors import ConfigError, ModelError
from foretouch.models.calibration import Calibration
from foretouch.models.card import card_text, new_card, read_card
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.files import packed, read_tensors, replace_files
from foretouch.models.network.estimator import Fallback
from foretouch.tactile.ranges import TactileRanges

__all__ = ["add_calibration", "load_calibration", "load_contact", "save_contact"]

_FALLBACK = "fallback/"


def save_contact(
    folder: str | Path,
    name: str,
    estimator: ContactEstimator,
    facts: Mapping[str, Any],
    calibration: tuple[Calibration, Mapping[str, Any]] | None = None,
) -> Path:
    """Write weights, card and, where there is one, the calibration: all of them or none.

    Args:
        folder: Made if absent.
        name: Of the model and of its files.
        estimator: The fitted model.
        facts: The rest of the card: `summary`, `config`, `data`, `split`, `skill`, `baselines`, `limits`; what is left
            out is empty.
        calibration: And what the card tells of it, as of `add_calibration`.

    Returns:
        Path of the card.

    Raises:
        FileError: If a file cannot be written, such as on a full disk; those before are kept.
    """
    path = Path(folder) / f"{name}.json"
    weights = path.with_suffix(".safetensors")
    content, sha256 = packed(estimator.to_tensors())
    empty: dict[str, Any] = {"summary": "", "config": {}, "data": {}, "split": {}, "skill": {}, "baselines": {}}
    rest: dict[str, Any] = {"limits": [], "calibration": None, "ranges": estimator.ranges.to_mapping()}
    card = new_card(name, "contact", weights=weights.name, sha256=sha256, **{**empty, **rest, **facts})
    files = {weights: content}
    if calibration is not None:
        trust, told = calibration
        files |= _trust_file(path, card, trust.to_tensors(), told)
    replace_files({**files, path: card_text(card).encode()})
    return path


def add_calibration(
    card_path: Path, trust: Calibration, facts: Mapping[str, Any], fallback: Fallback | None = None
) -> None:
    """Write a calibration beside a model and name it in the card.

    Args:
        card_path: The card of a network or a contact model.
        trust: The calibration.
        facts: What the card tells of it: level, objects, coverage, promise.
        fallback: For a network.

    Raises:
        ModelError: If the card cannot be read.
        FileError: If a file cannot be written, such as on a full disk; those before are kept.
    """
    card = read_card(card_path)
    tensors = trust.to_tensors()
    if fallback is not None:
        tensors |= {_FALLBACK + key: value for key, value in fallback.to_tensors().items()}
    files = _trust_file(card_path, card, tensors, facts)
    replace_files({**files, card_path: card_text(card).encode()})


def _trust_file(
    card_path: Path, card: dict[str, Any], tensors: Mapping[str, npt.NDArray[Any]], facts: Mapping[str, Any]
) -> dict[Path, bytes]:
    """The file of a calibration with its content; enters it in the card."""
    path = card_path.with_name(f"{card_path.stem}.trust.safetensors")
    content, sha256 = packed(tensors)
    card["calibration"] = {"weights": path.name, "sha256": sha256, **facts}
    return {path: content}


def load_calibration(card_path: Path, card: Mapping[str, Any]) -> tuple[Calibration | None, Fallback | None]:
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
        return Calibration.from_tensors(tensors), Fallback.from_tensors(held) if held else None
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
