# SPDX-License-Identifier: Apache-2.0
"""Comparison with the original C++ GeoGrasp and with grasps that a robot executed."""

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.pcl_filters import inlier_mask
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, GraspPlan, hand_rotation, plan_grasps
from foretouch.grasp.axis import find_axis
from foretouch.grasp.ranking import find_grasp_plane
from foretouch.types import Cloud, Float64, Plane

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

    name: str
    cloud: Path
    plane: Plane
    tip_mm: float
    counts: dict[str, int]
    initial_points: Float64  # (2, 3) [m]
    contacts: Float64  # (2, 3) [m]
    score: float
    rotation: Float64  # (3, 3)
    axis: Float64  # (3,)
    centroid: Float64  # (3,) [m]
    is_initial: bool

    @property
    def config(self) -> GeoGraspConfig:
        """The settings of that run."""
        return GeoGraspConfig(method="original", tip_mm=self.tip_mm)


@dataclass(frozen=True, eq=False)
class ExecutedGrasp:
    """A grasp that the robot executed, and the slides of the grasp plane that explain it."""

    cloud: Path
    contacts: Float64  # (2, 3) [m]
    slide_m: float
    slide_range_m: tuple[float, float]


def read_reference(data: Path) -> list[ReferenceRow]:
    """All rows of the original's output, in a folder next to the recordings."""
    path = data.parent / "reference" / "geograsp_reference.csv"
    with path.open(encoding="utf-8", newline="") as stream:
        return [_reference_row(row, data) for row in csv.DictReader(stream)]


def read_executed(data: Path) -> list[ExecutedGrasp]:
    """The executed grasps, with the known interval of slides of each."""
    path = data.parent / "reference" / "executed_slab_offsets.csv"
    grasps = []
    with path.open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            folder = data / "vision2tactile" / row["object"] / row["sample"]
            numbers = (folder / "best-grasp.txt").read_text(encoding="utf-8").replace(",", " ").split()
            contacts = np.array([float(word) for word in numbers[:6]]).reshape(2, 3)
            limits = (float(row["delta_lo_m"]), float(row["delta_hi_m"]))
            grasps.append(ExecutedGrasp(folder / "cloud-object.pcd", contacts, float(row["delta_mid_m"]), limits))
    return grasps


def faults(row: ReferenceRow, plan: GraspPlan) -> list[str]:
    """Names of the differences from the original; `score_undefined` if the original score is not finite."""
    if plan.status == "no_grasp":
        return ["status"]
    best = plan.grasps[0]
    contacts = np.stack([best.g1, best.g2])
    found = [name for name in COUNTS if plan.counts[name] != row.counts[name]]
    if np.abs(plan.initial_points - row.initial_points).max() > INITIAL_TOLERANCE_M:
        found.append("initial_points")
    if np.linalg.norm(contacts - row.contacts, axis=1).max() > GRASP_TOLERANCE_M:
        found.append("grasp")
    # The original marks a grasp as initial by its points, so a ranked pair of the very same points is one too.
    at_initial = np.abs(contacts - plan.initial_points).max() < INITIAL_TOLERANCE_M
    if row.is_initial != (plan.status == "initial_points" or at_initial):
        found.append("status")
    if not np.isfinite(row.score):
        found.append("score_undefined" if np.isnan(best.score) else "score")
    elif not abs(best.score - row.score) <= SCORE_TOLERANCE:
        found.append("score")
    return found + _pose_faults(row, plan)


def _pose_faults(row: ReferenceRow, plan: GraspPlan) -> list[str]:
    """Axis and rotation, up to the sign of the axis, which the rule leaves open in some side views."""
    sign = 1.0 if plan.axis @ row.axis > 0 else -1.0
    best = plan.grasps[0]
    found = [] if sign > 0 else ["axis_sign"]
    if np.abs(sign * plan.axis - row.axis).max() > POSE_TOLERANCE:
        found.append("axis")
    if np.abs(plan.centroid - row.centroid).max() > INITIAL_TOLERANCE_M * 2:
        found.append("centroid")
    turned = best.rotation * np.array([sign, sign, 1.0])  # X and Y follow the axis, Z the contacts
    if np.abs(turned - row.rotation).max() > POSE_TOLERANCE * 2:
        found.append("rotation")
    if not np.array_equal(best.rotation, hand_rotation(best.g1, best.g2, plan.axis)):
        found.append("rotation")
    return found


def compare_all(rows: list[ReferenceRow]) -> Counter[str]:
    """Number of rows with each difference."""
    clouds: dict[Path, Cloud] = {}
    found: Counter[str] = Counter()
    for row in rows:
        if row.cloud not in clouds:
            clouds = {row.cloud: read_cloud(row.cloud)}  # rows of one cloud follow each other
        found.update(set(faults(row, plan_grasps(clouds[row.cloud], row.plane, row.config))))
    return found


def reproduces(grasp: ExecutedGrasp, slide_m: float) -> bool:
    """Whether the initial points of a grasp plane shifted by this are the executed contacts."""
    plan = plan_grasps(read_cloud(grasp.cloud), TOP_VIEW, GeoGraspConfig(method="original"), slide_m=slide_m)
    return plan.initial_points is not None and _are_executed(grasp, plan.initial_points)


def explaining_slide(grasp: ExecutedGrasp, n: int = 401) -> float | None:
    """The slide in the known interval, nearest to its middle, that reproduces the grasp; None if there is none."""
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


def _reference_row(row: dict[str, str], data: Path) -> ReferenceRow:
    def vector(*names: str) -> Float64:
        return np.array([float(row[name]) for name in names])

    return ReferenceRow(
        name=f"{row['object']}/{row['sample']} plane {row['plane']} tip {row['tip']}",
        cloud=data / "vision2tactile" / row["object"] / row["sample"] / "cloud-object.pcd",
        plane=Plane.from_coefficients([float(word) for word in row["plane"].split()]),
        tip_mm=float(row["tip"]),
        counts={name: int(row[name]) for name in COUNTS},
        initial_points=vector("i1x", "i1y", "i1z", "i2x", "i2y", "i2z").reshape(2, 3),
        contacts=vector("g1x", "g1y", "g1z", "g2x", "g2y", "g2z").reshape(2, 3),
        score=float(row["ranking"]),
        rotation=vector(*(f"r{i}{j}" for i in range(3) for j in range(3))).reshape(3, 3),
        axis=vector("axx", "axy", "axz"),
        centroid=vector("cx", "cy", "cz"),
        is_initial=row["fallback"] == "1",
    )
