# SPDX-License-Identifier: Apache-2.0
"""From a scene to contact problems: surfaces, layers and commands for the contact solver."""

import numpy as np

from foretouch.errors import ContactError, ConvergenceError, SimulationError
from foretouch.simulation.body import Body
from foretouch.simulation.contact import Command, ContactProblem, Layer, PadConfig, PadWindow, gap_field
from foretouch.simulation.hand import FingerFrame
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.types import Float64

_BACK_M = 0.03  # how far in front of the tangent plane the rays start


def layers_of(scene: SceneConfig, item: ObjectConfig) -> tuple[Layer, ...]:
    """The elastic layers in contact: the pad and, if it is soft, the object."""
    pad = scene.fingers.pad.layer
    if item.young_pa is None or item.thickness_m is None:
        return (pad,)
    return pad, Layer(modulus_pa=item.young_pa, poisson=item.poisson, thickness_m=item.thickness_m)


def command_of(scene: SceneConfig, target: float) -> Command:
    """A finger's target as force or depth."""
    return Command(force_n=target) if scene.grasps.control == "force" else Command(depth_m=target)


def pad_of(scene: SceneConfig, item: ObjectConfig) -> PadConfig:
    """The pad, its window as wide as the object's softness asks for."""
    return scene.fingers.pad if item.rigid else scene.fingers.pad.soft


def surface_behind(window: PadWindow, body: Body, frame: FingerFrame) -> Float64:
    """(N, N) float64 [m]: how far behind the tangent plane the body's surface lies, inf where there is none."""
    starts = frame.points(window.x, window.y, -_BACK_M).reshape(-1, 3)
    t = body.cast(starts, np.broadcast_to(frame.approach, starts.shape)).t
    return t.reshape(window.x.shape) - _BACK_M


def contact_problem(scene: SceneConfig, item: ObjectConfig, window: PadWindow, behind: Float64) -> ContactProblem:
    """The gap between a pad and the surface behind its tangent plane.

    Raises:
        ContactError: If nowhere in the window do both exist.
    """
    gap = gap_field(window.depth, -behind)
    return ContactProblem(gap, pad_of(scene, item).step_m, layers_of(scene, item))


def contact_failure(message: str, error: ContactError) -> SimulationError:
    """The failure of a sample whose contact cannot be solved, and whether it is the solver that failed."""
    return SimulationError(message, "not_converged" if isinstance(error, ConvergenceError) else "contact")
