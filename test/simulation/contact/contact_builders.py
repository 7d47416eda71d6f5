# SPDX-License-Identifier: Apache-2.0
"""Gaps with a known answer."""

import numpy as np

from foretouch.simulation.contact import ContactProblem, Layer

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
    return Layer(modulus_pa=modulus_pa, poisson=poisson)


def skin(thickness_m=0.0015):
    return Layer(modulus_pa=1.552e6, poisson=0.316, thickness_m=thickness_m)
