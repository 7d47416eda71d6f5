# SPDX-License-Identifier: Apache-2.0
"""What does each step make of a changed cloud? A table of step x change: exact, bounded, or jumps. See README.md."""

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.common import add_data, print_rows, write_csv
from foretouch.cloud.io.files import read_cloud
from foretouch.cloud.segmentation.segment import segment
from foretouch.errors import ForetouchError
from foretouch.grasp import GeoGraspConfig, hand_rotation, plan_grasps
from foretouch.models import DEFAULT_MODEL, load_model
from foretouch.models.touch_model import TouchModel
from foretouch.types import ASSUMED_TABLE, Cloud, Float32, Float64, Grasp, Plane, TouchPrediction
from foretouch_lab.simulation.depth_scene import random_scene

MODELS = (DEFAULT_MODEL, "touchnet-v1")
HERE = Path(__file__).parent
RESULTS = HERE / "results.csv"

STEPS = {
    "segmentation: labels": ("% of the objects' pixels", 5.0),
    "segmentation: table plane": ("mm at 1 m", 5.0),
    "segmentation: clusters": ("objects", 0.5),
    "GeoGrasp original: best grasp": ("mm", 10.0),
    "GeoGrasp completed: best grasp": ("mm", 10.0),
    **{f"{name}: prediction": ("counts", 50.0) for name in MODELS},
}
"""What is compared, in which unit, and from where on a difference counts as a jump."""


@dataclass(frozen=True, eq=False)
class Change:
    """A change of a cloud: p -> scale · linear @ p + shift, and what else happens to the points."""

    name: str
    linear: Float64  # (3, 3) float64
    shift: Float64  # (3,) float64 [m]
    more: Callable[[Float64, np.random.Generator], Float64] | None = None  # (N, 3) to (M, 3) of a list
    in_image: Callable[[Float64, np.random.Generator], Float64] | None = None  # of an image; None: not possible

    def points(self, xyz: Float32, rng: np.random.Generator) -> Float32:
        """The changed list of points (N, 3), or image (H, W, 3)."""
        moved = xyz.astype(np.float64) @ self.linear.T + self.shift
        after = self.in_image if xyz.ndim == 3 else self.more
        return (moved if after is None else after(moved, rng)).astype(np.float32)

    def carry(self, point: Float64) -> Float64:
        """Where a point (..., 3) is carried."""
        return np.asarray(point @ self.linear.T + self.shift)

    def plane(self, plane: Plane) -> Plane:
        """Where a plane is carried; the linear part is a rotation, a mirror or a scale."""
        normal = np.linalg.inv(self.linear).T @ plane.normal
        at = self.carry(-plane.offset * plane.normal)
        return Plane.from_coefficients([*normal, -normal @ at])


def changes() -> Iterator[Change]:
    """All changes of clouds."""
    one, still = np.eye(3), np.zeros(3)

    def turn(degrees: float) -> Float64:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def noise(sigma: float) -> Callable[[Float64, np.random.Generator], Float64]:
        return lambda xyz, rng: xyz + rng.normal(0.0, sigma, xyz.shape)

    yield Change("order of points", one, still, lambda xyz, rng: rng.permutation(xyz))
    for name, shift in (("shift 1 mm", 0.001), ("shift 1 m", 1.0)):
        yield Change(name, one, np.array([shift, 0.0, 0.0]))
    for degrees in (1.0, 90.0):
        yield Change(f"turn {degrees:g}°", turn(degrees), still)
    yield Change("scale 1.25", 1.25 * one, still)
    yield Change("mirror", np.diag([-1.0, 1.0, 1.0]), still)
    yield Change("points twice", one, still, lambda xyz, _: np.concatenate([xyz, xyz]))
    yield Change("half the points", one, still, lambda xyz, rng: xyz[rng.random(len(xyz)) < 0.5], _half_image)
    yield Change("one far outlier", one, still, _far_point, _far_pixel)
    yield Change("5 % flying points", one, still, _flying, _flying)
    for name, sigma in (("jitter 1 µm", 1e-6), ("jitter 0.1 mm", 1e-4), ("jitter 0.5 mm", 5e-4)):
        yield Change(name, one, still, noise(sigma), noise(sigma))


LIST_ONLY = ("order of points", "points twice")


def _half_image(xyz: Float64, rng: np.random.Generator) -> Float64:
    xyz[rng.random(xyz.shape[:2]) < 0.5] = np.nan
    return xyz


def _far_point(xyz: Float64, _: np.random.Generator) -> Float64:
    return np.vstack([xyz, np.nanmean(xyz, axis=0) + np.array([0.25, 0.0, -0.05])])


def _far_pixel(xyz: Float64, rng: np.random.Generator) -> Float64:
    rows, columns = np.nonzero(np.isfinite(xyz[..., 2]))
    chosen = rng.integers(len(rows))
    xyz[rows[chosen], columns[chosen]] *= 0.4  # towards the camera
    return xyz


def _flying(xyz: Float64, rng: np.random.Generator) -> Float64:
    """One in twenty points is 1 to 8 % nearer to the camera on its ray."""
    flat = xyz.reshape(-1, 3)
    some = rng.random(len(flat)) < 0.05
    flat[some] *= 1.0 - rng.uniform(0.01, 0.08, (some.sum(), 1))
    return xyz


Ask = Callable[[Float32, Grasp, Plane], Float64]
Difference = Callable[[Float64, Float64], float]
Found = dict[tuple[str, str], list[float]]  # differences by step and change; NaN where the changed cloud is refused


def scene_image(seed: int) -> Cloud:
    """A simulated scene of three objects."""
    return random_scene(np.random.default_rng(seed), 424, 240).render(np.random.default_rng(seed), 0.001).cloud()


def measure(data: Path | None, every: int) -> Found:
    """All differences."""
    found: Found = defaultdict(list)
    models = {name: load_model(name) for name in MODELS}
    paths = sorted(Path(data).glob("vision2tactile/*/*/cloud-object.pcd"))[::every] if data else []
    clouds = [read_cloud(path).xyz.reshape(-1, 3) for path in paths] + list(made_objects())
    for seed, xyz in enumerate(clouds):
        for change in changes():
            object_steps(found, xyz, change, models, np.random.default_rng(seed))
    for seed in range(6):
        image = scene_image(seed).xyz
        for change in changes():
            scene_steps(found, image.reshape(-1, 3), change, np.random.default_rng(seed))
            if change.name not in LIST_ONLY:
                scene_steps(found, image, change, np.random.default_rng(seed))
    return found


def rows(found: Found) -> Iterator[dict[str, object]]:
    """The rows of the CSV."""
    for (step, change), values in sorted(found.items()):
        answered = np.array([value for value in values if not np.isnan(value)])
        unit, limit = STEPS[step]
        yield {
            "step": step,
            "change": change,
            "n": len(values),
            "refused": len(values) - len(answered),
            "unit": unit,
            "median": f"{np.median(answered):.3g}" if len(answered) else "",
            "largest": f"{answered.max():.3g}" if len(answered) else "",
            "limit": f"{limit:g}",
            "over": int((answered > limit).sum()),
        }


def made_objects() -> Iterator[Float32]:
    """Boxes and lying cylinders of unequal sides, 1.2 m away, with 0.5 mm of depth noise."""
    rng = np.random.default_rng(7)
    for turn in (0.3, 1.1):
        u, v = np.meshgrid(np.arange(-0.12, 0.12, 0.002), np.arange(-0.12, 0.12, 0.002))
        a, b = u * np.cos(turn) + v * np.sin(turn), v * np.cos(turn) - u * np.sin(turn)
        wedge = np.abs(b) < 0.03 + 0.1 * a
        for inside, height in (
            ((np.abs(a) < 0.08) & wedge, np.full(a.shape, 0.05)),
            ((np.abs(a) < 0.07) & (np.abs(b) < 0.03), np.sqrt(np.maximum(0.03**2 - b**2, 0.0)) + 0.2 * (a + 0.07)),
        ):
            depth = 1.2 - height + rng.normal(0.0, 0.0005, a.shape)
            yield np.stack([u, v, depth], axis=-1)[inside].astype(np.float32)


def given_grasp(xyz: Float32) -> tuple[Grasp, Float64]:
    """The grasp whose touch is predicted, and the object's axis."""
    plan = plan_grasps(Cloud(xyz), ASSUMED_TABLE, GeoGraspConfig())
    assert plan.axis is not None
    return plan.grasps[0], plan.axis


def _largest(before: Float64, after: Float64) -> float:
    return float(np.abs(after - before).max())


def _largest_move(before: Float64, after: Float64) -> float:
    return float(np.linalg.norm(after - before, axis=1).max())


def object_steps(
    found: Found, xyz: Float32, change: Change, models: dict[str, TouchModel], rng: np.random.Generator
) -> None:
    """The steps on the cloud of one object, before and after a change."""
    other = change.points(xyz, rng)
    grasp, axis = given_grasp(xyz)
    g1, g2 = change.carry(grasp.g1), change.carry(grasp.g2)
    turned = not np.array_equal(change.linear, np.eye(3))
    carried = Grasp(g1, g2, hand_rotation(g1, g2, change.linear @ axis) if turned else grasp.rotation)
    table = change.plane(ASSUMED_TABLE)

    def compare(step: str, ask: Ask, difference: Difference = _largest) -> None:
        before = ask(xyz, grasp, ASSUMED_TABLE)
        try:
            found[step, change.name].append(difference(before, ask(other, carried, table)))
        except ForetouchError:
            found[step, change.name].append(np.nan)

    def moved(before: Float64, after: Float64) -> float:
        # A hand is not mirrored: on a mirrored object thumb and middle finger change sides.
        ends = [after, after[::-1]] if change.name == "mirror" else [after]
        return 1e3 * min(_largest_move(change.carry(before), one) for one in ends)

    for method in ("original", "completed"):
        compare(f"GeoGrasp {method}: best grasp", partial(_best, method), moved)
    for name, model in models.items():
        compare(
            f"{name}: prediction", lambda points, one, _, model=model: _vector(model.predict(Cloud(points), [one])[0])
        )


def _vector(prediction: TouchPrediction) -> Float64:
    if prediction.value is None:
        raise ForetouchError(prediction.reason)
    return prediction.value.values


def _best(method: str, points: Float32, _: Grasp | None, table: Plane) -> Float64:
    plan = plan_grasps(Cloud(points), table, GeoGraspConfig(method=method))
    if not plan.grasps:
        raise ForetouchError(plan.reason)
    return np.stack([plan.grasps[0].g1, plan.grasps[0].g2])


def scene_steps(found: Found, xyz: Float32, change: Change, rng: np.random.Generator) -> None:
    """Segmentation of a scene, as an image or as a list of points, before and after a change."""
    shape = xyz.shape[:-1]
    names = ("segmentation: labels", "segmentation: table plane", "segmentation: clusters")
    before, after = segment(Cloud(xyz)), segment(Cloud(change.points(xyz, rng)))
    if before.plane is None or after.plane is None:
        for name in names:
            found[name, change.name].append(np.nan)
        return
    labels = after.labels
    if change.name == "order of points":
        order = np.random.default_rng(rng.bit_generator.seed_seq).permutation(len(labels))  # type: ignore[attr-defined]
        labels = np.zeros_like(labels)
        labels[order] = after.labels
    labels = labels.reshape(-1)[: int(np.prod(shape))] if change.name != "half the points" else None
    if labels is not None:
        first, second = before.labels.reshape(-1) > 0, labels > 0
        found[names[0], change.name].append(100.0 * float((first != second).sum()) / max(int(first.sum()), 1))
    expected = change.plane(before.plane)
    turned = float(np.linalg.norm(np.cross(expected.normal, after.plane.normal)))
    apart = abs(abs(expected.offset) - abs(after.plane.offset))
    found[names[1], change.name].append(1e3 * max(turned, apart))
    found[names[2], change.name].append(float(abs(len(before.objects) - len(after.objects))))


def main() -> None:
    """Measure, print and write the rows; the committed table holds more steps and changes."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--every", type=int, default=8, help="use each k-th recorded cloud")
    parser.add_argument("-o", "--out", type=Path, default=Path("invariances.csv"))
    arguments = parser.parse_args()
    found = list(rows(measure(arguments.data, arguments.every)))
    write_csv(arguments.out, found)
    print_rows(found)


if __name__ == "__main__":
    main()
