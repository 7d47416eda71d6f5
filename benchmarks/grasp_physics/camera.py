# SPDX-License-Identifier: Apache-2.0
"""What the depth camera of `config/scenes/rigid.yaml`, with all its faults, sees of one object on the table."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from benchmarks.common import scene
from benchmarks.grasp_physics.objects import Item, Placed
from foretouch.types import Cloud, Float32, Float64
from foretouch_lab.simulation.depth_scene import CameraView, RenderedFrame, to_millimetres
from foretouch_lab.simulation.effects.view import FRAME_EFFECTS
from foretouch_lab.simulation.engine import Effect, Engine, Job, SampleState
from foretouch_lab.simulation.solids import Body, Hits
from foretouch_lab.simulation.world import SampleKey

VIEWS: Final = ("oblique", "above")
ELEVATION_DEG: Final = (45.0, 60.0)  # of the oblique camera over the table
DISTANCE_M: Final = (0.8, 1.2)  # from the world's origin
_MISS = 1e30


@dataclass(frozen=True, eq=False)
class Surface(Body):
    """A body whose triangles are given in the world."""

    triangles: Float32  # (F, 3, 3) float32 [m]

    @classmethod
    def of(cls, item: Item, pose: Float64) -> "Surface":
        """Return the surface of an object at a pose."""
        mesh = item.at(pose)
        low, high = mesh.bounds
        triangles = np.ascontiguousarray(mesh.triangles, np.float32)
        return cls(
            shape="", variant=0, size=high - low, position=(low + high) / 2.0, rotation=np.eye(3), triangles=triangles
        )

    @cached_property
    def _tree(self) -> Any:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        tree = EmbreeScene(robust=True)
        TriangleMesh(tree, self.triangles)
        return tree

    def cast(self, origins: Float64, directions: Float64) -> Hits:
        """Return first hits of rays from outside, as `Body` does."""
        along = np.ascontiguousarray(directions, np.float32)
        answer = self._tree.run(np.array(np.broadcast_to(origins, along.shape), np.float32), along, output=1)
        t = answer["tfar"].astype(np.float64)
        return Hits(np.where(t < _MISS, t, np.inf), answer["Ng"])

    def world_normals(self, normal: Float32) -> Float64:
        """Return unit normals (n, 3) float64."""
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True), np.float64)


@dataclass(frozen=True, eq=False)
class Seen:
    """One image of one object."""

    item: Item
    pose: Float64  # (4, 4) float64, object to world
    camera: CameraView  # where the camera stands in the world
    cloud: Cloud  # (H, W, 3), camera frame


def see(item: Item, number: int, view: str) -> Seen:
    """Return an image of an object at its pose of this number, in one of `VIEWS`."""
    return see_all(
        [(item, item.pose(number))], zlib.crc32(item.name.encode()), len(VIEWS) * number + VIEWS.index(view), view
    )


def see_all(stand: Sequence[Placed], seed: int, slot: int, view: str) -> Seen:
    """Return an image of objects, of which the first is wanted, in one of `VIEWS`; `seed` and `slot` decide where the camera stands, and its noise."""
    item, pose = stand[0]
    rng = np.random.default_rng([seed, slot, 1])
    elevation = rng.uniform(*ELEVATION_DEG) if view == "oblique" else 90.0
    stands = {"camera__tilt_deg": 90.0 - elevation, "camera__distance_m": float(rng.uniform(*DISTANCE_M))}
    config = scene("rigid", objects=[{"name": item.name}], **stands)  # `put` puts the objects themselves there
    camera, bodies = config.camera.view(), [Surface.of(*one) for one in stand]

    def put(_job: Job, state: SampleState) -> None:
        state.bodies = bodies

    engine = Engine(config, (Effect("object", put, "objects"), *FRAME_EFFECTS))
    depth = to_millimetres(engine.run(SampleKey(seed, slot)).depth)
    nothing, rgb = np.zeros(depth.shape, np.int32), np.zeros((*depth.shape, 3), np.uint8)
    return Seen(item, pose, camera, RenderedFrame(depth, rgb, nothing, camera.matrix, camera.table_plane()).cloud())
