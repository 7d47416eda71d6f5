# SPDX-License-Identifier: Apache-2.0
"""What the camera sees: exact depth by ray casting, then what a stereo camera makes of it."""

import numpy as np

from foretouch.errors import SimulationError
from foretouch.simulation.depth_effects import add_flying_pixels, add_stereo_noise, stereo_shadow
from foretouch.simulation.depth_scene import FIRST_OBJECT, TABLE
from foretouch.simulation.effect import Effect, Job, SampleState, Window, always, called_for, keys
from foretouch.simulation.solids import Hits
from foretouch.simulation.view import CameraView
from foretouch.simulation.world import World
from foretouch.types import Float64

_MARGIN_PX = 16  # around the object: room for flying pixels, the shadow of a neighbour and the matching window
_SPOT_PX = 3  # side of a hole


def _object_window(job: Job, state: SampleState) -> None:
    view = job.world.view
    rows, columns = view.window(state.bodies[0].corners())
    if rows.start >= rows.stop or columns.start >= columns.stop:
        raise SimulationError(f"{job.item.name}: lies outside of the view", "outside_view")
    state.window = _grown(rows, view.height), _grown(columns, view.width)


def _whole_window(job: Job, state: SampleState) -> None:
    state.window = slice(0, job.world.view.height), slice(0, job.world.view.width)


def _render(job: Job, state: SampleState) -> None:
    world, window = job.world, state.window
    rays = world.rays[window]
    depth = _table_depth(world, rays)
    labels = np.where(np.isfinite(depth), TABLE, 0).astype(np.int32)
    flat_rays, flat_depth, flat_labels = rays.reshape(-1, 3), depth.reshape(-1), labels.reshape(-1)
    hits: list[Hits | None] = []
    for label, body in enumerate(state.bodies, FIRST_OBJECT):
        if not _overlap(world.view, body.corners(), window):
            hits.append(None)
            continue
        hit = body.cast(world.view.eye, flat_rays)
        nearer = hit.t < flat_depth
        flat_depth[nearer] = hit.t[nearer]
        flat_labels[nearer] = label
        hits.append(hit)
    state.exact_depth, state.labels, state.hits = depth, labels, hits
    state.depth = depth.copy()


def _normals(_job: Job, state: SampleState) -> None:
    normals = np.zeros((*state.labels.shape, 3))
    flat, labels = normals.reshape(-1, 3), state.labels.reshape(-1)
    for label, (body, hit) in enumerate(zip(state.bodies, state.hits, strict=True), FIRST_OBJECT):
        if hit is not None:
            seen = labels == label
            flat[seen] = body.world_normals(hit.normal[seen])
    state.normals = normals


def _flying_pixels(job: Job, state: SampleState) -> None:
    config = job.scene.camera.flying_pixels
    if config is None:
        return
    rng = job.rng()
    flown = add_flying_pixels(state.depth, rng)
    state.depth = np.where(rng.random(flown.shape) < config.share, flown, state.depth)


def _noise(job: Job, state: SampleState) -> None:
    config = job.scene.camera.noise
    if config is None:
        return
    at_1_m = config.sub_pixel / (job.world.focal_px * config.baseline_m)  # sigma_z = s z² / (f B)
    state.depth = add_stereo_noise(state.depth, at_1_m, job.rng())


def _shadow(job: Job, state: SampleState) -> None:
    config = job.scene.camera.stereo
    if config is None:
        return
    hidden = stereo_shadow(state.exact_depth, job.world.focal_px, config.baseline_m)
    state.depth = np.where(hidden, np.inf, state.depth)


def _holes(job: Job, state: SampleState) -> None:
    config = job.scene.camera.holes
    if config is None:
        return
    from scipy.ndimage import uniform_filter

    # A spot is where the mean of white noise over its window is in the upper tail, which has the share asked for.
    spots = uniform_filter(job.rng().random(state.depth.shape), _SPOT_PX, mode="wrap")
    hole = spots > np.quantile(spots, 1.0 - config.share)
    rays = job.world.rays[state.window]
    facing = -np.einsum("ijk,ijk->ij", rays, state.normals) / np.linalg.norm(rays, axis=2)
    on_body = state.labels >= FIRST_OBJECT
    hole |= on_body & (facing < np.cos(np.radians(config.grazing_deg)))
    state.depth = np.where(hole, np.inf, state.depth)


def _quantise(job: Job, state: SampleState) -> None:
    step = job.scene.camera.z_step_m
    if step is not None:
        state.depth = np.rint(state.depth / step) * step


def _table_depth(world: World, rays: Float64) -> Float64:
    down = np.minimum(rays[..., 2], -1e-9)  # looking up never meets the table
    depth = -world.view.eye[2] / down
    at = world.view.eye[:2] + depth[..., None] * rays[..., :2]
    return np.where((np.abs(at) <= world.table_size / 2.0).all(axis=-1), depth, np.inf)


def _overlap(view: CameraView, corners: Float64, window: Window) -> bool:
    other = view.window(corners)
    return all(a.start < b.stop and b.start < a.stop for a, b in zip(window, other, strict=True))


def _grown(span: slice, size: int) -> slice:
    return slice(max(0, span.start - _MARGIN_PX), min(size, span.stop + _MARGIN_PX))


_RENDERED = keys("exact_depth", "labels", "hits", "depth")

_DEPTH_EFFECTS = (
    Effect("render", _render, always("camera"), reads=keys("bodies", "window"), writes=_RENDERED),
    Effect(
        "normals", _normals, always("holes or colour"), reads=keys("bodies", "labels", "hits"), writes=keys("normals")
    ),
    Effect(
        "flying_pixels",
        _flying_pixels,
        called_for("camera.flying_pixels"),
        off="no camera.flying_pixels",
        modifies=keys("depth"),
    ),
    Effect("depth_noise", _noise, called_for("camera.noise"), off="no camera.noise", modifies=keys("depth")),
    Effect(
        "stereo_shadow",
        _shadow,
        called_for("camera.stereo"),
        off="no camera.stereo",
        reads=keys("exact_depth"),
        modifies=keys("depth"),
    ),
    Effect(
        "holes",
        _holes,
        called_for("camera.holes"),
        off="no camera.holes",
        reads=keys("normals", "labels", "window"),
        modifies=keys("depth"),
    ),
    Effect("depth_steps", _quantise, called_for("camera.z_step_m"), off="no camera.z_step_m", modifies=keys("depth")),
)
# From a window to measured depth, for any window.

EFFECTS = (
    Effect("window", _object_window, always("camera"), reads=keys("bodies"), writes=keys("window")),
    *_DEPTH_EFFECTS,
)
"""What a sample needs: the part of the image about its object."""

FRAME_EFFECTS = (Effect("window", _whole_window, always("camera"), writes=keys("window")), *_DEPTH_EFFECTS)
"""A camera image: the whole frame."""
