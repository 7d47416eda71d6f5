# SPDX-License-Identifier: Apache-2.0
"""Files of a contact model: its card `<name>.json`, which names the others with their hashes.

`<name>.safetensors` holds forests, kernel and novelty detector; `<name>.trust.safetensors` the calibration.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foretouch.errors import ConfigError, ModelError
from foretouch.models.calibration import Calibration, add_calibration, calibration_file, load_calibration
from foretouch.models.card import card_text, new_card
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.files import packed, read_tensors, replace_files
from foretouch.models.touch_model import TouchModel
from foretouch.tactile.ranges import TactileRanges

__all__ = ["load_model", "save_contact"]
__all__ += ["add_calibration"]  # alias until merge


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
        facts: `summary`, `config`, `data`, `split`, `skill`, `baselines`, `limits` of the card; empty if omitted.
        calibration: With its facts for the card, as in `add_calibration`.

    Returns:
        Path of the card.

    Raises:
        FileError: If a file cannot be written; the files before are kept.
    """
    path = Path(folder) / f"{name}.json"
    weights = path.with_suffix(".safetensors")
    content, sha256 = packed(estimator.to_tensors())
    empty: dict[str, Any] = {"summary": "", "config": {}, "data": {}, "split": {}, "skill": {}, "baselines": {}}
    rest: dict[str, Any] = {"limits": [], "calibration": None, "ranges": estimator.ranges.to_mapping()}
    card = new_card(name, "contact", weights=weights.name, sha256=sha256, **{**empty, **rest, **facts})
    files = {weights: content}
    if calibration is not None:
        files |= calibration_file(path, card, *calibration)
    replace_files({**files, path: card_text(card).encode()})
    return path


def load_model(card_path: Path, card: Mapping[str, Any]) -> TouchModel:
    """The contact model of a card, with its calibration.

    Raises:
        ModelError: Names the file and the field: absent, damaged, with another hash than the card's, or not fitting.
    """
    stored = card.get("ranges", {})
    if not isinstance(stored, dict):
        raise ModelError(f"{card_path}: ranges: {stored!r} is of type {type(stored).__name__}")
    try:
        ranges = TactileRanges.from_mapping(stored, f"{card_path}: ranges")
    except ConfigError as err:
        raise ModelError(str(err)) from err
    calibration, _ = load_calibration(card_path, card)
    path = card_path.with_name(Path(card["weights"]).name)
    tensors = read_tensors(path, card["sha256"], card_path.name)
    try:
        return TouchModel(ContactEstimator.from_tensors(tensors, ranges), card, calibration)
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
