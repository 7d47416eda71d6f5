# SPDX-License-Identifier: Apache-2.0
"""What the camera sees: the object on the table and clutter around it, by exact ray casting, then the faults of a stereo camera."""

from dataclasses import replace

import numpy as np

from foretouch.cloud.segmentation.segment import segment
from foretouch.errors import SimulationError
from foretouch.types import Cloud, Float64
from foretouch_lab.simulation import depth_scene
from foretouch_lab.simulation.engine import Effect, Job, SampleState
from foretouch_lab.simulation.scene.objects import ClutterConfig, ObjectConfig
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.scene.scene import DepthNoiseConfig
from foretouch_lab.simulation.solids import LYING, Body, Hits, about_z, footprint_m
from foretouch_lab.simulation.world import CAMERA_FRAME

_PLACES = 100  # tried for one piece of clutter
_GAP_M = 0.01  # free table between two bodies
_RUN_UP_M = 2.0  # from where a body is slid against others
_SIZE_M = (0.04, 0.12)  # edge of the cube about a piece of clutter
_MARGIN_PX = 16  # around the object: room for flying pixels, the shadow of a neighbour and the matching window
_SPOT_PX = 3  # side of a hole
_FEWEST_POINTS = 100  # fewer are no view of an object
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
    """Return the body with its lowest point on the table."""
    return replace(body, position=body.position - (0.0, 0.0, body.lowest()))


def _beside(bodies: list[Body], body: Body, distance_m: tuple[float, ...], rng: np.random.Generator) -> Body:
    """Return the body at a random place around the object, apart from all others."""
    for _ in range(_PLACES):
        angle, distance = rng.uniform(0.0, 2.0 * np.pi), draw(rng, distance_m)
        place = bodies[0].position * (1.0, 1.0, 0.0) + distance * np.array([np.cos(angle), np.sin(angle), 0.0])
        apart = [np.linalg.norm((other.position - place)[:2]) - footprint_m(other) for other in bodies]
        if min(apart) > footprint_m(body) + _GAP_M:
            return replace(body, position=place)
    raise SimulationError(f"clutter: a body of {body.size[0]:.3f} m finds no place in {_PLACES} tries", "no_place")


def _against(bodies: list[Body], body: Body, rng: np.random.Generator) -> Body:
    """Return the body, on the table, slid from a random side towards one of the others until it touches any of them."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    towards = np.array([np.cos(angle), np.sin(angle), 0.0])
    aim = bodies[rng.integers(len(bodies))].position * (1.0, 1.0, 0.0)
    start = replace(body, position=body.position + aim - _RUN_UP_M * towards)
    free = min(_free_path(start, other, towards) for other in bodies)
    if not np.isfinite(free):
        raise SimulationError(f"clutter: a body of {body.size[0]:.3f} m meets no other one", "no_place")
    return replace(start, position=start.position + free * towards)


def _free_path(body: Body, other: Body, towards: Float64) -> float:
    """Return how far a body can move along a unit vector (3,) until it touches another [m]: vertices of one on faces of the other."""
    mine, theirs = (solid.position + (solid.mesh.vertices * solid.size) @ solid.rotation.T for solid in (body, other))
    ahead = other.cast(mine, np.broadcast_to(towards, mine.shape)).t
    back = body.cast(theirs, np.broadcast_to(-towards, theirs.shape)).t
    return float(min(ahead.min(), back.min()))


def _object_window(job: Job, state: SampleState) -> None:
    view = job.world.view
    if job.scene.camera.segmented is not None:
        _whole_window(job, state)  # segmentation needs the table
        return
    rows, columns = view.window(state.bodies[0].corners())
    if rows.start >= rows.stop or columns.start >= columns.stop:
        raise SimulationError(f"{job.item.name}: lies outside of the view", "outside_view")
    state.window = _grown(rows, view.height), _grown(columns, view.width)


def _whole_window(job: Job, state: SampleState) -> None:
    state.window = slice(0, job.world.view.height), slice(0, job.world.view.width)


def _render(job: Job, state: SampleState) -> None:
    world, window = job.world, state.window
    rays = world.rays[window]
    depth = depth_scene.table_depth(world.view, rays)
    labels = np.where(np.isfinite(depth), depth_scene.TABLE, 0).astype(np.int32)
    flat_rays = rays.reshape(-1, 3)
    flat_depth = depth.reshape(-1)
    flat_labels = labels.reshape(-1)
    hits: list[Hits | None] = []
    for label, body in enumerate(state.bodies, depth_scene.FIRST_OBJECT):
        if not _overlap(world.view, body.corners(), window):
            hits.append(None)
            continue
        hit = body.cast(world.view.eye, flat_rays)
        nearer = hit.t < flat_depth
        flat_depth[nearer] = hit.t[nearer]
        flat_labels[nearer] = label
        hits.append(hit)
    state.exact_depth = depth
    state.labels = labels
    state.hits = hits
    state.depth = depth.copy()


def normals_of(state: SampleState) -> Float64:
    """Return (h, w, 3), outward unit normals in the world; zero where no body is."""
    normals = np.zeros((*state.labels.shape, 3))
    flat, labels = normals.reshape(-1, 3), state.labels.reshape(-1)
    for label, (body, hit) in enumerate(zip(state.bodies, state.hits, strict=True), depth_scene.FIRST_OBJECT):
        if hit is not None:
            seen = labels == label
            flat[seen] = body.world_normals(hit.normal[seen])
    return normals


def _flying_pixels(job: Job, state: SampleState) -> None:
    rng = job.rng()
    flown = depth_scene.add_flying_pixels(state.depth, rng)
    state.depth = np.where(rng.random(flown.shape) < depth_scene.FLYING_SHARE, flown, state.depth)


def _noise(job: Job, state: SampleState) -> None:
    config: DepthNoiseConfig = job.settings
    at_1_m = config.sub_pixel / (job.world.view.matrix[0, 0] * depth_scene.D415_BASELINE_M)  # sigma_z = s z² / (f B)
    state.depth = depth_scene.add_stereo_noise(state.depth, at_1_m, job.rng())


def _shadow(job: Job, state: SampleState) -> None:
    state.depth = np.where(
        depth_scene.stereo_shadow(state.exact_depth, job.world.view.matrix[0, 0]), np.inf, state.depth
    )


def _holes(job: Job, state: SampleState) -> None:
    from scipy.ndimage import uniform_filter

    # A spot is where the mean of white noise over its window is in the upper tail, which has the share asked for.
    spots = uniform_filter(job.rng().random(state.depth.shape), _SPOT_PX, mode="wrap")
    hole = spots > np.quantile(spots, 1.0 - depth_scene.HOLE_SHARE)
    rays = job.world.rays[state.window]
    facing = -np.einsum("ijk,ijk->ij", rays, normals_of(state)) / np.linalg.norm(rays, axis=2)
    hole |= (state.labels >= depth_scene.FIRST_OBJECT) & (facing < np.cos(np.radians(depth_scene.GRAZING_DEG)))
    state.depth = np.where(hole, np.inf, state.depth)


def _quantise(job: Job, state: SampleState) -> None:
    state.depth = np.rint(state.depth / job.settings) * job.settings


def _cloud(job: Job, state: SampleState) -> None:
    """Take the points of the object by the labels of the ray caster."""
    view = job.world.view
    rows, columns = state.window
    v, u = np.nonzero((state.labels == depth_scene.FIRST_OBJECT) & np.isfinite(state.depth))
    if len(u) < _FEWEST_POINTS:
        raise SimulationError(
            f"{job.item.name}: {len(u)} points in view, fewer than {_FEWEST_POINTS}", "too_few_points"
        )
    z = state.depth[v, u]
    u, v = u + columns.start, v + rows.start
    x = (u - view.matrix[0, 2]) / view.matrix[0, 0] * z
    y = (v - view.matrix[1, 2]) / view.matrix[1, 1] * z
    state.cloud = Cloud(np.stack([x, y, z], axis=1).astype(np.float32), None, CAMERA_FRAME)
    state.pixels = (v * view.width + u).astype(np.int64)


def _segmented(job: Job, state: SampleState) -> None:
    depth = np.where(np.isfinite(state.depth), state.depth, np.nan)
    image = (job.world.rays * depth[..., None]) @ job.world.view.R_world_camera
    scene = segment(Cloud(image.astype(np.float32), None, CAMERA_FRAME))
    seen = max((np.isin(state.pixels, object_.pixels) for object_ in scene.objects), key=np.count_nonzero, default=None)
    if seen is None or np.count_nonzero(seen) < _FEWEST_POINTS:
        raise SimulationError(f"{job.item.name}: segmentation does not find it: {scene.reason}", "too_few_points")
    state.cloud, state.pixels = state.cloud.take(seen), state.pixels[seen]


def _colour(job: Job, state: SampleState) -> None:
    rows, columns = state.window
    v, u = np.divmod(state.pixels, job.world.view.width)
    normal = normals_of(state)[v - rows.start, u - columns.start]
    state.cloud = replace(state.cloud, rgb=(light(normal)[:, None] * np.asarray(job.settings)).astype(np.uint8))


def light(normal: Float64) -> Float64:
    """Return the brightness (...) from 0.35 to 1 of surfaces with normals (..., 3) that are lit from above."""
    return np.asarray(0.35 + 0.65 * np.abs(normal[..., 2]))


def _overlap(view: depth_scene.CameraView, corners: Float64, window: depth_scene.Window) -> bool:
    return all(a.start < b.stop and b.start < a.stop for a, b in zip(window, view.window(corners), strict=True))


def _grown(span: slice, size: int) -> slice:
    return slice(max(0, span.start - _MARGIN_PX), min(size, span.stop + _MARGIN_PX))


PLACING = (Effect("object", _object, "objects"), Effect("clutter", _clutter, "clutter"))
_SEEING = (
    Effect("window", _object_window, "camera"),
    Effect("render", _render, "camera"),
    Effect("flying_pixels", _flying_pixels, "camera.flying_pixels"),
    Effect("depth_noise", _noise, "camera.noise"),
    Effect("stereo_shadow", _shadow, "camera.stereo"),
    Effect("holes", _holes, "camera.holes"),
    Effect("depth_steps", _quantise, "camera.z_step_m"),
    Effect("cloud", _cloud, "camera"),
    Effect("segmentation", _segmented, "camera.segmented"),
    Effect("colour", _colour, "objects.colour"),
)

EFFECTS = (*PLACING, *_SEEING)

#: What a camera image needs in place of `EFFECTS`: the whole frame, with other noise in each image.
FRAME_EFFECTS = (replace(_SEEING[0], run=_whole_window), *(replace(effect, again=True) for effect in _SEEING[1:-3]))
