# SPDX-License-Identifier: Apache-2.0
"""Frames of both fingertips when the hand closes, and the contact problems (surfaces, layers, commands) that follow."""

import numpy as np

from foretouch.simulation.contact import Command, ContactFrame, ContactProblem, Layer, PadConfig, PadWindow, gap_field
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.simulation.scene.objects import POISSON
from foretouch.simulation.solids import Body
from foretouch.types import Float64


def finger_frames(g1: Float64, g2: Float64, hand: Float64, up: Float64) -> tuple[ContactFrame, ContactFrame]:
    """Thumb at g1 and middle finger at g2, closing towards each other, both pointing down.

    The hand's Y is along the object's axis and Z along g1 - g2, so the fingers lie along its X; which end of X
    they point to is not said by the grasp, and the hand comes from above.

    Args:
        g1: (3,) float64 [m].
        g2: (3,) float64 [m].
        hand: (3, 3) float64, the grasp's rotation in the frame of the points.
        up: (3,) float64, the table's normal in that frame.
    """
    along = hand[:, 0] if hand[:, 0] @ up < 0.0 else -hand[:, 0]
    frames = [
        ContactFrame(origin, np.column_stack([along, np.cross(approach, along), approach]))
        for origin, approach in ((g1, -hand[:, 2]), (g2, hand[:, 2]))
    ]
    return frames[0], frames[1]


_BACK_M = 0.03  # how far in front of the tangent plane the rays start


def layers_of(scene: SceneConfig, item: ObjectConfig) -> tuple[Layer, ...]:
    """The elastic layers in contact: the pad and, if it is soft, the object."""
    pad = scene.fingers.pad.layer
    if item.young_pa is None or item.thickness_m is None:
        return (pad,)
    return pad, Layer(modulus_pa=item.young_pa, poisson=POISSON, thickness_m=item.thickness_m)


def command_of(scene: SceneConfig, target: float) -> Command:
    """A finger's target as force or depth."""
    return Command(force_n=target) if scene.grasps.control == "force" else Command(depth_m=target)


def pad_of(scene: SceneConfig, item: ObjectConfig) -> PadConfig:
    """The pad, its window as wide as the object's softness asks for."""
    return scene.fingers.pad if item.rigid else scene.fingers.pad.soft


def surface_behind(window: PadWindow, body: Body, frame: ContactFrame) -> Float64:
    """(N, N) float64 [m]: how far behind the tangent plane the body's surface lies, inf where there is none."""
    starts = frame.points(window.x, window.y, -_BACK_M).reshape(-1, 3)
    t = body.cast(starts, np.broadcast_to(frame.normal, starts.shape)).t
    return t.reshape(window.x.shape) - _BACK_M


def contact_problem(scene: SceneConfig, item: ObjectConfig, window: PadWindow, behind: Float64) -> ContactProblem:
    """The gap between a pad and the surface behind its tangent plane.

    Raises:
        ContactError: If nowhere in the window do both exist.
    """
    gap = gap_field(window.depth, -behind)
    return ContactProblem(gap, pad_of(scene, item).step_m, layers_of(scene, item))
