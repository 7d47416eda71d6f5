# SPDX-License-Identifier: Apache-2.0
"""The outline in the image: what pixels of an edge, which are dropped, took from an object is given back."""

from dataclasses import replace

import numpy as np
import pytest
from every_case import every_case
from seen_solids import Camera, Solid, box, can

from foretouch.pipeline import Pipeline
from foretouch.types import Cloud
from foretouch.types.scene import Object
from foretouch_lab.simulation.depth_scene import FLYING_SHARE, add_flying_pixels, table_depth

SOLIDS = {"can": can(0.033, 0.1), "box": box(0.06, 0.09, 0.08), "tall box": box(0.045, 0.09, 0.16)}


def seen(solid: Solid, camera: Camera, rng: np.random.Generator) -> Object:
    """Return a solid on its table, in an image of which half of the pixels on an edge mix both depths and are dropped."""
    rays = camera.directions()
    own, table = solid.body.cast(camera.eye, rays), table_depth(camera, rays)
    depth = np.minimum(own, table)
    mixed = rng.random(depth.shape) < FLYING_SHARE
    flown = np.where(mixed, add_flying_pixels(depth, rng), depth)
    image = Cloud((rays @ camera.R_world_camera * flown[..., None]).astype(np.float32))
    pixels = np.flatnonzero((own < table) & np.isclose(flown, depth, rtol=0.0, atol=1e-9))
    points = Cloud(image.xyz.reshape(-1, 3)[pixels])
    return Object.of("1", points, camera.table(), pixels=pixels, image_shape=depth.shape, image=image)


def test_a_width_is_unbiased_though_the_outline_is_eroded(rng: np.random.Generator) -> None:
    missing: dict[str, list[float]] = {"image": [], "points": []}

    def check(solid: Solid, elevation_deg: float) -> None:
        camera = Camera(elevation_deg)
        target = seen(solid, camera, rng)
        for name, one in {"image": target, "points": replace(target, image=None)}.items():
            (grasp,) = Pipeline().plan(one).grasps
            ends = camera.to_world(np.stack([grasp.g1, grasp.g2]))
            true = solid.contacts(ends.mean(axis=0), (ends[1] - ends[0]) / grasp.width_m)
            width_m = float(np.linalg.norm(true[1] - true[0]))
            missing[name].append(width_m - grasp.width_m)
            assert grasp.way is not None
            assert grasp.way.width_at_most_m > width_m
        assert abs(missing["image"][-1]) < 0.003

    every_case([(solid, elevation) for solid in SOLIDS.values() for elevation in (55.0, 75.0, 90.0)], check)
    assert abs(np.median(missing["image"])) < 0.001
    assert np.mean(np.abs(missing["image"])) < 0.5 * np.mean(np.abs(missing["points"]))


def test_a_side_that_faces_the_camera_ends_at_its_surface(rng: np.random.Generator) -> None:
    """Its outermost points are those with the largest noise, and no half pixel is beyond them."""
    camera, solid = Camera(50.0), box(0.12, 0.06, 0.12)
    target = seen(solid, camera, rng)
    noise = 1.0 + rng.normal(0.0, 0.0015, len(target.pixels))[:, None]
    noisy = replace(target, cloud=Cloud((target.cloud.xyz * noise).astype(np.float32)))
    opened = Pipeline(Pipeline().config.updated({"hand.opening_m": 0.2, "grasp.count": 60}))
    along = [
        ends
        for grasp in opened.plan(noisy).grasps
        if abs(np.subtract(*(ends := camera.to_world(np.stack([grasp.g1, grasp.g2])))[:, 1])) < 0.02
    ]
    assert len(along) > 1
    near = [ends[:, 0].min() for ends in along]
    assert np.median(near) == pytest.approx(-0.06, abs=0.0012)
