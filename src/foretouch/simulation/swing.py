# SPDX-License-Identifier: Apache-2.0
"""A scene in motion, for cameras that should not see the same image twice in a row."""

from __future__ import annotations

import numpy as np

from foretouch.simulation.depth_scene import DepthImage, DepthScene

__all__ = ["swinging"]

_REACH_M = 0.015  # half the free table that random scenes leave between objects, so that nothing collides


def swinging(
    scene: DepthScene, count: int, *, rng: np.random.Generator | None = None, noise_m: float = 0.0
) -> list[DepthImage]:
    """Frames of one period in which the first object swings to and fro along x.

    Args:
        scene: At rest; without objects all frames show the same.
        count: How many frames make the period.
        rng: Of the noise; may be None without.
        noise_m: As for `DepthScene.render` [m].
    """
    images = []
    for phase in 2.0 * np.pi * np.arange(count) / count:
        offset = np.array([_REACH_M * np.sin(phase), 0.0, 0.0])
        images.append((scene.moved(0, offset) if scene.objects else scene).render(rng, noise_m))
    return images
