# SPDX-License-Identifier: Apache-2.0
"""Methods of training: one module per family of models, each with its learner and its settings.

To add a method, add a module here with a `Learner` subclass under `@register("NAME")`; every module of this package is
imported when a method is looked up, and `foretouch train` accepts `method: NAME` from then on.
"""

import importlib
import pkgutil
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from foretouch.config import load_yaml, parse_overrides
from foretouch.errors import ConfigError
from foretouch.learning.training.learners.learner import LEARNERS, Learner, RunConfig, register

__all__ = ["Learner", "RunConfig", "find_learner", "load_run_config", "read_run_config", "register"]

_RECIPES = "recipes/train"


def find_learner(method: str, source: str = "") -> type[Learner[Any]]:
    """The learner of a method; `source` is named in errors.

    Raises:
        ConfigError: If there is none.
    """
    if method not in _methods():
        raise ConfigError(f"{_prefix(source)}RunConfig.method: {method!r} is none of {', '.join(sorted(LEARNERS))}")
    return LEARNERS[method]


def _methods() -> Mapping[str, type[Learner[Any]]]:
    """All learners by method, after importing the modules of this package."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    return LEARNERS


def load_run_config(config: str | Path, overrides: Sequence[str] = ()) -> RunConfig:
    """Settings of a run from a YAML file and `key=value` words.

    Args:
        config: A YAML file, the name of a recipe that comes with the package, such as `contact-v2`, or a method, for
            its defaults. `model` may be the path of a YAML file with the network's settings, relative to the file that
            names it.
        overrides: `key=value`, applied to the file's settings.

    Raises:
        ConfigError: If a file cannot be read, or a setting is unknown or out of bounds; names file, field and rule.
    """
    path = Path(config)
    shipped = Path(str(resources.files("foretouch.learning"))) / _RECIPES / f"{config}.yaml"
    if not path.exists() and str(config) in _methods():
        mapping: dict[str, Any] = {"name": str(config), "method": str(config)}
    else:
        file = shipped if shipped.is_file() and not path.exists() else path
        mapping = _with_network(load_yaml(file), file.parent)
    mapping |= _with_network(parse_overrides(overrides), Path())
    return read_run_config(mapping, str(config))


def _with_network(mapping: dict[str, Any], folder: Path) -> dict[str, Any]:
    network = mapping.get("model")
    return {**mapping, "model": load_yaml(folder / network)} if isinstance(network, str) else mapping


def read_run_config(mapping: Mapping[str, Any], source: str = "") -> RunConfig:
    """Settings of a run from plain data; those of other methods must have their defaults.

    Args:
        mapping: Names to values, nested or dotted; `method` selects the type of the result.
        source: Named in errors.

    Raises:
        ConfigError: If a setting is unknown, out of bounds, or has no effect on the method.
    """
    method = str(mapping.get("method", RunConfig.method))
    own = find_learner(method, source).config_type
    others = {name: kind for learner in _methods().values() for name, kind in learner.config_type.groups().items()}
    unused: dict[str, dict[str, Any]] = {name: {} for name in others.keys() - own.groups().keys()}
    used = {}
    for key, value in mapping.items():
        group, _, name = key.partition(".")
        if group not in unused:
            used[key] = value
        elif name:
            unused[group][name] = value
        elif isinstance(value, Mapping):
            unused[group] |= value
        else:
            raise ConfigError(f"{_prefix(source)}{group}: {value!r} is not a group of settings")
    for group, values in unused.items():
        kind = others[group]
        given, default = (kind.from_mapping(one, f"{_prefix(source)}{group}").to_mapping() for one in (values, {}))
        for key in given:
            if given[key] != default[key]:
                raise ConfigError(f"{_prefix(source)}RunConfig.{group}.{key}: has no effect on method {method!r}")
    return own.from_mapping(used, source)


def _prefix(source: str) -> str:
    return f"{source}: " if source else ""
