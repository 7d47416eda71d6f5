# SPDX-License-Identifier: Apache-2.0
"""Contacts as grasps of rigid things make them: anywhere on the pad, on planes, cylinders and edges, 1 to 5 N."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from foretouch.simulation.contact import (
    ContactProblem,
    Layer,
    PadConfig,
    PadWindow,
    gap_field,
    pad_direction,
    pad_window,
)


def random_contacts(
    n: int, seed: int, pad: PadConfig, other: Layer | None = None
) -> Iterator[tuple[PadWindow, ContactProblem, float]]:
    """Window, problem and force [N] of n contacts; the same for every size and number of cells."""
    rng = np.random.default_rng(seed)
    layers = (pad.layer,) if other is None else (pad.layer, other)
    for _ in range(n):
        pitch, roll = rng.normal(0.0, 0.3), float(np.clip(rng.normal(0.0, 0.35), -1.2, 1.2))
        force, angle, radius = rng.uniform(1.0, 5.0), rng.uniform(0.0, np.pi), rng.uniform(0.02, 0.05)
        beside, kind = rng.normal(0.0, 0.002), rng.integers(3)
        window = pad_window(pad, pad_direction(pitch, roll))
        x, y = window.x, window.y
        if kind == 0:
            height = np.zeros_like(x)
        elif kind == 1:
            height = -((np.cos(angle) * x + np.sin(angle) * y) ** 2) / (2.0 * radius)
        else:  # an edge that falls at 45 degrees, rounded over 2 mm
            across = np.cos(angle) * (x - beside) + np.sin(angle) * y
            height = -(np.clip(across + 0.001, 0.0, 0.002) ** 2 / 0.004 + np.maximum(across - 0.001, 0.0))
        yield window, ContactProblem(gap_field(window.depth, height), pad.step_m, layers), force
