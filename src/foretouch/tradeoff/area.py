# SPDX-License-Identifier: Apache-2.0
"""Define and find areas: an experiment that measures skills, and for each of its variants a callable to be timed.

An `Area` is an `Experiment`: its cells measure skills, each in its own process, and are kept when it is resumed. In
addition it lists the variants that are compared and makes each ready to be timed. To add an area, add a folder or a
module to `foretouch.tradeoff.areas` that holds an `EXPERIMENT`.
"""

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.experiments.framework.experiment import Cell, D, Experiment, Row, S, find_experiment

_PACKAGE: Final = "foretouch.tradeoff.areas"
_MOST_VARIANTS: Final = 120
_MOST_TRAININGS: Final = 25

Answer = npt.NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class TradeoffSettings(Settings):
    """Settings of every area."""

    timing_s: float = setting(60.0, "Time of all timings together", unit="s", minimum=0.1, maximum=3600.0)
    requests: tuple[int, ...] = setting((1,), "Sizes of the requests that are timed", minimum=1)
    seed: int = setting(0, "Seed of the order of timings", minimum=0)


@dataclass(frozen=True)
class Variant:
    """One setting of the component that is measured: the shipped one, or one that differs from it."""

    name: str  # unique, and short: it is written beside its point in the picture
    factor: str  # what differs: `shipped` (one for each panel's skill), `reference`, the name of one setting, or two joined by ` x `
    values: Mapping[str, Any] = field(default_factory=dict)  # plain JSON data from which the area makes it
    compared_with: str = ""  # variant whose answers its own shall equal; "" for the shipped one
    reference: str = ""  # variant to whose time its ratio is taken; "" for that of the area
    missing: str = ""  # why it cannot run here, such as a library that is not installed; "" if it can


class Timed(NamedTuple):
    """A variant that is ready to be timed."""

    answer: Callable[[int], Answer]  # from the size of a request to an answer that is comparable with other variants'
    size_mb: float | None = None  # on disk [MB]; None if that has no meaning
    whole: float = 1.0  # number of such calls that make the whole, as steps make a training; times are multiplied by it


class Panel(NamedTuple):
    """One diagram of the picture: the skill in a column against the time of requests of one size."""

    skill: str
    request: int
    title: str
    share: float = 0.9  # of the best skill that a good variant keeps


@dataclass(frozen=True, kw_only=True)
class Area(Experiment[S, D]):
    """Declaration of one area. Its settings are `TradeoffSettings`, and its presets are `small` and `full`.

    A cell may measure several variants; one that trains a network has the value `trains`, the number of trainings.
    `tabulate` returns one row for each variant with the columns `variant` and, for each of `skills`, `<skill>`,
    `<skill>_low` and `<skill>_high` (its spread), and errors as the area likes. A variant without a row has times alone.
    A `figure` of its own is drawn from the rows of `tradeoff.csv`, beside `tradeoff.png`.

    Attributes:
        variants: All variants of a preset's settings, at most 120.
        timed: Makes a variant ready to be timed; called once for each.
        shipped: Name of the variant that users have without asking.
        reference: Name of the variant that ratios of times are taken to.
        skills: Columns of skills, each with its meaning.
        panels: Diagrams of the picture.
        request: What a request's size counts, such as `grasps`.
        unit: Unit of the answers.
        seconds: Estimated processor time of cells that are not finished yet, from a short timing [s].
        notes: Further sentences from the rows of `tradeoff.csv`.
    """

    variants: Callable[[S], Sequence[Variant]]
    timed: Callable[[Variant, S, D], Timed]
    shipped: str
    reference: str
    skills: Mapping[str, str]
    panels: Sequence[Panel]
    request: str = "request"
    unit: str = "counts"
    seconds: Callable[[S, D, Sequence[Cell]], float] | None = None
    notes: Callable[[Sequence[Row]], Sequence[str]] = lambda _: ()

    @property
    def command(self) -> str:
        """Words that run it."""
        return f"foretouch tradeoff {self.name}"

    def checked_variants(self, settings: S) -> list[Variant]:
        """The variants of settings.

        Raises:
            ConfigError: If two have the same name, shipped or reference one is absent, or there are too many.
        """
        variants = list(self.variants(settings))
        names = [one.name for one in variants]
        if len(set(names)) < len(names):
            raise ConfigError(f"{self.name}: variants: {max(names, key=names.count)!r} occurs twice")
        if absent := {
            self.shipped,
            self.reference,
            *(name for one in variants for name in (one.compared_with, one.reference)),
        } - {"", *names}:
            raise ConfigError(f"{self.name}: variants: {min(absent)!r} is absent")
        if len(names) > _MOST_VARIANTS:
            raise ConfigError(f"{self.name}: variants: {len(names)} exceeds {_MOST_VARIANTS}")
        return variants

    def check_trainings(self, cells: Sequence[Cell]) -> None:
        """Refuse cells that train more than 25 networks."""
        if (count := sum(cell.values.get("trains", 0) for cell in cells)) > _MOST_TRAININGS:
            raise ConfigError(f"{self.name}: cells: {count} trainings exceed {_MOST_TRAININGS}")


def area_names() -> list[str]:
    """Names of the areas of this package, without importing them."""
    return sorted(one.name for one in pkgutil.iter_modules(importlib.import_module(_PACKAGE).__path__))


def find_area(name: str) -> Area[Any, Any]:
    """Find an area by name, or by the dotted name of a user's module that holds an `EXPERIMENT`.

    Raises:
        ConfigError: If there is none.
    """
    if name not in area_names() and "." not in name:
        raise ConfigError(f"tradeoff: {name!r} is none of {', '.join(area_names())}")
    found = find_experiment(f"{_PACKAGE}.{name}" if "." not in name else name)
    if not isinstance(found, Area):
        raise ConfigError(f"tradeoff: {name}: is an experiment without times")
    return found
