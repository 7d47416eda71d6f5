# SPDX-License-Identifier: Apache-2.0
"""A family of shapes that no catalogue holds, for learning to generalise: superquadrics, vases and blobs."""

from __future__ import annotations

import numpy as np

from foretouch.simulation.objects.mesh import TriangleMesh
from foretouch.simulation.objects.surfaces import revolved, star_shaped
from foretouch.types import Float64

__all__ = ["random_shape"]

_HARMONICS = 6  # waves of a blob


def random_shape(rng: np.random.Generator) -> TriangleMesh:
    """One member, of roughly unit size; all is drawn from `rng`."""
    kind = rng.integers(3)
    return (_superquadric, _vase, _blob)[kind](rng)


def _superquadric(rng: np.random.Generator) -> TriangleMesh:
    """Between box, cylinder and ellipsoid: (|x|^p + |y|^p)^(q/p) + |z|^q = 1, p and q from 2 to 8."""
    p, q = rng.uniform(2.0, 8.0, 2)
    stretch = rng.uniform(0.6, 1.0, 3)

    def radius(d: Float64) -> Float64:
        x, y, z = np.abs(d / stretch).T
        return np.asarray(((x**p + y**p) ** (q / p) + z**q) ** (-1.0 / q), np.float64)

    return star_shaped(radius)


def _vase(rng: np.random.Generator) -> TriangleMesh:
    """A turned profile with bellies and necks, at least 25 mm where the box is 100 mm."""
    height = np.linspace(0.0, 1.0, 48)
    waves = sum(rng.normal(0.0, 0.22 / k) * np.cos(np.pi * k * height + rng.uniform(0.0, 6.28)) for k in range(1, 5))
    radius = np.clip(0.4 + waves, 0.18, 0.75)
    rim = 0.04 * np.sqrt(np.linspace(0.0, 1.0, 8)[1:])  # rounds the two ends off
    radius[:7] *= 0.92 + 2.0 * rim
    radius[-7:] *= (0.92 + 2.0 * rim)[::-1]
    ring = np.stack([radius, height], axis=1)
    return revolved(np.concatenate([[(0.0, 0.0)], ring, [(0.0, 1.0)]]))


def _blob(rng: np.random.Generator) -> TriangleMesh:
    """A ball with smooth waves in random directions."""
    axes = rng.standard_normal((_HARMONICS, 3))
    axes *= (rng.uniform(1.0, 4.0, _HARMONICS) / np.linalg.norm(axes, axis=1))[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, _HARMONICS)
    height = rng.uniform(0.02, 0.14, _HARMONICS)
    stretch = rng.uniform(0.6, 1.0, 3)

    def radius(d: Float64) -> Float64:
        ellipsoid = 1.0 / np.linalg.norm(d / stretch, axis=1)
        return np.asarray(ellipsoid * (1.0 + np.sin(d @ axes.T + phase) @ height), np.float64)

    return star_shaped(radius)
