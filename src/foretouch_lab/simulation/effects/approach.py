# SPDX-License-Identifier: Apache-2.0
"""Close both fingers until they touch the object: where each pad meets it, and the object's surface around that point."""

import math

import numpy as np

from foretouch.errors import ContactError, SimulationError
from foretouch.types import Float64
from foretouch_lab.simulation.campaign import object_index
from foretouch_lab.simulation.contact.pad import (
    ContactFrame,
    PadConfig,
    PadWindow,
    contact_frame,
    pad_depth,
    pad_direction,
    pad_window,
)
from foretouch_lab.simulation.effect import Effect, Job, SampleState
from foretouch_lab.simulation.scene.objects import SurfaceConfig
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.solids import Body

_BACK_M = 0.03  # how far outside the contact, planned or found, the rays start
_SEARCH_M = 0.02  # side of the square that is searched for first touch: most of the pad
_SEARCH_CELLS = 21
_NEAR_M = 2e-4  # cells whose gap is within this of the least give the surface's mean normal
_WAVES = 12  # that make up a fine relief
_WAVELENGTH_M = 3e-3  # between its crests


def _posture(job: Job, state: SampleState) -> None:
    """The orientation of each fingertip: the chosen place of its pad looks along the approach."""
    fingers, rng, array = job.scene.fingers, job.rng(), job.world.array
    postures = []
    for finger, frame in zip((fingers.thumb_posture, fingers.middle_posture), state.fingers, strict=True):
        pitch, roll = (np.radians(draw(rng, limits)) for limits in (finger.pitch_deg, finger.roll_deg))
        pad = array.aimed(pitch, roll) if array else contact_frame(fingers.pad, pad_direction(pitch, roll))
        postures.append((pad, frame.rotation @ pad.rotation.T))
    state.postures = postures[0], postures[1]


def _first_touch(job: Job, state: SampleState) -> None:
    """Close each finger along its approach until skin and object meet.

    They meet where their normals are opposite, which on a slope is beside the place that the hand aimed with.
    The contact is solved in the tangent plane there; that of an array of taxels in the plane of its middle, over the whole
    pad, which turns towards the surface. A slope outside of the friction cone lets the finger slip.
    """
    pad_config, item, array = pad_of(job), job.item, job.world.array
    offset = np.linspace(-_SEARCH_M / 2.0, _SEARCH_M / 2.0, _SEARCH_CELLS)
    x, y = np.meshgrid(offset, offset)
    met = []
    for finger, (aimed, tip), name in zip(state.fingers, state.postures, ("thumb", "middle finger"), strict=True):
        if array:
            middle = array.middle
            start = ContactFrame(finger.origin + tip @ (middle.origin - aimed.origin), tip @ middle.rotation)
            found = _meet(array.window.depth, state.bodies[0], start, array.window.x, array.window.y)
        else:
            found = _meet(pad_depth(pad_config, aimed, x, y), state.bodies[0], finger, x, y)
        if found is None:
            raise SimulationError(f"{item.name}: the {name} closes beside the object", "misses")
        point, normal, way_m = found
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
    """Tangent of the angle between approach and surface normal; infinite where the surface turns away."""
    return math.sqrt(1.0 / cosine**2 - 1.0) if 0.0 < cosine < 1.0 else (math.inf if cosine <= 0.0 else 0.0)


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
    """The pad, its window as wide as an array of taxels, or as the object's softness asks for."""
    if job.world.array:
        return job.world.array.pad
    return job.scene.fingers.pad if job.item.rigid else job.scene.fingers.pad.soft


def surface_behind(window: PadWindow, body: Body, frame: ContactFrame) -> Float64:
    """(N, N) float64 [m]: how far behind the tangent plane the body's surface lies, inf where there is none."""
    starts = frame.points(window.x, window.y, -_BACK_M).reshape(-1, 3)
    return body.cast(starts, np.broadcast_to(frame.normal, starts.shape)).t.reshape(window.x.shape) - _BACK_M


def _relief(_job: Job, state: SampleState) -> None:
    body = state.bodies[0]
    state.relief = np.stack(
        [surface_behind(window, body, frame) for window, frame in zip(state.pads, state.touches, strict=True)]
    )


def _surface(job: Job, state: SampleState) -> None:
    """Waves of random directions and phases, fixed to the object: two touches of one spot feel the same relief."""
    surface: SurfaceConfig = job.settings
    body = state.bodies[0]
    rng = np.random.default_rng([job.scene.seed, object_index(job.scene, job.key.slot), body.variant])
    axes = rng.standard_normal((_WAVES, 3))
    axes *= 2.0 * np.pi / _WAVELENGTH_M / np.linalg.norm(axes, axis=1, keepdims=True)
    phase = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    waves = []
    for window, frame in zip(state.pads, state.touches, strict=True):
        points = (frame.points(window.x, window.y, 0.0) - body.position) @ body.rotation
        waves.append(np.cos(points @ axes.T + phase).sum(axis=-1) * surface.relief_m * np.sqrt(2.0 / _WAVES))
    state.relief = state.relief + np.stack(waves)


EFFECTS = (
    Effect("posture", _posture, "fingers", reads=("fingers",), writes=("postures",)),
    Effect("first_touch", _first_touch, "fingers", reads=("bodies", "fingers", "postures"), writes=("pads", "touches")),
    Effect("relief", _relief, "fingers", reads=("bodies", "pads", "touches"), writes=("relief",)),
    Effect("surface", _surface, "objects.surface", reads=("bodies", "pads", "touches"), changes=("relief",)),
)
