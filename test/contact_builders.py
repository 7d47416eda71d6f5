# SPDX-License-Identifier: Apache-2.0
"""Gaps with a known answer, and pads pressed on surfaces."""

import numpy as np

from foretouch_lab.simulation.contact.grip import solve_contact
from foretouch_lab.simulation.contact.pad import gap_field, pad_direction, pad_window
from foretouch_lab.simulation.contact.problem import Command, ContactProblem, ElasticLayer

RADIUS = 0.01


def grid(n, side):
    step = side / n
    offset = (np.arange(n) - (n - 1) / 2) * step
    return *np.meshgrid(offset, offset), step


def paraboloid(n, side, *layers, radius=RADIUS, ratio=1.0):
    """x² / 2R + ratio y² / 2R; the grid's centre may lie between cells, so that the least gap is made 0."""
    x, y, step = grid(n, side)
    gap = (x**2 + ratio * y**2) / (2 * radius)
    return ContactProblem(gap - gap.min(), step, layers or (half_space(),))


def half_space(modulus_pa=1e6, poisson=0.3):
    return ElasticLayer(modulus_pa=modulus_pa, poisson=poisson)


def skin(thickness_m=0.0015):
    return ElasticLayer(modulus_pa=1.552e6, poisson=0.316, thickness_m=thickness_m)


def rounded_edge(across):
    """Height of a plane that falls off at 45 degrees, rounded over 2 mm."""
    return -(np.clip(across + 0.001, 0.0, 0.002) ** 2) / 0.004 - np.maximum(across - 0.001, 0.0)


def press(pad, place, force, surface=lambda x, _y: np.zeros_like(x), other=(), level="auto"):
    """Window and solution of a pad that is pressed at (pitch, roll) on a surface z(x, y), by default a plane."""
    window = pad_window(pad, pad_direction(*place))
    gap = gap_field(window.depth, surface(window.x, window.y))
    problem = ContactProblem(gap, pad.step_m, (pad.layer, *other))
    return window, solve_contact(problem, Command(force_n=force), level)
