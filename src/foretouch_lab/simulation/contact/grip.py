# SPDX-License-Identifier: Apache-2.0
"""Two fingers on opposite sides of one object, how they share its weight, and the choice of the contact level.

Statics of a rigid body on two points: with a the unit vector from g1 to g2, L their distance, w the weight (a force
vector) and c the centre of mass, the forces of the fingers on the object balance w, and their moments balance (c - m) x
w about the midpoint m:

    along a:    F1 - F2 + w·a = 0, hence the second finger carries w·a more than the first;
    across a:   T1 + T2 = -w_t and (L/2) a x (T2 - T1) = -[(c - m) x w]_t, the rule of the lever and the
                couple of an object that hangs beside the line;
    about a:    a·((c - m) x w) is left to the torsional friction of the pads.

The object hangs freely between the fingers: it moves along the line of the contacts until the pushes cancel, up to the
share of its weight that lies along that line. Commanded by depth, the sum of both depths is the hand's closing, and the
common force is solved for; the balance is then exact and the closing holds to `_CLOSING_TOLERANCE`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from foretouch.errors import ContactError, ConvergenceError
from foretouch.types import Float64
from foretouch_lab.simulation.contact.layer import solve_layer
from foretouch_lab.simulation.contact.problem import Command, ContactProblem, ContactSolution, no_contact, solve_winkler

_SOLVERS: Final[dict[str, Callable[[ContactProblem, Command], ContactSolution]]] = {
    "winkler": solve_winkler,
    "layer": solve_layer,
}
LEVELS: Final = tuple(_SOLVERS)

Grip = tuple[ContactSolution, ContactSolution]  # contacts of the finger at g1 and of the one at g2


def solve_contact(problem: ContactProblem, command: Command, level: str = "auto") -> ContactSolution:
    """Solve one contact at `auto` or one of `LEVELS`.

    The bed of springs is right for one thin layer, the skin on its core pressed on something rigid. Soft objects are thick:
    their cells influence each other.

    Args:
        problem: The two surfaces.
        command: Force or depth.
        level: `auto` or one of `LEVELS`.

    Raises:
        ContactError: If the level refuses the problem.
    """
    if level == "auto":
        level = "winkler" if len(problem.layers) == 1 else "layer"
    return _SOLVERS[level](problem, command)


def weigh(weight_n: Float64, g1: Float64, g2: Float64, centre: Float64) -> tuple[float, Float64]:
    """Share the weight of an object between two contacts.

    Args:
        weight_n: (3,) float64, the weight as a vector, downwards [N].
        g1: (3,) float64, first contact [m], the same frame.
        g2: (3,) float64, second contact [m].
        centre: (3,) float64, centre of mass [m].

    Returns:
        How much more the second finger pushes than the first [N], and (2, 3) forces of the weight on both fingers across
        the line of the contacts [N].
    """
    span = g2 - g1
    length = float(np.linalg.norm(span))
    axis = span / length
    moment = np.cross(centre - (g1 + g2) / 2.0, weight_n)
    across = weight_n - (weight_n @ axis) * axis
    # a x D = -M_t / (L/2) has the solution D = -(M_t x a) / (L/2) across a, as (M x a) crossed by a gives M_t back.
    couple = -np.cross(moment, axis) / (length / 2.0)
    return float(weight_n @ axis), np.stack([(across + couple) / 2.0, (across - couple) / 2.0])


_CLOSING_TOLERANCE = 1e-5
_MAX_STEPS = 40
_STEEPEST = 64.0  # largest factor on the force in one step


def solve_grip(problems: Sequence[ContactProblem], command: Command, load_n: float, level: str = "auto") -> Grip:
    """Close both fingers on the object, which is free to move along the line of the contacts.

    Args:
        problems: Of the finger at g1 and of the one at g2.
        command: Of both; of a depth, each finger closes by it.
        load_n: How much of the object's weight the second finger carries more than the first (`weigh`) [N]. Half is
            taken from the first, half added to the second.
        level: Of the contact.

    Raises:
        ContactError: If the load opens a finger, or a contact cannot be solved.
    """
    if command.depth_m is not None:
        return _at_closing(problems, 2.0 * command.depth_m, load_n, level)
    return _at_force(problems, float(command.force_n or 0.0), load_n, level)


def _at_force(problems: Sequence[ContactProblem], force: float, load: float, level: str) -> Grip:
    pushes = (force - load / 2.0, force + load / 2.0)
    if min(pushes) < 0.0:
        raise ContactError(f"axial_load_n: {load:g} N opens a grip of {force:g} N")
    first, second = (solve_contact(p, Command(force_n=n), level) for p, n in zip(problems, pushes, strict=True))
    return first, second


def _at_closing(problems: Sequence[ContactProblem], closing: float, load: float, level: str) -> Grip:
    """Find the common force whose two depths add up to `closing`.

    The depth grows as a power of the force, between F (flat) and √F, so that steps are taken on log F with
    the power of the last two tries, inside a bracket that they tighten.
    """
    half = Command(depth_m=closing / 2.0)
    if half.idle:
        return no_contact(problems[0]), no_contact(problems[1])
    floor = abs(load) / 2.0
    force = max(solve_contact(problems[0], half, level).force_n, floor * 1.01)
    low = floor
    high = math.inf
    power = 0.6
    last = None
    for _ in range(_MAX_STEPS):
        grip = _at_force(problems, force, load, level)
        reached = grip[0].depth_m + grip[1].depth_m
        error = math.log(reached / closing)
        if abs(error) < _CLOSING_TOLERANCE:
            return grip
        low, high = (force, high) if error < 0.0 else (low, force)
        if last is not None and force != last[0]:
            slope = (error - last[1]) / math.log(force / last[0])
            power = min(max(slope, 0.1), 2.0) if math.isfinite(slope) else power
        last = (force, error)
        force *= math.exp(min(max(-error / power, -math.log(_STEEPEST)), math.log(_STEEPEST)))
        if not low < force < high:
            force = (low + high) / 2.0 if math.isfinite(high) else 2.0 * low
    raise ConvergenceError(
        f"grip: a closing of {closing:g} m is not met after {_MAX_STEPS} forces, the last {force:g} N at {reached:g} m"
    )
