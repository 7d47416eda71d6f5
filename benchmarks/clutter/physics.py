# SPDX-License-Identifier: Apache-2.0
"""Let objects come to rest on a table, with MuJoCo (extra `physics`)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from benchmarks.clutter.models import SOLIDS, Model
from foretouch.types import Bool, Float64

PULL_M_S2: Final = 3.0  # acceleration towards the middle that brings objects together
_PULLED_S: Final = 0.8
_SETTLED_S: Final = 1.0  # at least
_PATIENCE_S: Final = 5.0  # at most, until nothing moves
_SLIPPERY: Final = 0.1  # friction while objects are pulled
_STILL: Final = 0.01  # [m/s] and [rad/s], of an object at rest
_TOUCH_M: Final = 5e-4  # distance up to which two surfaces touch


@dataclass(frozen=True, eq=False)
class Placed:
    """A model in the world, whose z = 0 is the table."""

    model: Model  # what
    position: Float64  # (3,) float64, middle of its bounding box [m]
    rotation: Float64  # (3, 3) float64, its axes as columns


@dataclass(frozen=True, eq=False)
class Pile:
    """Objects at rest.

    Attributes:
        objects: All of them.
        touching: (n + 1, n + 1) bool, which touch; the last is the table.
        deepest_m: How far two bodies are within each other at most [m].
        still: Whether all are at rest.
    """

    objects: tuple[Placed, ...]
    touching: Bool
    deepest_m: float
    still: bool


def settle(start: Sequence[Placed], friction: float, *, pulled: bool = False) -> Pile:
    """Release objects and wait.

    Args:
        start: Where they are released, apart from each other.
        friction: Coefficient between all surfaces.
        pulled: Whether they slide to the middle first, over a slippery table.
    """
    import mujoco  # type: ignore[import-untyped, unused-ignore]

    physics = mujoco.MjModel.from_xml_string(_xml(start))
    data = mujoco.MjData(physics)
    for k, one in enumerate(start):
        data.qpos[7 * k : 7 * k + 3] = one.position
        mujoco.mju_mat2Quat(data.qpos[7 * k + 3 : 7 * k + 7], one.rotation.ravel())
    step_s = physics.opt.timestep
    if pulled:
        physics.geom_friction[:, 0] = _SLIPPERY
        for _ in range(round(_PULLED_S / step_s)):
            away = data.xpos[1:, :2]
            far = np.linalg.norm(away, axis=1, keepdims=True)
            data.xfrc_applied[1:, :2] = -PULL_M_S2 * physics.body_mass[1:, None] * away / np.maximum(far, 0.02)
            mujoco.mj_step(physics, data)
        data.xfrc_applied[:] = 0.0
    physics.geom_friction[:, 0] = friction
    until = data.time + _SETTLED_S, data.time + _PATIENCE_S
    while data.time < until[0] or (data.time < until[1] and np.abs(data.qvel).max() >= _STILL):
        mujoco.mj_step(physics, data)
    rested = tuple(
        replace(one, position=data.xpos[k].copy(), rotation=data.xmat[k].reshape(3, 3).copy())
        for k, one in enumerate(start, 1)
    )
    touching, deepest = _contacts(physics, data, len(start))
    return Pile(rested, touching, deepest, bool(np.abs(data.qvel).max() < _STILL))


def _contacts(physics: Any, data: Any, count: int) -> tuple[Bool, float]:
    touching = np.zeros((count + 1, count + 1), np.bool_)
    deepest = 0.0
    for contact in data.contact:
        pair = [int(physics.geom_bodyid[geom]) - 1 for geom in contact.geom]  # the table is -1, hence the last
        if contact.dist < _TOUCH_M:
            touching[pair[0], pair[1]] = touching[pair[1], pair[0]] = True
        deepest = max(deepest, -float(contact.dist))
    return touching, deepest


def _xml(start: Sequence[Placed]) -> str:
    meshes, bodies = [], []
    for k, one in enumerate(start):
        geoms = []
        if one.model.shape:
            kind, (x, y, z) = SOLIDS[one.model.shape], one.model.size / 2.0
            size = {"box": (x, y, z), "cylinder": (x, z), "sphere": (x,)}[kind]
            geoms.append(f'<geom type="{kind}" size="{_words(size)}"/>')
        for part, vertices in enumerate(one.model.parts):
            name = f"m{k}_{part}"
            meshes.append(f'<mesh name="{name}" vertex="{_words(vertices)}"/>')
            geoms.append(f'<geom type="mesh" mesh="{name}"/>')
        bodies.append(f"<body><freejoint/>{''.join(geoms)}</body>")
    return f"""<mujoco>
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default><geom density="400" condim="6" friction="0.6 0.005 0.002"/></default>
  <asset>{"".join(meshes)}</asset>
  <worldbody><geom type="plane" size="2 2 0.1"/>{"".join(bodies)}</worldbody>
</mujoco>"""


def _words(numbers: Any) -> str:
    return " ".join(f"{number:.7g}" for number in np.ravel(numbers))
