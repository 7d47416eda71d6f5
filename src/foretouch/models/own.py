# SPDX-License-Identifier: Apache-2.0
"""Models whose predictor is code of the user: how the code is found, and the files of such a model.

The user names the code, as `module:attribute` or as an entry point of the group `foretouch.models`. A card only states
which code it was made of; nothing that a card names is imported.

The weights hold what the predictor has learned, and what it answered to one made-up cloud. A predictor that
answers otherwise when the model is loaded is refused, since the intervals are not of its errors.
"""

import inspect
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from foretouch.doors import Door, import_place
from foretouch.errors import ConfigError, ForetouchError, ModelError, described, shown
from foretouch.grasp import hand_rotation
from foretouch.models.card import OWN, CardCalibration, card_sensor, load_calibration, save_model
from foretouch.models.files import read_tensors, under
from foretouch.models.predictor import Predictor
from foretouch.models.touch_model import TouchModel
from foretouch.types import AnyArray, Cloud, Float64, Grasps

PREDICTORS: Final = Door("foretouch.models", "predictor")
"""The predictors that installed packages name."""

_LEARNED, _ANSWERED = "learned/", "answered"
_SAME: Final = (
    0.05  # of the half widths of new objects: how far an answer may be from the saved one, by rounding elsewhere
)


def find_predictor(predictor: Any, learned: Mapping[str, AnyArray] | None = None) -> Predictor:
    """Return a predictor that the user passes or names.

    Args:
        predictor: A predictor; a class or function that makes one, which is called without arguments; or the name of either,
            `module:attribute` or an entry point of the group `foretouch.models`. Modules are also looked for in the
            current folder.
        learned: What a saved predictor had learned, by name. A class with `from_tensors` makes a predictor of it; of
            another they become attributes. A predictor that is passed keeps its own.

    Raises:
        ModelError: If there is no such code, it fails, or it makes no predictor.
    """
    name = shown(predictor if isinstance(predictor, str) else name_of(predictor))
    found: Any = predictor
    try:
        if isinstance(predictor, str):
            found = _named(predictor)
        if learned and isinstance(found, type) and hasattr(found, "from_tensors"):
            found = found.from_tensors(learned)
        elif isinstance(found, type) or (callable(found) and not hasattr(found, "estimate")):
            found = found()
            for key, array in (learned or {}).items():
                setattr(found, key, array)
    except ConfigError as err:
        raise ModelError(str(err)) from err
    except ForetouchError:
        raise
    except (Exception, SystemExit) as err:
        raise ModelError(f"predictor: {name}: {described(err)}") from err
    return require_predictor(found)


def _named(name: str) -> Any:
    """Import what `module:attribute` or an entry point names."""
    if ":" not in name:
        return PREDICTORS.load(name, f"predictor: {shown(name)} (which is no module:attribute)")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)  # last, so that no file of this folder hides another module
    return import_place(name)


def require_predictor(predictor: Any) -> Predictor:
    """Return a predictor; raises a `ModelError` if an object has no `estimate(cloud, grasps, table=None)`."""
    estimate = getattr(predictor, "estimate", None)
    if not callable(estimate):
        raise ModelError(f"predictor: {name_of(predictor)} has no estimate(cloud, grasps, table=None)")
    try:
        inspect.signature(estimate).bind(None, None, None)
    except TypeError as err:
        raise ModelError(
            f"predictor: {name_of(predictor)}.estimate must take (cloud, grasps, table=None): {err}"
        ) from err
    except ValueError:  # of compiled code, which has no signature
        pass
    return cast("Predictor", predictor)


def name_of(predictor: Any) -> str:
    """Return `module:name` of a predictor's class, or of a class or function."""
    made_by = predictor if hasattr(predictor, "__qualname__") else type(predictor)
    return f"{made_by.__module__}:{made_by.__qualname__}"


def save_own(
    card_path: Path, predictor: Predictor, facts: Mapping[str, Any], calibration: CardCalibration | None = None
) -> Path:
    """Write the model of an own predictor and return the path of its card; see `save_model`."""
    tensors = {_LEARNED + name: value for name, value in _learned(predictor).items()}
    facts = {"config": {}, "predictor": name_of(predictor), **facts}
    plain = TouchModel(predictor, {**facts, "kind": OWN, "name": card_path.stem, "sha256": ""})
    with suppress(Exception):  # it may refuse a cloud that is not of a camera
        if np.isfinite(answered := _answer(plain)).all():
            tensors[_ANSWERED] = answered
    return save_model(card_path, OWN, tensors, facts, calibration)


def load_model(card_path: Path, card: Mapping[str, Any], predictor: Any = None) -> TouchModel:
    """Return the model of a card and a predictor that the user passes or names (`find_predictor`).

    Raises:
        ModelError: If no predictor is given, or it is not the one of the card; or names a damaged file.
    """
    if predictor is None:
        made_of = shown(card["predictor"])
        rule = f"is made of {made_of}, and no card makes foretouch import code: if you trust it, name it, such as"
        raise ModelError(f'{card_path}: {rule} --predictor {made_of}, or load_model(…, predictor="{made_of}")')
    channels = card_sensor(card, card_path).channels
    calibration, _ = load_calibration(card_path, card, channels)
    weights, tensors = read_tensors(card_path, card)
    model = TouchModel(find_predictor(predictor, under(_LEARNED, tensors)), card, calibration)
    if _ANSWERED in tensors:
        answered = _answer(model)
        allowed = 1e-6 * np.abs(tensors[_ANSWERED]) + channels.resolution
        if calibration is not None:
            allowed = _SAME * calibration.groups["new"].half_width
        if answered.shape != tensors[_ANSWERED].shape or not (np.abs(answered - tensors[_ANSWERED]) <= allowed).all():
            rule = f"answers other numbers than the predictor of this model, {shown(card['predictor'])}"
            raise ModelError(f"{weights}: predictor: {name_of(model.predictor)} {rule}; calibrate it again")
    return model


def _learned(predictor: Predictor) -> dict[str, AnyArray]:
    """Return the arrays of `to_tensors`; of a predictor without it, the arrays among its attributes."""
    to_tensors = getattr(predictor, "to_tensors", None)
    if to_tensors is None:
        own = getattr(predictor, "__dict__", {})
        return {name: value for name, value in own.items() if isinstance(value, np.ndarray) and value.dtype != object}
    try:
        return {str(name): np.asarray(value) for name, value in to_tensors().items()}
    except Exception as err:
        raise ModelError(f"predictor: {name_of(predictor)}: to_tensors: {described(err)}") from err


def _answer(model: TouchModel) -> Float64:
    """Return (2, D) what a model answers to two grasps on a can that stands below the camera."""
    turn, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False), np.linspace(0.0, 0.1, 20))
    x, y = 0.033 * np.cos(turn), 0.033 * np.sin(turn)
    xyz = np.stack([x, y, 1.2 - height], axis=-1).reshape(-1, 3).astype(np.float32)
    cloud = Cloud(xyz, np.full(xyz.shape, 128, np.uint8), frame_id="made_up")
    middle, reach = np.array([0.0, 0.0, 1.15]), np.array([[0.034, 0.0, 0.0], [0.0, 0.034, 0.0]])
    turned = np.array([hand_rotation(middle + one, middle - one, np.array([0.0, 0.0, 1.0])) for one in reach])
    grasps = Grasps(middle + reach, middle - reach, turned)
    return model.estimate(cloud, grasps).counts
