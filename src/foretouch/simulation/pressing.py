# SPDX-License-Identifier: Apache-2.0
"""A scene's words in the contact solver's: surfaces, layers and commands."""

from __future__ import annotations

import numpy as np

from foretouch.simulation.body import Body
from foretouch.simulation.contact import (
    Command,
    ContactFrame,
    ContactProblem,
    Layer,
    PadConfig,
    cell_centres,
    gap_field,
    pad_depth,
)
from foretouch.simulation.hand import FingerFrame
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.types import Float64

__all__ = ["command_of", "contact_problem", "layers_of", "surface_behind"]

_BACK_M = 0.03  # how far in front of the tangent plane the rays start


def layers_of(scene: SceneConfig, item: ObjectConfig) -> tuple[Layer, ...]:
    """What gives way: the pad and, if it is soft, the object."""
    pad = scene.fingers.pad.layer
    if item.young_pa is None or item.thickness_m is None:
        return (pad,)
    return pad, Layer(modulus_pa=item.young_pa, poisson=item.poisson, thickness_m=item.thickness_m)


def command_of(scene: SceneConfig, target: float) -> Command:
    """A finger's target as force or depth."""
    return Command(force_n=target) if scene.grasps.control == "force" else Command(depth_m=target)


def surface_behind(pad: PadConfig, body: Body, frame: FingerFrame) -> Float64:
    """(N, N) float64 [m]: how far behind the tangent plane the body's surface lies, inf where there is none."""
    x, y = cell_centres(pad)
    starts = frame.points(x, y, -_BACK_M).reshape(-1, 3)
    t = body.cast(starts, np.broadcast_to(frame.approach, starts.shape)).t
    return t.reshape(x.shape) - _BACK_M


def contact_problem(scene: SceneConfig, item: ObjectConfig, pad: ContactFrame, behind: Float64) -> ContactProblem:
    """The gap between a pad and the surface behind its tangent plane.

    Raises:
        ContactError: If nowhere in the window do both exist.
    """
    config = scene.fingers.pad
    x, y = cell_centres(config)
    gap = gap_field(pad_depth(config, pad, x, y), -behind)
    return ContactProblem(gap, config.step_m, layers_of(scene, item))
