# SPDX-License-Identifier: Apache-2.0
"""Put the object on the table, and clutter around it."""

from dataclasses import replace

import numpy as np

from foretouch.errors import SimulationError
from foretouch.types import Float64
from foretouch_lab.simulation.effect import Effect, Job, SampleState
from foretouch_lab.simulation.scene.objects import ClutterConfig, ObjectConfig
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.solids import LYING, Body, about_z, footprint_m

_PLACES = 100  # tried for one piece of clutter
_GAP_M = 0.01  # free table between two bodies
_RUN_UP_M = 2.0  # from where a body is slid against others
_SIZE_M = (0.04, 0.12)  # edge of the cube about a piece of clutter
_VARIANTS = 16  # members of the family of random shapes that are clutter


def _object(job: Job, state: SampleState) -> None:
    rng = job.rng()
    item = job.item
    turn = job.key.slot // len(job.scene.objects)
    size = np.asarray(item.size_m) * (1.0 + item.size_spread * rng.uniform(-1.0, 1.0))
    rotation = _resting(item, rng)
    place = np.array([draw(rng, item.pose.x_m), draw(rng, item.pose.y_m), 0.0])
    state.bodies = [_stood(Body(item.solid, item.first_variant + turn % item.variants, size, place, rotation))]


def _clutter(job: Job, state: SampleState) -> None:
    clutter: ClutterConfig = job.settings
    rng = job.rng()
    bodies = list(state.bodies)
    for _ in range(clutter.count):
        size = np.full(3, draw(rng, _SIZE_M))
        body = Body("random", int(rng.integers(_VARIANTS)), size, np.zeros(3), about_z(rng.uniform(0.0, 2.0 * np.pi)))
        if clutter.touching is None:
            bodies.append(_stood(_beside(bodies, body, clutter.distance_m, rng)))
        else:
            bodies.append(_against(bodies, _stood(body), rng))
    state.bodies = bodies


def _resting(item: ObjectConfig, rng: np.random.Generator) -> Float64:
    yaw = about_z(np.radians(draw(rng, item.pose.yaw_deg)))
    if item.pose.rest == "upright":
        return yaw
    if item.pose.rest == "side":
        return np.asarray(yaw @ LYING @ about_z(rng.integers(4) * np.pi / 2.0), np.float64)
    q = rng.standard_normal(4)
    w, x, y, z = q / np.linalg.norm(q)  # a uniform rotation (Shoemake 1992)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _stood(body: Body) -> Body:
    """The body, its lowest point on the table."""
    return replace(body, position=body.position - (0.0, 0.0, body.lowest()))


def _beside(bodies: list[Body], body: Body, distance_m: tuple[float, ...], rng: np.random.Generator) -> Body:
    """The body at a random place around the object, apart from all others."""
    for _ in range(_PLACES):
        angle, distance = rng.uniform(0.0, 2.0 * np.pi), draw(rng, distance_m)
        place = bodies[0].position * (1.0, 1.0, 0.0) + distance * np.array([np.cos(angle), np.sin(angle), 0.0])
        apart = [np.linalg.norm((other.position - place)[:2]) - footprint_m(other) for other in bodies]
        if min(apart) > footprint_m(body) + _GAP_M:
            return replace(body, position=place)
    raise SimulationError(f"clutter: a body of {body.size[0]:.3f} m finds no place in {_PLACES} tries", "no_place")


def _against(bodies: list[Body], body: Body, rng: np.random.Generator) -> Body:
    """The body, on the table, slid from a random side towards one of the others until it touches any of them."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    towards = np.array([np.cos(angle), np.sin(angle), 0.0])
    aim = bodies[rng.integers(len(bodies))].position * (1.0, 1.0, 0.0)
    start = replace(body, position=body.position + aim - _RUN_UP_M * towards)
    free = min(_free_path(start, other, towards) for other in bodies)
    if not np.isfinite(free):
        raise SimulationError(f"clutter: a body of {body.size[0]:.3f} m meets no other one", "no_place")
    return replace(start, position=start.position + free * towards)


def _free_path(body: Body, other: Body, towards: Float64) -> float:
    """How far a body can move along a unit vector (3,) until it touches another [m]: vertices of one on faces of the other."""
    mine, theirs = (one.position + (one.mesh.vertices * one.size) @ one.rotation.T for one in (body, other))
    ahead = other.cast(mine, np.broadcast_to(towards, mine.shape)).t
    back = body.cast(theirs, np.broadcast_to(-towards, theirs.shape)).t
    return float(min(ahead.min(), back.min()))


EFFECTS = (
    Effect("object", _object, "objects", writes=("bodies",)),
    Effect("clutter", _clutter, "clutter", changes=("bodies",)),
)
