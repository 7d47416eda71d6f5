# SPDX-License-Identifier: Apache-2.0
"""The files of a model: `<name>.json` (its card), `<name>.safetensors` and `<name>.trust.safetensors` (its calibration).

A card says what the model is, what it was trained on and how well it performs. It is plain JSON, which names the others with
their hashes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from foretouch.base.files import COUNT, Number, read_json, replace_files, require_schema
from foretouch.errors import ConfigError, FileError, ModelError, TactileError, quoted, shown
from foretouch.models.calibration import Calibration
from foretouch.models.files import packed, read_part, read_tensors
from foretouch.tactile.description import Sensor, require_same, sensor_in
from foretouch.types import AnyArray
from foretouch.types.channels import Channels

if TYPE_CHECKING:
    from foretouch.models.novelty import Fallback

CARD_FORMAT: Final = "foretouch-model"
_CARD_VERSION: Final = 2

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


OWN: Final = "own"
"""Kind of a model whose predictor is code of the user."""

NETWORKS: Final = "networks"
"""Kind of a model of several networks, for different modalities."""

KINDS: Final[Mapping[str, _Fields]] = {
    "network": {**_TRAINED, "familiar": (dict, type(None))},
    NETWORKS: {**_TRAINED, "familiar": {"*": (dict, type(None))}},
    "contact": {**_TRAINED, "ranges": dict},
    OWN: {**_TRAINED, "predictor": str},
    "hold": _TRAINED,
}
"""Fields that the cards of each kind hold besides `_COMMON`, with their types."""

CardCalibration: TypeAlias = tuple[Calibration, Mapping[str, Any]]
"""A calibration, and its facts for the card: `level`, `regimes` (objects and coverage by group) and `rest`."""

_EMPTY: Final[Mapping[str, Any]] = {
    **{field: {} for field in ("data", "split", "skill", "baselines")},
    "summary": "",
    "limits": [],
    "calibration": None,
}
_FALLBACK: Final = "fallback/"


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
    if card.get("format_version") != _CARD_VERSION:
        raise ModelError(f"{path}: format_version: {quoted(card.get('format_version'))} is not {_CARD_VERSION}")
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
    """Return the sensor whose readings a model predicts.

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
    """Return the content of a card's file."""
    return json.dumps(card, indent=1) + "\n"


def save_model(
    card_path: Path,
    kind: str,
    tensors: Mapping[str, AnyArray],
    facts: Mapping[str, Any],
    calibration: CardCalibration | None = None,
    fallback: Fallback | None = None,
) -> Path:
    """Write weights, card and, where there is one, the calibration: all of them or none.

    Args:
        card_path: `<name>.json`; its folder is made if absent.
        kind: From `KINDS`.
        tensors: The weights by name.
        facts: Fields of the card; empty if omitted.
        calibration: With its facts.
        fallback: Of a network with a calibration, stored in the same file.

    Returns:
        Path of the card.

    Raises:
        FileError: If a file cannot be written; the files before are kept.
    """
    weights = card_path.with_suffix(".safetensors")
    content, sha256 = packed(tensors)
    files = {weights: content}
    card: dict[str, Any] = {
        "format": CARD_FORMAT,
        "format_version": _CARD_VERSION,
        "kind": kind,
        "name": card_path.stem,
    }
    card |= {"weights": weights.name, "sha256": sha256, **_EMPTY, **facts}
    sensor = card_sensor(card, card_path)
    card |= {"sensor_name": sensor.config.name, "sensor_sha256": sensor.sha256}
    if calibration is not None:
        own = calibration[0].to_tensors()
        if fallback is not None:
            own |= {_FALLBACK + key: value for key, value in fallback.to_tensors().items()}
        path = card_path.with_name(f"{card_path.stem}.trust.safetensors")
        files[path], sha256 = packed(own)
        card["calibration"] = {"weights": path.name, "sha256": sha256, **calibration[1]}
    replace_files({**files, card_path: card_text(card).encode()})
    return card_path


def load_calibration(
    card_path: Path, card: Mapping[str, Any], channels: Channels
) -> tuple[Calibration | None, Fallback | None]:
    """Return the calibration of a model of some channels that a card names, and the fallback in the same file; None where there is none.

    Raises:
        ModelError: Names the file and the field: absent, damaged, with another hash than the card's, or not fitting.
    """
    from foretouch.models.novelty import Fallback  # not before, since SciPy takes long to import

    facts = card["calibration"]
    if facts is None:
        return None, None
    for field in ("weights", "sha256"):
        if not isinstance(facts.get(field), str):
            raise ModelError(f"{card_path}: calibration.{field}: is missing")
    path, tensors = read_tensors(card_path, facts, "calibration.")
    try:
        fallback = any(name.startswith(_FALLBACK) for name in tensors)
        own = {name: np.asarray(array) for name, array in tensors.items() if not name.startswith(_FALLBACK)}
        return (
            Calibration.from_tensors(own, channels),
            read_part(Fallback, tensors, _FALLBACK, channels=channels) if fallback else None,
        )
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
