# SPDX-License-Identifier: Apache-2.0
"""Find a model by name, path or model folder, and load it; torch is imported when the first network is loaded."""

import tempfile
import weakref
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, Final

from foretouch.base.files import read_json
from foretouch.errors import FileError, ModelError, checked, nearest, require_type, shown
from foretouch.models.card import CARD_FORMAT, OWN, read_card
from foretouch.models.touch_model import TouchModel

DEFAULT_MODEL: Final = "contact-v3"
MODEL_WORDS: Final = "Name of a model, or path of its card, weights or model folder; several with commas between them, of networks that are joined"
PREDICTOR_WORDS: Final = (
    "Predictor of a model of your own, whose code is imported: module:attribute, or an entry point of foretouch.models"
)
"""What the settings of the model and of its predictor are."""

SIMULATED_HAND_MODEL: Final = "simulated"
"""The model of scenes with a simulated hand."""


def available_models() -> list[str]:
    """Return the names of the models that come with the package, the default first."""
    return sorted((path.stem for path in _released().glob("*.json")), key=lambda name: (name != DEFAULT_MODEL, name))


@checked
def load_model(name_or_path: str | Path = "default", predictor: Any = None) -> TouchModel:
    """Load a model that comes with the package, or one from a file or a model folder, or join networks for different modalities.

    Args:
        name_or_path: `default`, a name from `available_models`, the path of a card or of its weights, or the folder of
            a finished run of `foretouch train`; or several of these with commas between them, whose networks are joined.
        predictor: Of a model of your own (`foretouch.calibrate`), the predictor, a class or function that makes it, or
            the name of either: `module:attribute`, or an entry point of the group `foretouch.models`.

    Raises:
        ModelError: If there is no such model, or it is damaged, or does not predict each modality; if a model of your own
            is loaded without its predictor, or another model with one.
    """
    require_type(name_or_path, str | Path, "model", "not the name or the path of a model", ModelError)
    path, *others = find_cards(name_or_path)
    if others:
        from foretouch.models.network.checkpoint import join

        return temporary_model(lambda folder: join([path, *others], folder), predictor)
    card = read_card(path)
    if card["kind"] == "hold":
        raise ModelError(f"{shown(path)}: kind: predicts whether a grasp holds, and no touch")
    if card["kind"] == OWN:
        from foretouch.models.own import load_model as load_own

        load: Callable[[Path, Mapping[str, Any]], TouchModel] = partial(load_own, predictor=predictor)
    elif predictor is not None:
        raise ModelError(f"{shown(path)}: kind: {card['kind']} has a predictor already; leave predictor out")
    elif card["kind"] == "contact":
        from foretouch.models.contact.estimator import load_model as load
    else:
        from foretouch.models.network.checkpoint import load_model as load
    model = load(path, card)
    model.path = path
    return model


def temporary_model(write: Callable[[Path], Path], predictor: Any = None) -> TouchModel:
    """Return a model whose files are in a temporary folder that lives as long as it.

    Args:
        write: Writes the files to a folder, and returns the path of the card.
        predictor: As of `load_model`.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="foretouch-model-")))
        model = load_model(write(folder), predictor)
        weakref.finalize(model, stack.pop_all().close)
    return model


def find_cards(name_or_path: str | Path) -> list[Path]:
    """Paths of the cards of a model, of one or of several with commas between them; see `find_card`."""
    parts = str(name_or_path).split(",")
    one = len(parts) == 1 or _is_there(Path(str(name_or_path)))
    return [find_card(name_or_path)] if one else [find_card(part.strip()) for part in parts]


def find_card(name_or_path: str | Path) -> Path:
    """Path of a model's card. Whether a path exists is checked for names and folders only.

    Args:
        name_or_path: As in `load_model`.

    Raises:
        ModelError: If it is not one of a name, the path of a card or of weights, and a folder with one model.
    """
    name = DEFAULT_MODEL if str(name_or_path) == "default" else str(name_or_path)
    if name in available_models():
        return _released() / f"{name}.json"
    path = Path(name)
    if _is_folder(path):
        return _card_in(path)
    if path.suffix == ".safetensors":
        path = path.with_suffix(".json")
    if path.suffix != ".json":
        from foretouch.models.own import PREDICTORS

        if name in PREDICTORS:
            raise ModelError(f"{shown(name)}: is a predictor: foretouch.calibrate makes a model of it")
        known = available_models()
        raise ModelError(
            f"{shown(name)}: is not a model folder, no card (.json), no weights (.safetensors) and none of "
            f"{', '.join(known)}{nearest(name, known)}"
        )
    return path


def _card_in(folder: Path) -> Path:
    """Return the card of the only model in a folder."""
    models = [path.name for path in sorted(folder.glob("*.json")) if _is_card(path)]
    if len(models) == 1:
        return folder / models[0]
    if models:
        raise ModelError(f"{folder}: holds several models, {', '.join(models)}: name the card of one")
    if any((folder / name).exists() for name in ("config.yaml", "log.jsonl", "state.safetensors")):
        raise ModelError(
            f"{folder}: is an unfinished run without a model card; `foretouch train --resume` completes it"
        )
    raise ModelError(f"{folder}: holds no model card (<name>.json), so it is not a model folder of `foretouch train`")


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that no file can have
        return False


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # a name that no file can have
        return False


def _is_card(path: Path) -> bool:
    """Return whether a JSON file is a model card; a damaged file counts as one, so that it is reported and not overlooked."""
    try:
        document = read_json(path)
    except FileError:
        return True
    return isinstance(document, dict) and document.get("format") == CARD_FORMAT


def _released() -> Path:
    return Path(str(resources.files("foretouch.models"))) / "weights"
