# SPDX-License-Identifier: Apache-2.0
"""How the hand grasps, by GeoGrasp on the simulated cloud; where both pads meet the object, and how hard they press on it."""

import math
from dataclasses import replace

import numpy as np

from foretouch.errors import ContactError, SimulationError
from foretouch.grasp import DEFAULT_HAND, HandConfig, hand_rotation, plan_grasps
from foretouch.grasp.hand import FINGER, THUMB, Hand, load_hand
from foretouch.types import Float64, Grasp
from foretouch_lab.simulation.contact.grip import solve_grip, weigh
from foretouch_lab.simulation.contact.pad import (
    ContactFrame,
    PadConfig,
    PadWindow,
    contact_frame,
    gap_field,
    pad_depth,
    pad_direction,
    pad_window,
)
from foretouch_lab.simulation.contact.problem import Command, ContactProblem, ElasticLayer
from foretouch_lab.simulation.engine import Effect, Job, SampleState
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.fingers import TARGET_SHARE, ExecutionErrorConfig
from foretouch_lab.simulation.scene.objects import POISSON, RELIEF_M, ObjectConfig
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.solids import Body
from foretouch_lab.simulation.world import object_index

_UP = np.array([0.0, 0.0, 1.0])
_BACK_M = 0.03  # how far outside the contact, planned or found, the rays start
_SEARCH_M = 0.02  # side of the square that is searched for first touch: most of the pad
_SEARCH_CELLS = 21
_NEAR_M = 2e-4  # cells whose gap is within this of the least give the surface's mean normal
_WAVES = 12  # that make up a fine relief
_WAVELENGTH_M = 3e-3  # between its crests
_GRAVITY_M_S2 = 9.81


def _plan(job: Job, state: SampleState) -> None:
    grasps, view = job.scene.grasps, job.world.view
    rng, shape = job.rng() if grasps.slide else None, (view.height, view.width)
    hand = HandConfig(name=job.scene.hand, thumb_at="g1") if job.scene.hand else DEFAULT_HAND
    plan = plan_grasps(
        state.cloud, job.world.plane, grasps.geograsp, rng=rng, pixels=state.pixels, image_shape=shape, hand=hand
    )
    if plan.status == "no_grasp":
        raise SimulationError(f"{job.item.name}: {plan.reason}", "no_grasp")
    grasp = plan.grasps[0]
    if grasps.initial_points and plan.initial_points is not None and plan.axis is not None:
        g1, g2 = plan.initial_points
        grasp = Grasp(g1, g2, hand_rotation(g1, g2, plan.axis))
    state.plan, state.grasp = plan, replace(grasp, object_id=job.item.name)


def _fingers(job: Job, state: SampleState) -> None:
    grasp = state.grasp
    world = job.world
    widest = job.scene.grasps.max_width_m
    if grasp.width_m > widest:
        raise SimulationError(
            f"{job.item.name}: a grasp of {grasp.width_m:.3f} m, the hand opens {widest:g} m", "too_wide"
        )
    lower = job.scene.grasps.insertion_m * _UP
    g1, g2 = world.view.to_world(grasp.g1) - lower, world.view.to_world(grasp.g2) - lower
    rotation = world.view.R_world_camera
    state.fingers = _finger_frames(g1, g2, rotation @ grasp.rotation, _UP)
    state.pad_angles = np.zeros((2, 2))
    state.turn = np.eye(3)
    if job.scene.hand:
        approach = -_UP if grasp.way is None else rotation @ grasp.way.approach
        state.fingers, state.pad_angles = _described_frames(load_hand(job.scene.hand), g1, g2, approach)


def _finger_frames(g1: Float64, g2: Float64, hand: Float64, up: Float64) -> tuple[ContactFrame, ContactFrame]:
    """Return thumb at g1 and middle finger at g2, closing towards each other, both pointing down.

    The hand's Y is along the object's axis and Z along g1 - g2, so the fingers lie along its X; which end of X
    they point to is not said by the grasp, and the hand comes from above, against `up`. All in one frame.
    """
    along = hand[:, 0] if hand[:, 0] @ up < 0.0 else -hand[:, 0]
    frames = [
        ContactFrame(origin, np.column_stack([along, np.cross(approach, along), approach]))
        for origin, approach in ((g1, -hand[:, 2]), (g2, hand[:, 2]))
    ]
    return frames[0], frames[1]


def _described_frames(
    hand: Hand, g1: Float64, g2: Float64, approach: Float64
) -> tuple[tuple[ContactFrame, ContactFrame], Float64]:
    """Place the fingertips of a described hand, thumb at g1 and middle finger at g2.

    Args:
        hand: The hand.
        g1: (3,) float64 [m].
        g2: (3,) float64 [m].
        approach: (3,) float64, from the palm to the middle of the contacts; what it has along their line does not count.

    Returns:
        The frame of each, its x the part of the finger's direction across the line of the contacts; and (2, 2) float64, pitch and
        roll of the place of its pad that meets the other contact's line [rad], see `pad_direction`. All in one frame.
    """
    width_m = float(np.linalg.norm(g1 - g2))
    x = (g1 - g2) / width_m
    z = approach - (approach @ x) * x
    z /= np.linalg.norm(z)
    axes = np.column_stack([x, np.cross(z, x), z])
    frames, angles = [], []
    for part, origin, closing in ((THUMB, g1, -x), (FINGER, g2, x)):
        tip = axes @ hand.fingertip(part, width_m)
        ahead, aside, behind = (closing @ tip).tolist()
        across = (tip[:, 0] - ahead * closing) / math.sqrt(1.0 - ahead * ahead)
        frames.append(ContactFrame(origin, np.column_stack([across, np.cross(closing, across), closing])))
        angles.append((math.asin(ahead), math.atan2(aside, -behind)))
    return (frames[0], frames[1]), np.array(angles)


def _execution_error(job: Job, state: SampleState) -> None:
    """Shift and turn both fingers about their middle as one, since they are on one hand, and let them press alike."""
    error: ExecutionErrorConfig = job.settings
    rng = job.rng()
    thumb, middle = state.fingers
    shift = thumb.rotation @ (rng.normal(0.0, error.position_m, 3) * (1.0, 1.0, 0.0))
    turn = _small_rotation(np.radians(rng.normal(0.0, error.angle_deg, 3)))
    centre = (thumb.origin + middle.origin) / 2.0
    state.turn = turn
    state.fingers = tuple(  # type: ignore[assignment]  # two in, two out
        ContactFrame(centre + turn @ (finger.origin - centre) + shift, turn @ finger.rotation)
        for finger in (thumb, middle)
    )
    state.target = state.target * max(0.0, 1.0 + rng.normal(0.0, TARGET_SHARE))


def _small_rotation(vector: Float64) -> Float64:
    """Return the rotation about a vector by its length [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross), np.float64)


def _targets(job: Job, state: SampleState) -> None:
    """Let both fingers aim at one number, since the object passes the force on."""
    grasps = job.scene.grasps
    state.target = draw(job.rng(), grasps.thumb.force_n if grasps.control == "force" else grasps.thumb.depth_m)
    state.axial_load_n, state.tangential_n = 0.0, np.zeros((2, 3))


def _posture(job: Job, state: SampleState) -> None:
    """Turn each fingertip so that the chosen place of its pad looks along the approach; the hand's posture adds to it."""
    fingers = job.scene.fingers
    rng = job.rng()
    array = job.world.array
    postures = []
    chosen = (fingers.thumb_posture, fingers.middle_posture)
    for finger, frame, posture in zip(chosen, state.fingers, state.pad_angles, strict=True):
        drawn = [np.radians(draw(rng, limits)) for limits in (finger.pitch_deg, finger.roll_deg)]
        pitch, roll = drawn + posture
        pad = array.aimed(pitch, roll) if array else contact_frame(fingers.pad, pad_direction(pitch, roll))
        postures.append((pad, frame.rotation @ pad.rotation.T))
    state.postures = postures[0], postures[1]


def _first_touch(job: Job, state: SampleState) -> None:
    """Close each finger along its approach until skin and object meet.

    They meet where their normals are opposite, which on a slope is beside the place that the hand aimed with.
    The contact is solved in the tangent plane there; the contact of an array of taxels in the plane of its middle, over the whole
    pad, which turns towards the surface. A slope outside of the friction cone lets the finger slip.
    """
    pad_config = pad_of(job)
    item = job.item
    array = job.world.array
    offset = np.linspace(-_SEARCH_M / 2.0, _SEARCH_M / 2.0, _SEARCH_CELLS)
    x, y = np.meshgrid(offset, offset)
    met = []
    for finger, (aimed, tip), name in zip(state.fingers, state.postures, ("thumb", "middle finger"), strict=True):
        if array:
            middle = array.middle
            start = ContactFrame(finger.origin + tip @ (middle.origin - aimed.origin), tip @ middle.rotation)
            meeting = _meet(array.window.depth, state.bodies[0], start, array.window.x, array.window.y)
        else:
            meeting = _meet(pad_depth(pad_config, aimed, x, y), state.bodies[0], finger, x, y)
        if meeting is None:
            raise SimulationError(f"{item.name}: the {name} closes beside the object", "misses")
        point, normal, way_m = meeting
        slope = _slope(-float(normal @ finger.normal))
        if slope > item.friction:
            raise SimulationError(
                f"{item.name}: the {name} meets a slope of {slope:.2f}, friction holds {item.friction:g}", "slips"
            )
        if array:
            way = finger.normal * way_m / float(finger.normal @ start.normal)
            touching = ContactFrame(start.origin + way, start.rotation)
            met.append((array.window, array.aligned(touching, point, normal)))
            continue
        try:
            pad = pad_window(pad_config, -normal @ tip)
        except ContactError as err:
            raise SimulationError(f"{item.name}: {name}: {err}", "misses") from err
        met.append((pad, ContactFrame(point, tip @ pad.frame.rotation)))
    state.pads = met[0][0], met[1][0]
    state.touches = met[0][1], met[1][1]


def _slope(cosine: float) -> float:
    """Return the tangent of the angle between approach and surface normal; infinite where the surface turns away."""
    return math.sqrt(max(0.0, 1.0 / cosine**2 - 1.0)) if cosine > 0.0 else math.inf


def _meet(
    depth: Float64, body: Body, finger: ContactFrame, x: Float64, y: Float64
) -> tuple[Float64, Float64, float] | None:
    """First touch of a pad that moves along its approach: the point on the object, the normal about it, and the way there.

    The pad is by its `depth` below the plane of the `finger` at the places `x`, `y`.
    """
    starts = finger.points(x, y, -_BACK_M).reshape(-1, 3)
    hits = body.cast(starts, np.broadcast_to(finger.normal, starts.shape))
    gap = depth.reshape(-1) + hits.t
    least = int(np.argmin(gap))
    if not np.isfinite(gap[least]):
        return None
    normal = body.world_normals(hits.normal[gap < gap[least] + _NEAR_M]).mean(axis=0)
    point = starts[least] + hits.t[least] * finger.normal
    return point, normal / np.linalg.norm(normal), float(gap[least]) - _BACK_M


def pad_of(job: Job) -> PadConfig:
    """Return the pad, its window as wide as an array of taxels, or as the object's softness asks for."""
    if job.world.array:
        return job.world.array.pad
    return job.scene.fingers.pad if job.item.rigid else job.scene.fingers.pad.soft


def surface_behind(window: PadWindow, body: Body, frame: ContactFrame) -> Float64:
    """Return (N, N) float64 [m]: how far behind the tangent plane the body's surface lies, inf without a surface.

    Args:
        window: Places on the tangent plane.
        body: The object.
        frame: The tangent plane, in the world.
    """
    starts = frame.points(window.x, window.y, -_BACK_M).reshape(-1, 3)
    return body.cast(starts, np.broadcast_to(frame.normal, starts.shape)).t.reshape(window.x.shape) - _BACK_M


def _relief(_job: Job, state: SampleState) -> None:
    body = state.bodies[0]
    state.relief = np.stack(
        [surface_behind(window, body, frame) for window, frame in zip(state.pads, state.touches, strict=True)]
    )


def _surface(job: Job, state: SampleState) -> None:
    """Add waves of random directions and phases, fixed to the object: two touches of one spot feel the same relief."""
    body = state.bodies[0]
    rng = np.random.default_rng([job.scene.seed, object_index(job.scene, job.key.slot), body.variant])
    axes = rng.standard_normal((_WAVES, 3))
    axes *= 2.0 * np.pi / _WAVELENGTH_M / np.linalg.norm(axes, axis=1, keepdims=True)
    phase = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    waves = []
    for window, frame in zip(state.pads, state.touches, strict=True):
        points = (frame.points(window.x, window.y, 0.0) - body.position) @ body.rotation
        waves.append(np.cos(points @ axes.T + phase).sum(axis=-1) * RELIEF_M * np.sqrt(2.0 / _WAVES))
    state.relief = state.relief + np.stack(waves)


def _weight(job: Job, state: SampleState) -> None:
    body = state.bodies[0]
    centre = body.position + (body.mesh.centroid * body.size) @ body.rotation.T
    thumb, middle = state.touches
    weight_n = np.array([0.0, 0.0, -(job.item.mass_kg or 0.0) * _GRAVITY_M_S2])
    state.axial_load_n, state.tangential_n = weigh(weight_n, thumb.origin, middle.origin, centre)


def _solve(job: Job, state: SampleState) -> None:
    problems = [contact_problem(job, *each) for each in zip(state.pads, state.relief, strict=True)]
    state.contacts = solve_grip(problems, command_of(job.scene, state.target), state.axial_load_n, job.scene.fidelity)


def _layers_of(scene: SceneConfig, item: ObjectConfig) -> tuple[ElasticLayer, ...]:
    """Return the elastic layers in contact: the pad and, if it is soft, the object."""
    pad = scene.fingers.pad.layer
    if item.young_pa is None or item.thickness_m is None:
        return (pad,)
    return pad, ElasticLayer(modulus_pa=item.young_pa, poisson=POISSON, thickness_m=item.thickness_m)


def command_of(scene: SceneConfig, target: float) -> Command:
    """Return a finger's target as force or depth."""
    return Command(force_n=target) if scene.grasps.control == "force" else Command(depth_m=target)


def contact_problem(job: Job, window: PadWindow, behind: Float64) -> ContactProblem:
    """Return the gap between a pad and the surface behind its tangent plane; a `ContactError` if both exist nowhere."""
    return ContactProblem(gap_field(window.depth, -behind), pad_of(job).step_m, _layers_of(job.scene, job.item))


def _held(job: Job, state: SampleState) -> None:
    """Refuse a grasp out of which the object falls: where a tangential force exceeds Coulomb's limit."""
    across = np.linalg.norm(state.tangential_n, axis=1)
    for finger, tangential_n, contact in zip(("thumb", "middle finger"), across, state.contacts, strict=True):
        if tangential_n > job.item.friction * contact.force_n:
            raise SimulationError(
                f"{job.item.name}: its weight slips through the {finger}, which presses with {contact.force_n:.2f} N",
                "falls",
            )


EFFECTS = (
    Effect("grasp", _plan, "grasps"),
    Effect("fingers", _fingers, "grasps"),
    Effect("targets", _targets, "grasps"),
    Effect("execution_error", _execution_error, "grasps.error", again=True),
    Effect("posture", _posture, "fingers"),
    Effect("first_touch", _first_touch, "fingers"),
    Effect("relief", _relief, "fingers"),
    Effect("surface", _surface, "objects.surface"),
    Effect("weight", _weight, "gravity"),
    Effect("contact", _solve, "fidelity"),
    Effect("held", _held, "gravity"),
)
