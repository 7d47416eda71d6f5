# SPDX-License-Identifier: Apache-2.0
"""Settings of one training, by whatever method, and how they are read."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final, Self

from foretouch.config import EMPTY, Settings, load_yaml, parse_overrides, setting
from foretouch.doors import Door
from foretouch.errors import ConfigError, nearest, quoted, require_type, shown
from foretouch.models.network.config import EACH, ModelConfig
from foretouch.tactile import Ranges
from foretouch.types.channels import Channels
from foretouch_lab.learning.training.contact import ContactTrainingConfig, ranges_of
from foretouch_lab.learning.training.srgan import SrganConfig
from foretouch_lab.learning.training.supervised import TrainConfig

METHODS: Final = ("supervised", "srgan", "contact")

GROUPS: Final = {
    "model": ("supervised", "srgan"),
    "train": ("supervised",),
    "srgan": ("srgan",),
    "contact": ("contact",),
}
"""The methods that each group of settings is for."""

_GROUP_OF: Final = {"supervised": "train", "srgan": "srgan", "contact": "contact"}  # which holds the seed
_RECIPES: Final = "recipes/train"


@dataclass(frozen=True, kw_only=True)
class RunConfig(Settings):
    """Settings of every `foretouch train`.

    Raises:
        ConfigError: If a setting is out of bounds or has no effect on the method,
            a release is set to train on a part of the samples, or a network with only some of the modalities is to be
            calibrated or released.
    """

    name: str = setting(
        "", "Name of the model and of its files: letters, digits, '.', '_' and '-'; by default the model folder's"
    )
    data: str | None = setting(None, "Dataset: recorded dataset, training store or vision2tactile folders")
    method: str = setting(
        "supervised",
        "Training method: supervised (a network from labelled samples), srgan (a network from labelled, unlabelled and "
        "generated samples) or contact (the contact model)",
        choices=METHODS,
    )
    split: str | None = setting(
        None, "Part of the dataset to learn from, such as labels/T50 or time/block 0; all samples by default"
    )
    calibrate: bool | None = setting(
        None,
        "Calibrate intervals on held-out predictions, for which the model is fitted again on each of up to 15 folds; "
        "the weights do not depend on it. By default for method contact only, which takes seconds",
    )
    left_out: str = setting(
        "objects",
        "What is left out at once to calibrate the intervals of unfamiliar objects: objects, or all objects of a shape, "
        "which simulated data state",
        choices=("objects", "shapes"),
    )
    release: bool = setting(
        False,
        "Score model and baselines on three splits by cross-validation, calibrate, and list the limits in the card",
    )
    model: ModelConfig = ModelConfig()
    train: TrainConfig = TrainConfig()
    srgan: SrganConfig = SrganConfig()
    contact: ContactTrainingConfig = ContactTrainingConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.name and not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}", self.name):
            rule = "is not 1 to 100 letters, digits, '.', '_' or '-', the first one no '.'"
            raise ConfigError(f"name: {quoted(self.name)} {rule}")
        if self.calibrate is None:
            object.__setattr__(self, "calibrate", not self.has_network)
        for group, methods in GROUPS.items():
            given, default = (getattr(config, group).to_mapping() for config in (self, type(self)))
            changed = [key for key in given if given[key] != default[key]]
            if self.method not in methods and changed:
                raise ConfigError(f"{group}.{changed[0]}: has no effect on method {self.method!r}")
        if self.release and self.split is not None:
            raise ConfigError("release: trains on all samples; leave split empty")
        if self.calibrates and self.model.outputs not in (every := ModelConfig().outputs, (EACH,)):
            field = "release" if self.release else "calibrate"
            rule = f"{list(self.model.outputs)} are not all modalities, {', '.join(every)}, or {EACH}"
            raise ConfigError(f"{field}: model.outputs: {rule}")

    def to_mapping(self) -> dict[str, Any]:
        """Return plain nested data that `from_mapping` accepts, without the groups that have no effect on the method."""
        return {name: value for name, value in super().to_mapping().items() if self.method in GROUPS.get(name, METHODS)}

    @property
    def has_network(self) -> bool:
        """Whether a network is trained, in epochs."""
        return self.method in GROUPS["model"]

    @property
    def calibrates(self) -> bool:
        """Whether the model gets intervals."""
        return bool(self.calibrate) or self.release

    @property
    def seed(self) -> int:
        """Seed of the method."""
        own: TrainConfig | SrganConfig | ContactTrainingConfig = getattr(self, _GROUP_OF[self.method])
        return own.seed

    def with_seed(self, seed: int) -> Self:
        """Return the settings with another seed of the method."""
        return self.updated({f"{_GROUP_OF[self.method]}.seed": seed}, "seed")

    @classmethod
    def from_card(cls, card: Mapping[str, Any], where: str | Path) -> Self:
        """Return the settings that a model was trained with, as far as its card holds them.

        Raises:
            ConfigError: Names `where` the card was read: it holds none, or they are not of this version.
        """
        if card["kind"] == "contact":
            return cls.from_mapping({"method": "contact", "contact": card["config"]}, str(where))
        if not isinstance(card.get("training"), dict):
            raise ConfigError(f"{where}: training: the card does not hold the settings of the training")
        return cls.from_mapping(card["training"], f"{where}: training")

    def ranges(self, channels: Channels) -> Ranges:
        """Return ranges of the hand that the model learns from, which has a sensor of these channels."""
        return self.model.ranges.ranges if self.has_network else ranges_of(self.contact, channels)


RECIPES: Final = Door("foretouch.recipes", "recipe", kind=Mapping)
"""Settings of runs that installed packages add, by name."""


def load_run_config(config: str | Path, overrides: Sequence[str] = ()) -> RunConfig:
    """Return settings of a run from a YAML file and `key=value` words.

    Args:
        config: A YAML file, the name of a recipe that comes with the package, such as `contact-v3`, or a method, for
            its defaults; or a recipe of another package, an entry point of the group `foretouch.recipes` that names a dictionary. `model` may be the path of a YAML file with the network's settings, relative to the file that
            names it.
        overrides: `key=value`, applied to the file's settings.

    Raises:
        ConfigError: If a file cannot be read, or a setting is unknown or out of bounds; names file, field and rule.
    """
    require_type(config, str | Path, "recipe", f"neither a name, such as {', '.join(METHODS)}, nor a path", ConfigError)
    path = Path(config)
    folder = Path(str(resources.files("foretouch_lab.learning"))) / _RECIPES
    recipes = {recipe_file.stem: recipe_file for recipe_file in sorted(folder.glob("*.yaml"))}
    if path.is_file() or path.suffix or len(path.parts) > 1 or str(config) in recipes:
        file = path if path.is_file() else recipes.get(str(config), path)
        mapping = _with_network(load_yaml(file), file.parent)
    elif str(config) in METHODS:
        mapping = {"method": str(config)}
    elif str(config) in RECIPES:
        mapping = _with_network(dict(RECIPES.load(str(config))), Path())
    else:
        known = [*recipes, *METHODS, *RECIPES]
        raise ConfigError(f"{shown(path)}: is neither a file nor one of {', '.join(known)}{nearest(config, known)}")
    source = " ".join([str(config), *overrides])  # which of them is at fault, if both are, the field says
    return RunConfig.from_mapping(mapping | _with_network(parse_overrides(overrides), Path()), source)


def recipe_of(words: str) -> RunConfig:
    """Return the settings of a recipe and of `key=value` words after it, such as `p2 model.outputs=each`.

    Args:
        words: In one text, quoted as in a shell.

    Raises:
        ConfigError: As of `load_run_config`.
    """
    try:
        recipe, *overrides = shlex.split(words) or [""]
    except ValueError as err:
        raise ConfigError(f"{shown(words)}: {err}") from err
    return load_run_config(recipe, overrides)


def _with_network(mapping: dict[str, Any], folder: Path) -> dict[str, Any]:
    network = mapping.get("model")
    if isinstance(network, str) and network != EMPTY:
        return {**mapping, "model": load_yaml(folder / network)}
    return mapping
