# SPDX-License-Identifier: Apache-2.0
"""How far does the best grasp move when the cloud changes a little? Both methods of GeoGrasp, real and made objects."""

import argparse
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.common import add_data, cpu_ms, print_rows, write_csv
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, GraspPlan, plan_grasps
from foretouch.grasp.original_score import original_score
from foretouch.types import Cloud, Float32, Float64, Plane

TOP_VIEW = Plane.from_coefficients([0.0, 0.0, 1.0, -1.27])
METHODS = ("original", "stable")
TUNED_ON = 8  # each k-th recorded cloud served to tune `stable`
MOVED_MM = 10.0
CHANGES = (
    "order",
    "jitter 1 um",
    "jitter 0.1 mm",
    "shift 1 mm",
    "shift 1 m",
    "turn 1 deg",
    "turn 90 deg",
    "turn 180 deg",
)


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument(
        "--all", action="store_true", help="also the recorded clouds that did not serve to tune `stable`"
    )
    parser.add_argument("-o", "--out", type=Path, default=Path(__file__).parent / "results.csv")
    arguments = parser.parse_args()
    groups = {"made": list(made_clouds())}
    paths = sorted(Path(arguments.data).glob("vision2tactile/*/*/cloud-object.pcd")) if arguments.data else []
    if paths:
        clouds = [read_cloud(path).xyz.reshape(-1, 3) for path in paths]
        groups["real, tuned on"] = clouds[::TUNED_ON]
        if arguments.all:
            groups["real, others"] = [cloud for i, cloud in enumerate(clouds) if i % TUNED_ON]
    else:
        print("no recordings: --data or FORETOUCH_DATA; only made objects are measured")
    rows = [row for name, clouds in groups.items() for row in measure(name, clouds)]
    write_csv(arguments.out, rows)
    print_rows(rows)


def measure(name: str, clouds: list[Float32]) -> Iterator[dict[str, object]]:
    """The rows of the table for some clouds."""
    moved: dict[tuple[str, str], list[float]] = defaultdict(list)
    scores: dict[str, list[tuple[float, bool]]] = defaultdict(list)
    times: dict[str, float] = defaultdict(float)
    for seed, xyz in enumerate(clouds):
        scorer = original_score(Cloud(xyz), TOP_VIEW)
        plans = {}
        for method in METHODS:
            plans[method] = plan(xyz, method)
            times[method] += cpu_ms(lambda xyz=xyz, method=method: plan(xyz, method), 1)
        if scorer is not None and scorer.has_axis and all(one.grasps for one in plans.values()):
            for method, one in plans.items():
                scores[method].append(scorer(contacts(one)))
        for change, other, rotation, shift in changed(xyz, seed):
            for method in METHODS:
                moved[change, method].append(distance_mm(plans[method], plan(other, method), rotation, shift))

    def row(quantity: str, unit: str, values: dict[str, float], form: str) -> dict[str, object]:
        texts = {method: format(value, form) for method, value in values.items()}
        return {"clouds": name, "n": len(clouds), "quantity": quantity, "unit": unit, **texts}

    for change in CHANGES:
        values = {method: np.array(moved[change, method]) for method in METHODS}
        share = {method: 100.0 * float(np.mean(v > MOVED_MM)) for method, v in values.items()}
        yield row(f"{change}: moved > {MOVED_MM:g} mm", "%", share, ".2f")
        yield row(f"{change}: largest move", "mm", {method: v.max() for method, v in values.items()}, ".2f")
    finite = np.isfinite([[score for score, _ in scores[method]] for method in METHODS]).all(axis=0)
    scored = {method: [one for one, ok in zip(scores[method], finite, strict=True) if ok] for method in METHODS}
    means = {method: np.mean(one, axis=0) for method, one in scored.items()}  # of score, and of whether it is reached
    yield row(f"original's score, mean ({finite.sum()} clouds)", "", {m: v[0] for m, v in means.items()}, ".3f")
    yield row("R1 >= 1 and R2 >= 1", "%", {m: 100.0 * v[1] for m, v in means.items()}, ".1f")
    yield row("time of a plan", "ms", {method: times[method] / len(clouds) for method in METHODS}, ".1f")
    yield row("time of a plan, ratio", "", {m: times[m] / times["original"] for m in METHODS}, ".2f")


def plan(xyz: Float32, method: str) -> GraspPlan:
    """The best grasp on an object seen from above."""
    return plan_grasps(Cloud(xyz), TOP_VIEW, GeoGraspConfig().replace(method=method))


def contacts(one: GraspPlan) -> Float64:
    """(2, 3) float64 [m], of the best grasp."""
    return np.stack([one.grasps[0].g1, one.grasps[0].g2])


def distance_mm(before: GraspPlan, after: GraspPlan, rotation: Float64, shift: Float64) -> float:
    """How far the contact that moved more is from where the change carries it; infinite if one plan has no grasp."""
    if not before.grasps or not after.grasps:
        return 0.0 if before.grasps == after.grasps else float("inf")
    carried = contacts(before) @ rotation.T + shift
    return float(np.linalg.norm(carried - contacts(after), axis=1).max() * 1e3)


def changed(xyz: Float32, seed: int) -> Iterator[tuple[str, Float32, Float64, Float64]]:
    """The changes by name: the changed cloud, and the rotation and shift that carry the grasp along."""
    rng = np.random.default_rng(seed)
    x, none, still = xyz.astype(np.float64), np.eye(3), np.zeros(3)
    yield "order", xyz[rng.permutation(len(xyz))], none, still
    for name, sigma in (("jitter 1 um", 1e-6), ("jitter 0.1 mm", 1e-4)):
        yield name, (x + rng.normal(0.0, sigma, x.shape)).astype(np.float32), none, still
    for name, shift in (("shift 1 mm", [1e-3, 0.0, 0.0]), ("shift 1 m", [1.0, 0.0, 0.0])):
        yield name, (x + shift).astype(np.float32), none, np.array(shift)
    centre = x.mean(axis=0)
    for degrees in (1, 90, 180):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        yield f"turn {degrees} deg", ((x - centre) @ turn.T + centre).astype(np.float32), turn, centre - turn @ centre


def made_clouds() -> Iterator[Float32]:
    """Boxes, lying cylinders, domes and rings of several sizes, as a depth camera 1.2 m above the table sees them."""
    rng = np.random.default_rng(11)
    for size in (0.05, 0.08, 0.11):
        for shape in ("box", "cylinder", "dome", "ring"):
            for turn in rng.uniform(0.0, np.pi, 3):
                u, v = np.meshgrid(np.arange(-0.15, 0.15, 0.002), np.arange(-0.15, 0.15, 0.002))
                a = u * np.cos(turn) + v * np.sin(turn)
                b = v * np.cos(turn) - u * np.sin(turn)
                radius = np.hypot(a, b)
                inside, height = {
                    "box": ((np.abs(a) < size) & (np.abs(b) < size / 2), np.full(a.shape, 0.05)),
                    "cylinder": (
                        (np.abs(a) < size) & (np.abs(b) < size / 2),
                        np.sqrt(np.maximum((size / 2) ** 2 - b**2, 0.0)),
                    ),
                    "dome": (radius < size / 2, np.sqrt(np.maximum((size / 2) ** 2 - radius**2, 0.0))),
                    "ring": ((radius < size / 2) & (radius > size / 4), np.full(a.shape, 0.02)),
                }[shape]
                depth = 1.2 - height + rng.normal(0.0, 0.0007, a.shape)
                yield np.stack([u, v, depth], axis=-1)[inside].astype(np.float32)


if __name__ == "__main__":
    main()
