# SPDX-License-Identifier: Apache-2.0
"""Comparison with the original C++ GeoGrasp and with grasps that a robot executed."""

from collections import Counter
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.common import read_csv
from foretouch.cloud.geometry.pcl_filters import inlier_mask
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, GraspPlan, hand_rotation, plan_grasps
from foretouch.grasp.axis import find_axis
from foretouch.grasp.ranking import find_grasp_plane
from foretouch.types import Float64, Plane

COUNTS = ("n_filtered", "n_voxel", "n_plane", "n_first", "n_second", "n_fv", "n_sv", "n_nan_normals")
INITIAL_TOLERANCE_M = 1e-6
GRASP_TOLERANCE_M = 1e-4
EXECUTED_TOLERANCE_M = 1e-5  # the executed contacts have six significant digits
SCORE_TOLERANCE = 1e-3
POSE_TOLERANCE = 1e-4  # of a direction; the reference prints six decimals
TOP_VIEW = Plane.from_coefficients([0.0, 0.0, 1.0, -1.27])


@dataclass(frozen=True, eq=False)
class ReferenceRow:
    """One run of the original: the cloud, its settings, and the results."""

    cloud: Path
    plane: Plane
    config: GeoGraspConfig
    counts: dict[str, int]
    found: dict[str, Float64]  # initial, contacts (2, 3), rotation (3, 3), axis, centroid (3,) [m], score (1,)
    is_initial: bool


@dataclass(frozen=True, eq=False)
class ExecutedGrasp:
    """A grasp that the robot executed, and the slides of the grasp plane that explain it."""

    cloud: Path
    contacts: Float64  # (2, 3) [m]
    slide_m: float
    slide_range_m: tuple[float, float]


_COLUMNS = {
    "initial": "i1x i1y i1z i2x i2y i2z", "contacts": "g1x g1y g1z g2x g2y g2z", "axis": "axx axy axz", "centroid": "cx cy cz",
    "rotation": "r00 r01 r02 r10 r11 r12 r20 r21 r22", "score": "ranking",
}  # fmt: skip


def read_reference(data: Path) -> list[ReferenceRow]:
    """Return all rows of the original's output, in a folder next to the recordings."""
    rows = []
    for row in read_csv(data.parent / "reference" / "geograsp_reference.csv"):
        results = {name: np.array([float(row[column]) for column in words.split()]) for name, words in _COLUMNS.items()}
        results |= {name: results[name].reshape(-1, 3) for name in ("initial", "contacts", "rotation")}
        plane = Plane.from_coefficients([float(word) for word in row["plane"].split()])
        config = GeoGraspConfig(method="original", tip_mm=float(row["tip"]))
        cloud, counts = _folder(data, row) / "cloud-object.pcd", {name: int(row[name]) for name in COUNTS}
        rows.append(ReferenceRow(cloud, plane, config, counts, results, row["fallback"] == "1"))
    return rows


def read_executed(data: Path) -> list[ExecutedGrasp]:
    """Return the executed grasps, with the known interval of slides of each."""
    grasps = []
    for row in read_csv(data.parent / "reference" / "executed_slab_offsets.csv"):
        folder = _folder(data, row)
        numbers = (folder / "best-grasp.txt").read_text(encoding="utf-8").replace(",", " ").split()
        contacts = np.array([float(word) for word in numbers[:6]]).reshape(2, 3)
        limits = (float(row["delta_lo_m"]), float(row["delta_hi_m"]))
        grasps.append(ExecutedGrasp(folder / "cloud-object.pcd", contacts, float(row["delta_mid_m"]), limits))
    return grasps


def _folder(data: Path, row: dict[str, str]) -> Path:
    return data / "vision2tactile" / row["object"] / row["sample"]


def faults(row: ReferenceRow, plan: GraspPlan) -> list[str]:
    """Return the names of the differences from the original; `score_undefined` if the original score is not finite."""
    if plan.status == "no_grasp":
        return ["status"]
    best = plan.grasps[0]
    known = row.found
    score = float(row.found["score"][0])
    contacts = np.stack([best.g1, best.g2])
    # The original marks a grasp as initial by its points, so a ranked pair of the very same points is one too.
    at_initial = np.abs(contacts - plan.initial_points).max() < INITIAL_TOLERANCE_M
    # The axis is known up to its sign, which the rule leaves open in some side views: X and Y follow it, Z the contacts.
    sign = 1.0 if plan.axis @ known["axis"] > 0 else -1.0
    differs = {
        **{name: plan.counts[name] != count for name, count in row.counts.items()},
        "initial_points": np.abs(plan.initial_points - known["initial"]).max() > INITIAL_TOLERANCE_M,
        "grasp": np.linalg.norm(contacts - known["contacts"], axis=1).max() > GRASP_TOLERANCE_M,
        "status": row.is_initial != (plan.status == "initial_points" or at_initial),
        "score_undefined": not np.isfinite(score) and np.isnan(best.score),
        "score": np.isfinite(best.score) if not np.isfinite(score) else not abs(best.score - score) <= SCORE_TOLERANCE,
        "axis_sign": sign < 0,
        "axis": np.abs(sign * plan.axis - known["axis"]).max() > POSE_TOLERANCE,
        "centroid": np.abs(plan.centroid - known["centroid"]).max() > INITIAL_TOLERANCE_M * 2,
        "rotation": np.abs(best.rotation * [sign, sign, 1.0] - known["rotation"]).max() > POSE_TOLERANCE * 2
        or not np.array_equal(best.rotation, hand_rotation(best.g1, best.g2, plan.axis)),
    }
    return [name for name, there in differs.items() if there]


def compare_all(rows: list[ReferenceRow]) -> Counter[str]:
    """Return the number of rows with each difference."""
    differences: Counter[str] = Counter()
    for cloud, of_cloud in groupby(rows, lambda row: row.cloud):
        points = read_cloud(cloud)
        for row in of_cloud:
            differences.update(set(faults(row, plan_grasps(points, row.plane, row.config))))
    return differences


def reproduces(grasp: ExecutedGrasp, slide_m: float) -> bool:
    """Return whether the initial points of a grasp plane shifted by this are the executed contacts."""
    plan = plan_grasps(read_cloud(grasp.cloud), TOP_VIEW, GeoGraspConfig(method="original"), slide_m=slide_m)
    return plan.initial_points is not None and _are_executed(grasp, plan.initial_points)


def explaining_slide(grasp: ExecutedGrasp, n: int = 401) -> float | None:
    """Return the slide in the known interval, nearest to its middle, that reproduces the grasp; None if there is none."""
    config = GeoGraspConfig(method="original")
    xyz = read_cloud(grasp.cloud).xyz.reshape(-1, 3)
    xyz = xyz[inlier_mask(xyz, config.neighbours, config.outlier_deviations)]
    axis = find_axis(xyz, TOP_VIEW, config)
    slides = np.linspace(*grasp.slide_range_m, n)
    for slide in slides[np.argsort(np.abs(slides - grasp.slide_m), kind="stable")]:
        centre = axis.centroid + slide * axis.direction
        grasp_plane = find_grasp_plane(xyz, centre, axis.direction, axis.side, config.slab_half_width_m)
        if _are_executed(grasp, xyz[[grasp_plane.first, grasp_plane.second]]) and reproduces(grasp, float(slide)):
            return float(slide)
    return None


def _are_executed(grasp: ExecutedGrasp, points: npt.NDArray[np.floating]) -> bool:
    return bool(np.abs(points - grasp.contacts).max() <= EXECUTED_TOLERANCE_M)
