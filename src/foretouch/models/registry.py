# SPDX-License-Identifier: Apache-2.0
"""Find a model by name or path and load it; torch is imported when the first one is."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any, Final

from foretouch.errors import ModelError
from foretouch.models.card import combined_sha256, read_card
from foretouch.models.contact.checkpoint import load_calibration, load_contact
from foretouch.models.familiarity import Familiarity
from foretouch.models.network.estimator import Fallback, Member, NetworkEstimator
from foretouch.models.touch_model import TouchModel

__all__ = ["DEFAULT_MODEL", "available_models", "find_card", "load_model"]

DEFAULT_MODEL: Final = "contact-v1"


def available_models() -> list[str]:
    """Names of the models that come with the package, the default first."""
    names = sorted(path.stem for path in _shipped().glob("*.json"))
    return sorted(names, key=lambda name: name != DEFAULT_MODEL)


def load_model(name_or_path: str | Path = "default") -> TouchModel:
    """Load a shipped model or a checkpoint.

    Args:
        name_or_path: `default`, a name out of `available_models`, or the path of a card or of its weights.

    Raises:
        ModelError: If there is no such model, or it is damaged (see `checkpoint.load_network`), or its
            networks do not predict each modality once.
    """
    path = find_card(name_or_path)
    card = read_card(path)
    if card["kind"] == "ensemble":
        return _load_ensemble(path, card)
    trust, fallback = load_calibration(path, card)
    if card["kind"] == "contact":
        return TouchModel(load_contact(path, card), card, trust)
    return TouchModel(_networks(card["name"], [_member(path)[0]], fallback), card, trust)


def _load_ensemble(path: Path, card: dict[str, Any]) -> TouchModel:
    loaded = [_member(path.with_name(Path(str(member)).name)) for member in card["members"]]
    found = combined_sha256([sha256 for _, sha256 in loaded])
    if found != card["sha256"]:
        raise ModelError(f"{path}: sha256: {card['sha256']} is not {found} of its members; one was replaced")
    return TouchModel(_networks(card["name"], [member for member, _ in loaded]), card)


def _networks(name: str, members: list[Member], fallback: Fallback | None = None) -> NetworkEstimator:
    try:
        return NetworkEstimator(members, fallback)
    except ModelError as err:
        raise ModelError(f"{name}: {err}") from err


def _member(path: Path) -> tuple[Member, str]:
    from foretouch.models.network.checkpoint import load_network
    from foretouch.models.network.folding import fold

    net, card = load_network(path)
    try:
        familiar = None if card["familiar"] is None else Familiarity.from_card(card["familiar"])
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
    return Member(net.config, fold(net), familiar), card["sha256"]


def find_card(name_or_path: str | Path) -> Path:
    """Path of a model's card; whether it is there is not asked, except for shipped ones.

    Args:
        name_or_path: As of `load_model`.

    Raises:
        ModelError: If it is neither a shipped name nor the path of a card or of weights.
    """
    name = DEFAULT_MODEL if str(name_or_path) == "default" else str(name_or_path)
    if name in available_models():
        return _shipped() / f"{name}.json"
    path = Path(name)
    if path.suffix == ".safetensors":
        path = path.with_suffix(".json")
    if path.suffix != ".json":
        raise ModelError(f"{name}: is no card (.json), no weights (.safetensors) and none of {_known()}")
    return path


def _known() -> str:
    return ", ".join(available_models()) or "the shipped models (there are none)"


def _shipped() -> Path:
    return Path(str(resources.files("foretouch.models"))) / "weights"
