# SPDX-License-Identifier: Apache-2.0
"""Where and how hard the hand grasps: GeoGrasp on the simulated cloud, then the error of its execution."""

from dataclasses import replace

import numpy as np

from foretouch.errors import SimulationError
from foretouch.grasp import hand_rotation, plan_grasps
from foretouch.types import Float64, Grasp
from foretouch_lab.simulation.contact.pad import ContactFrame
from foretouch_lab.simulation.effect import Effect, Job, SampleState
from foretouch_lab.simulation.scene.fingers import TARGET_SHARE, ExecutionErrorConfig
from foretouch_lab.simulation.scene.ranges import draw

_UP = np.array([0.0, 0.0, 1.0])


def _plan(job: Job, state: SampleState) -> None:
    grasps, view = job.scene.grasps, job.world.view
    rng, shape = job.rng() if grasps.slide else None, (view.height, view.width)
    plan = plan_grasps(state.cloud, job.world.plane, grasps.geograsp, rng=rng, pixels=state.pixels, image_shape=shape)
    if plan.status == "no_grasp":
        raise SimulationError(f"{job.item.name}: {plan.reason}", "no_grasp")
    grasp = plan.grasps[0]
    if grasps.initial_points and plan.initial_points is not None and plan.axis is not None:
        g1, g2 = plan.initial_points
        grasp = Grasp(g1, g2, hand_rotation(g1, g2, plan.axis))
    state.plan, state.grasp = plan, replace(grasp, object_id=job.item.name)


def _fingers(job: Job, state: SampleState) -> None:
    grasp, world, widest = state.grasp, job.world, job.scene.grasps.max_width_m
    if grasp.width_m > widest:
        raise SimulationError(
            f"{job.item.name}: a grasp of {grasp.width_m:.3f} m, the hand opens {widest:g} m", "too_wide"
        )
    lower = job.scene.grasps.insertion_m * _UP
    g1, g2 = world.view.to_world(grasp.g1) - lower, world.view.to_world(grasp.g2) - lower
    state.fingers = _finger_frames(g1, g2, world.view.R_world_camera @ grasp.rotation, _UP)


def _finger_frames(g1: Float64, g2: Float64, hand: Float64, up: Float64) -> tuple[ContactFrame, ContactFrame]:
    """Thumb at g1 and middle finger at g2, closing towards each other, both pointing down.

    The hand's Y is along the object's axis and Z along g1 - g2, so the fingers lie along its X; which end of X
    they point to is not said by the grasp, and the hand comes from above, against `up`. All in one frame.
    """
    along = hand[:, 0] if hand[:, 0] @ up < 0.0 else -hand[:, 0]
    frames = [
        ContactFrame(origin, np.column_stack([along, np.cross(approach, along), approach]))
        for origin, approach in ((g1, -hand[:, 2]), (g2, hand[:, 2]))
    ]
    return frames[0], frames[1]


def _execution_error(job: Job, state: SampleState) -> None:
    """Both fingers are on one hand, so they are shifted and turned about their middle as one, and press alike."""
    error: ExecutionErrorConfig = job.settings
    rng = job.rng()
    thumb, middle = state.fingers
    shift = thumb.rotation @ (rng.normal(0.0, error.position_m, 3) * (1.0, 1.0, 0.0))
    turn = _small_rotation(np.radians(rng.normal(0.0, error.angle_deg, 3)))
    centre = (thumb.origin + middle.origin) / 2.0
    state.fingers = tuple(  # type: ignore[assignment]  # two in, two out
        ContactFrame(centre + turn @ (finger.origin - centre) + shift, turn @ finger.rotation)
        for finger in (thumb, middle)
    )
    state.targets = state.targets * max(0.0, 1.0 + rng.normal(0.0, TARGET_SHARE))


def _small_rotation(vector: Float64) -> Float64:
    """Rotation about a vector by its length [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross), np.float64)


def _targets(job: Job, state: SampleState) -> None:
    """In a balanced grip both fingers aim at one number, since the object passes the force on."""
    grasps, rng = job.scene.grasps, job.rng()
    name = "force_n" if grasps.control == "force" else "depth_m"
    fingers = [grasps.thumb] if grasps.middle is None else [grasps.thumb, grasps.middle]
    drawn = [draw(rng, getattr(finger, name)) for finger in fingers]
    state.targets = np.array([drawn[0], drawn[-1]])
    state.axial_load_n, state.tangential_n = 0.0, np.zeros((2, 3))


EFFECTS = (
    Effect("grasp", _plan, "grasps", reads=("cloud", "pixels"), writes=("plan", "grasp")),
    Effect("fingers", _fingers, "grasps", reads=("grasp",), writes=("fingers",)),
    Effect("targets", _targets, "grasps", writes=("targets", "axial_load_n", "tangential_n")),
    Effect("execution_error", _execution_error, "grasps.error", changes=("fingers", "targets"), again=True),
)
