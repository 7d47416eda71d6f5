# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: `<name>.safetensors` and `<name>.json` beside it, checked against each other.

Weights are read with safetensors alone, which holds numbers and no code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from foretouch.errors import ConfigError, ModelError
from foretouch.models.card import card_text, combined_sha256, new_card, read_card, write_text
from foretouch.models.files import file_sha256, replace_files
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.regressor import TouchNet

__all__ = ["load_network", "save_ensemble", "save_network"]


def save_network(folder: str | Path, name: str, net: TouchNet, facts: Mapping[str, Any]) -> Path:
    """Write weights and card.

    Args:
        folder: Made if absent.
        name: Of the model and of both files.
        net: The network.
        facts: The rest of the card: `summary`, `data`, `split`, `skill`, `baselines`, `limits`, `familiar`.
            What is left out is empty; `calibration` is null.

    Returns:
        Path of the card.

    Raises:
        FileError: If a file cannot be written, such as on a full disk; those before are kept.
    """
    card_path = Path(folder) / f"{name}.json"
    weights = card_path.with_suffix(".safetensors")
    content: bytes = save({key: value.detach().cpu().contiguous() for key, value in net.state_dict().items()})
    empty: dict[str, Any] = {
        "summary": "",
        "data": {},
        "split": {},
        "skill": {},
        "baselines": {},
        "limits": [],
        "familiar": None,
        "calibration": None,
    }
    card = new_card(
        name,
        "network",
        weights=weights.name,
        sha256=hashlib.sha256(content).hexdigest(),
        config=net.config.to_mapping(),
        **{**empty, **facts},
    )
    replace_files({weights: content, card_path: card_text(card).encode()})
    return card_path


def save_ensemble(folder: str | Path, name: str, members: Sequence[str | Path], summary: str = "") -> Path:
    """Write the card of an ensemble of networks, such as one a modality as in the papers.

    Args:
        folder: Where the card goes.
        name: Of the ensemble.
        members: Cards of its networks, in the same folder.
        summary: One line.

    Raises:
        ModelError: If a member's card cannot be read.
        FileError: If the card cannot be written.
    """
    folder = Path(folder)
    hashes = [read_card(member)["sha256"] for member in members]
    card = new_card(
        name,
        "ensemble",
        summary=summary,
        members=[Path(member).name for member in members],
        sha256=combined_sha256(hashes),
    )
    path = folder / f"{name}.json"
    write_text(path, card_text(card))
    return path


def load_network(card_path: str | Path) -> tuple[TouchNet, dict[str, Any]]:
    """Read a network and its card; every weight is checked before it is used.

    Args:
        card_path: The card, of kind `network`.

    Returns:
        The network in evaluation mode, and the card.

    Raises:
        ModelError: Names the file and the field: a card of another kind, weights that are absent, damaged,
            other than the card's hash, of another architecture, or not finite.
    """
    card_path = Path(card_path)
    card = read_card(card_path)
    if card["kind"] != "network":
        raise ModelError(f"{card_path}: kind: {card['kind']!r} is not network")
    config = _config(card_path, card)
    weights = card_path.with_name(Path(card["weights"]).name)
    if not weights.is_file():
        raise ModelError(f"{weights}: no such weights; {card_path.name} names them")
    if (found := file_sha256(weights)) != card["sha256"]:
        raise ModelError(f"{weights}: sha256: {found} is not {card['sha256']} of {card_path.name}; damaged or replaced")
    with torch.device("meta"):  # shapes alone: no random numbers are drawn for weights that are replaced at once
        net = TouchNet(config)
    tensors = _read_tensors(weights)
    _check_tensors(weights, net.state_dict(), tensors)
    net.load_state_dict(tensors, assign=True)
    return net.eval(), card


def _config(path: Path, card: Mapping[str, Any]) -> ModelConfig:
    try:
        return ModelConfig.from_mapping(card["config"], f"{path}: config")
    except ConfigError as err:
        raise ModelError(str(err)) from err


def _read_tensors(path: Path) -> dict[str, Tensor]:
    try:
        tensors: dict[str, Tensor] = load_file(path)
    except (SafetensorError, OSError, ValueError) as err:
        raise ModelError(f"{path}: damaged: {' '.join(str(err).split())}") from err
    return tensors


def _check_tensors(path: Path, wanted: Mapping[str, Tensor], found: Mapping[str, Tensor]) -> None:
    """Names, shapes, dtypes and finiteness, so that the fault is told by field."""
    for key in sorted(wanted.keys() | found.keys()):
        if key not in found:
            raise ModelError(f"{path}: {key}: is missing; the card tells of another architecture")
        if key not in wanted:
            raise ModelError(f"{path}: {key}: is not part of the card's architecture")
        if found[key].shape != wanted[key].shape or found[key].dtype != wanted[key].dtype:
            raise ModelError(
                f"{path}: {key}: {found[key].dtype} {tuple(found[key].shape)} is not "
                f"{wanted[key].dtype} {tuple(wanted[key].shape)} of the card's architecture"
            )
        if found[key].is_floating_point() and not torch.isfinite(found[key]).all():
            raise ModelError(f"{path}: {key}: holds a value that is not finite")
