# SPDX-License-Identifier: Apache-2.0
"""The files of a model: `<name>.json` (its card), `<name>.safetensors` and `<name>.trust.safetensors` (its calibration).

The card names the others with their hashes.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from foretouch.errors import ModelError
from foretouch.files import replace_files
from foretouch.models.calibration import Calibration
from foretouch.models.card import CARD_FORMAT, CARD_VERSION, card_sensor, card_text
from foretouch.models.files import file_beside, packed, read_part, read_tensors
from foretouch.models.novelty import Fallback
from foretouch.types import AnyArray
from foretouch.types.channels import Channels

CardCalibration: TypeAlias = tuple[Calibration, Mapping[str, Any]]
"""A calibration, and its facts for the card: `level`, `regimes` (objects and coverage by group) and `rest`."""

_EMPTY: Final[Mapping[str, Any]] = {
    **{field: {} for field in ("data", "split", "skill", "baselines")},
    "summary": "",
    "limits": [],
    "calibration": None,
}
_FALLBACK: Final = "fallback/"


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
        kind: From `foretouch.models.card.KINDS`.
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
    card: dict[str, Any] = {"format": CARD_FORMAT, "format_version": CARD_VERSION, "kind": kind, "name": card_path.stem}
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
    """The calibration of a model of some channels that a card names, and the fallback in the same file; None where there is none.

    Raises:
        ModelError: Names the file and the field: absent, damaged, with another hash than the card's, or not fitting.
    """
    facts = card["calibration"]
    if facts is None:
        return None, None
    for field in ("weights", "sha256"):
        if not isinstance(facts.get(field), str):
            raise ModelError(f"{card_path}: calibration.{field}: is missing")
    path = file_beside(card_path, facts["weights"], "calibration.weights")
    tensors = read_tensors(path, facts["sha256"], card_path.name)
    try:
        fallback = any(name.startswith(_FALLBACK) for name in tensors)
        own = {name: np.asarray(array) for name, array in tensors.items() if not name.startswith(_FALLBACK)}
        return (
            Calibration.from_tensors(own, channels),
            read_part(Fallback, tensors, _FALLBACK, channels=channels) if fallback else None,
        )
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
