# SPDX-License-Identifier: Apache-2.0
"""How far are the contacts of both methods of GeoGrasp from the true surface, and do they face each other? See README.md."""

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmarks.common import print_rows, scene, write_csv
from foretouch.camera.device import ensure_libusb
from foretouch.errors import SimulationError
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.types import Float64, Grasp
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.solids import Body
from foretouch_lab.simulation.world import SampleKey, World

SCENES = ("rigid", "deformables", "unseen_objects", "clutter")
METHODS = ("original", "completed")
BACK_M = 0.03  # outside of the planned contact, where a finger starts to close
QUANTITIES = {
    "distance from the true surface": "mm",
    "slope of the surface at the contact": "deg",
    "slope where the lowered finger touches": "deg",
}


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="samples of each scene")
    parser.add_argument("-o", "--out", type=Path, default=Path(__file__).parent / "truth.csv")
    arguments = parser.parse_args()
    ensure_libusb()
    rows = [row for name in SCENES for row in measure(name, arguments.count)]
    write_csv(arguments.out, rows)
    print_rows(rows)


def measure(name: str, count: int) -> list[dict[str, object]]:
    """The rows of one scene: for both methods the mean over all contacts, and over grasps the mean of the worse."""
    config = scene(name)
    world = World.of(config)
    engine = Engine(config, EFFECTS, ("cloud", "pixels", "bodies"))
    found: dict[tuple[str, str], list[Float64]] = defaultdict(list)
    for slot in range(count):
        try:
            state = engine.run(SampleKey(config.seed, slot))
        except SimulationError:
            continue  # clutter found no place, or hides the object
        shape = (world.view.height, world.view.width)
        plans = {
            method: plan_grasps(
                state.cloud, world.plane, GeoGraspConfig(method=method), pixels=state.pixels, image_shape=shape
            )
            for method in METHODS
        }
        if not all(plan.grasps for plan in plans.values()):
            continue
        for method, plan in plans.items():
            errors = contact_errors(state.bodies[0], world, plan.grasps[0], config.grasps.insertion_m)
            for quantity, values in zip(QUANTITIES, errors, strict=True):
                found[quantity, method].append(values)
    n = len(next(iter(found.values())))
    rows: list[dict[str, object]] = []

    def row(text: str, unit: str, values: dict[str, float]) -> None:
        one: dict[str, object] = {"scene": name, "n": n, "quantity": text, "unit": unit}
        rows.append(one | {method: f"{value:.2f}" for method, value in values.items()})

    for quantity, unit in QUANTITIES.items():
        values = {method: np.array(found[quantity, method]) for method in METHODS}
        row(f"{quantity}, mean", unit, {m: float(np.nanmean(v)) for m, v in values.items()})
        worse = {m: np.nanmax(np.where(np.isnan(v), -1.0, v), axis=1) for m, v in values.items()}
        row(f"{quantity}, worse contact", unit, {m: float(v.mean()) for m, v in worse.items()})
        if quantity.startswith("slope where"):
            row("fingers that close beside the object", "%", {m: 100.0 * np.isnan(v).mean() for m, v in values.items()})
    return rows


def contact_errors(body: Body, world: World, grasp: Grasp, lowered_m: float) -> tuple[Float64, Float64, Float64]:
    """(2,) each: distance of g1 and g2 from the surface [mm], the slope there, and where a lowered finger touches [deg].

    The slope is the angle between the way in which the finger closes and the inward normal of the surface; NaN where a
    finger closes beside the object.
    """
    contacts = world.view.to_world(np.stack([grasp.g1, grasp.g2]))
    closing = (contacts[::-1] - contacts) / np.linalg.norm(contacts[1] - contacts[0])
    nearest, normals = _nearest(body, contacts)
    start = contacts - BACK_M * closing - [0.0, 0.0, lowered_m]
    hits = body.cast(start, closing)
    touched = np.isfinite(hits.t) & (hits.t < BACK_M + grasp.width_m)
    slopes = np.where(touched, _angle(-body.world_normals(hits.normal), closing), np.nan)
    return np.linalg.norm(contacts - nearest, axis=1) * 1e3, _angle(-normals, closing), slopes


def _angle(a: Float64, b: Float64) -> Float64:
    return np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", a, b), -1.0, 1.0)))


def _nearest(body: Body, points: Float64) -> tuple[Float64, Float64]:
    """Nearest points of the true surface (2, 3) [m] and its outward normals there."""
    import open3d

    vertices = body.position + (body.mesh.vertices * body.size) @ body.rotation.T
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices.astype(np.float32), body.mesh.faces.astype(np.uint32))
    found = scene.compute_closest_points(open3d.core.Tensor(points.astype(np.float32)))
    normals = found["primitive_normals"].numpy().astype(np.float64)
    return found["points"].numpy().astype(np.float64), normals / np.linalg.norm(normals, axis=1, keepdims=True)


if __name__ == "__main__":
    main()
