# SPDX-License-Identifier: Apache-2.0
"""From measured depth to the cloud of the object, by the labels of the ray caster."""

from dataclasses import replace

import numpy as np

from foretouch.errors import SimulationError
from foretouch.simulation.depth_scene import FIRST_OBJECT
from foretouch.simulation.effect import Effect, Job, SampleState, always, called_for, keys
from foretouch.simulation.world import CAMERA_FRAME
from foretouch.types import Cloud

_FEWEST = 100  # points; fewer are no view of an object


def _cloud(job: Job, state: SampleState) -> None:
    view = job.world.view
    rows, columns = state.window
    v, u = np.nonzero((state.labels == FIRST_OBJECT) & np.isfinite(state.depth))
    if len(u) < _FEWEST:
        raise SimulationError(f"{job.item.name}: {len(u)} points in view, fewer than {_FEWEST}", "too_few_points")
    z = state.depth[v, u]
    u, v = u + columns.start, v + rows.start
    x = (u - view.matrix[0, 2]) / view.matrix[0, 0] * z
    y = (v - view.matrix[1, 2]) / view.matrix[1, 1] * z
    state.cloud = Cloud(np.stack([x, y, z], axis=1).astype(np.float32), None, CAMERA_FRAME)
    state.pixels = (v * view.width + u).astype(np.int64)


def _colour(job: Job, state: SampleState) -> None:
    if job.item.colour is None:
        return
    rows, columns = state.window
    v, u = np.divmod(state.pixels, job.world.view.width)
    normal = state.normals[v - rows.start, u - columns.start]
    shade = 0.35 + 0.65 * np.abs(normal[:, 2])  # lit from above
    rgb = (shade[:, None] * np.asarray(job.item.colour)).astype(np.uint8)
    state.cloud = replace(state.cloud, rgb=rgb)


EFFECTS = (
    Effect("cloud", _cloud, always("camera"), reads=keys("depth", "labels", "window"), writes=keys("cloud", "pixels")),
    Effect(
        "colour",
        _colour,
        called_for("objects.colour"),
        off="no objects.colour",
        reads=keys("normals", "pixels", "window"),
        modifies=keys("cloud"),
    ),
)
