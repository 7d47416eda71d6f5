# SPDX-License-Identifier: Apache-2.0
"""The three levels of contact behind one call, and the choice among them."""

import math
from collections.abc import Sequence
from typing import Final, Literal

from foretouch.errors import ContactError
from foretouch.simulation.contact.hertz import solve_hertz
from foretouch.simulation.contact.layer import solve_layer
from foretouch.simulation.contact.problem import (
    DEFAULT_CONFIG,
    Command,
    ContactConfig,
    ContactProblem,
    ContactSolution,
    Layer,
)
from foretouch.simulation.contact.winkler import solve_winkler

Level = Literal["auto", "hertz", "winkler", "layer"]
LEVELS: Final = ("auto", "hertz", "winkler", "layer")

_SOLVERS: Final = {"hertz": solve_hertz, "winkler": solve_winkler, "layer": solve_layer}


def choose_level(layers: Sequence[Layer]) -> tuple[Level, str]:
    """The level that `auto` means, and why.

    The bed of springs is right for one thin layer, the skin on its core pressed on something rigid. Soft
    objects are thick: their cells answer to each other.

    Args:
        layers: The compliant bodies, the pad's first.
    """
    if len(layers) == 1 and not math.isinf(layers[0].thickness_m):
        return "winkler", "the object is rigid: only the thin skin deforms"
    return "layer", "the object deforms too"


def solve_contact(
    problem: ContactProblem, command: Command, level: Level = "auto", config: ContactConfig = DEFAULT_CONFIG
) -> ContactSolution:
    """Solve one contact at the level asked for.

    Args:
        problem: Surfaces and layers.
        command: A force or a depth.
        level: One of `LEVELS`.
        config: Tolerance and limits.

    Raises:
        ContactError: If there is no such level, or the level refuses the problem.
    """
    if level == "auto":
        level, _ = choose_level(problem.layers)
    solver = _SOLVERS.get(level)
    if solver is None:
        raise ContactError(f"level: {level!r} is none of {', '.join(LEVELS)}")
    return solver(problem, command, config)
