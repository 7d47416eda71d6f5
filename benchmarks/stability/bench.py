# SPDX-License-Identifier: Apache-2.0
"""How far does the best grasp move when the cloud changes a little? Both methods of GeoGrasp on recorded objects."""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import add_data, print_rows, write_csv
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, GraspPlan, HandConfig, plan_grasps
from foretouch.types import Cloud, Float32, Float64, Plane

TOP_VIEW = Plane.from_coefficients([0.0, 0.0, 1.0, -1.27])
METHODS = ("original", "completed")
TUNED_ON = 8  # each k-th recorded cloud served to tune an earlier method
MOVED_MM = 10.0


@dataclass(frozen=True, eq=False)
class Change:
    """A change of a cloud: a turn about the vertical through its centroid, a shift, and noise or another order of the points."""

    turn_deg: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m]
    more: Callable[[Float64, np.random.Generator], Float64] = lambda xyz, _: xyz

    def carry(self, points: Float64, centre: Float64) -> Float64:
        """Return where points (..., 3) are carried."""
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray((points - centre) @ turn.T + centre + self.shift)


def jitter(sigma_m: float) -> Change:
    """Return a change by independent normal noise on each coordinate."""
    return Change(more=lambda xyz, rng: xyz + rng.normal(0.0, sigma_m, xyz.shape))


CHANGES: Mapping[str, Change] = {
    "order of points": Change(more=lambda xyz, rng: rng.permutation(xyz)),
    "jitter 1 µm": jitter(1e-6),
    "jitter 0.1 mm": jitter(1e-4),
    "shift 1 mm": Change(shift=(0.001, 0.0, 0.0)),
    "shift 1 m": Change(shift=(1.0, 0.0, 0.0)),
    **{f"turn {degrees:g}°": Change(degrees) for degrees in (1.0, 90.0, 180.0)},
}


def measure(name: str, clouds: list[Float32], methods: Sequence[str] = METHODS) -> Iterator[dict[str, Any]]:
    """Iterate over the rows of the table for some clouds; a method may be the name of a described hand."""
    moved: dict[tuple[str, str], list[float]] = {(change, method): [] for change in CHANGES for method in methods}
    for seed, xyz in enumerate(clouds):
        centre = xyz.mean(axis=0, dtype=np.float64)
        for method in methods:
            before, rng = plan(xyz, method), np.random.default_rng(seed)
            for key, change in CHANGES.items():
                after = change.more(change.carry(xyz.astype(np.float64), centre), rng).astype(np.float32)
                moved[key, method].append(distance_mm(before, plan(after, method), change, centre))
    for key in CHANGES:
        values = {method: np.array(moved[key, method]) for method in methods}
        first = {"clouds": name, "n": len(clouds)}
        share = {method: f"{100.0 * np.mean(v > MOVED_MM):.2f}" for method, v in values.items()}
        yield {**first, "quantity": f"{key}: moved > {MOVED_MM:g} mm", "unit": "%", **share}
        largest = {method: f"{v.max():.2f}" for method, v in values.items()}
        yield {**first, "quantity": f"{key}: largest move", "unit": "mm", **largest}


def plan(xyz: Float32, method: str) -> GraspPlan:
    """Return the best grasp on an object seen from above, by a method, or by the default one for a described hand."""
    if method in METHODS:
        return plan_grasps(Cloud(xyz), TOP_VIEW, GeoGraspConfig(method=method))
    return plan_grasps(Cloud(xyz), TOP_VIEW, GeoGraspConfig(), hand=HandConfig(name=method))


def distance_mm(before: GraspPlan, after: GraspPlan, change: Change, centre: Float64) -> float:
    """Return how far the contact that moved more is from where the change carries it; infinite if one plan has no grasp."""
    if not before.grasps or not after.grasps:
        return 0.0 if len(before.grasps) == len(after.grasps) else float("inf")
    contacts, moved = (np.stack([plan.grasps[0].g1, plan.grasps[0].g2]) for plan in (before, after))
    return float(np.linalg.norm(change.carry(contacts, centre) - moved, axis=1).max() * 1e3)


def main() -> None:
    """Print and write the one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--all", action="store_true", help="also the clouds that did not tune an earlier method")
    parser.add_argument(
        "--hands", nargs="+", metavar="HAND", help="described hands instead of the methods; print alone"
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("results.csv"))
    options = parser.parse_args()
    paths = sorted(Path(options.data or "").glob("vision2tactile/*/*/cloud-object.pcd"))
    if not paths:
        raise SystemExit("no recordings: --data or FORETOUCH_DATA")
    rows: list[dict[str, Any]] = []
    for name, tuned in (("real, tuned on", True), ("real, others", False)):
        if tuned or options.all:
            chosen = [path for k, path in enumerate(paths) if (k % TUNED_ON == 0) == tuned]
            rows += measure(name, [read_cloud(path).xyz.reshape(-1, 3) for path in chosen], options.hands or METHODS)
    print_rows(rows)
    if not options.hands:
        write_csv(options.out, rows)


if __name__ == "__main__":
    main()
