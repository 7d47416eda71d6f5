# SPDX-License-Identifier: Apache-2.0
"""GeoGrasp: from the cloud of an object and its table to ranked grasps.

GeoGrasp is Zapata-Impata et al., "Fast geometry-based computation of grasping points on three-dimensional point
clouds", 2019, reimplemented from a description of its public code. Differences: normals are computed only where a
candidate needs them; where the original's score divides by zero, the reason is reported instead; a pose that the rule
leaves open follows a documented convention; the grasp plane may be slid along the axis for variety, as in P2
(Zapata-Impata and Gil 2020); clouds of more points than any recorded one are downsampled
(`GeoGraspConfig.max_points`), which limits the planning time on near objects; and flying points are dropped where there
are more of them than in any recorded cloud (`GeoGraspConfig.flying_share`).
"""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from foretouch.cloud.geometry.limits import DEFAULT_LIMITS, ObjectLimits, check_object, check_table
from foretouch.cloud.geometry.pcl_filters import count_without_normal, mean_neighbour_distance
from foretouch.errors import CloudError, GraspError
from foretouch.grasp.axis import find_axis
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.hold import HeldGrasp, held_or_new
from foretouch.grasp.pose import hand_rotation, is_parallel
from foretouch.grasp.preprocessing import FinitePoints, finite_points
from foretouch.grasp.ranking import ContactSide, GraspPlane, contact_sides, find_grasp_plane, initial_score, rank_pairs
from foretouch.grasp.stable import StableRanking, object_frame, soft_extremes, stable_side, weigh_points
from foretouch.timing import timed
from foretouch.types import Cloud, Float32, Float64, Grasp, Integer, Plane

PlanStatus = Literal["ok", "initial_points", "no_grasp"]


@dataclass(eq=False)
class GraspPlan:
    """The grasps of one object, with the intermediate results of GeoGrasp, None where planning failed before.

    The first grasp of method "stable" is the mean of the best pairs, whatever the scores of single pairs, which follow.
    With the status "initial_points", no pair of candidates passes, and the only grasp is that of the initial points.
    """

    status: PlanStatus = "no_grasp"
    reason: str = ""  # explanation of the status
    grasps: tuple[Grasp, ...] = ()  # best first
    initial_points: Float64 | None = None  # (2, 3) float64 [m], the extremes near the grasp plane
    axis: Float64 | None = None  # (3,) float64, the object's axis
    centroid: Float64 | None = None  # (3,) float64 [m], of the object
    axis_ratio: float | None = None  # middle over major eigenvalue; near 1, as on a ball, the axis is arbitrary
    slide_m: float = 0.0  # shift of the grasp plane along the axis [m]
    outdone: int = 0  # number of clouds in a row on which another grasp was better than the held one
    counts: dict[str, int] = field(default_factory=dict)  # points, candidates and pairs after each stage, by name
    ms: dict[str, float] = field(default_factory=dict)  # wall time of each stage and their `total` [ms]


def plan_grasps(
    cloud: Cloud,
    plane: Plane,
    config: GeoGraspConfig,
    *,
    slide_m: float = 0.0,
    rng: np.random.Generator | None = None,
    pixels: Integer | None = None,
    image_shape: tuple[int, int] | None = None,
    limits: ObjectLimits = DEFAULT_LIMITS,
    held: HeldGrasp | None = None,
    hold: float = 0.0,
) -> GraspPlan:
    """Plan two-finger contacts on an object, best first, with the pose of the hand at each.

    The same cloud results in the same plan, whether its pixels are known or not.

    Args:
        cloud: The object's points, organised or not, in a frame with the sensor at the origin.
            Points that are not finite are ignored and counted.
        plane: The table, in the cloud's frame.
        config: Settings; at most `config.count` grasps are returned.
        slide_m: Shift of the grasp plane along the object's axis [m] (variety as in P2).
        rng: Draws `slide_m` from a part of the object's extent (`config.slide_fraction`) instead.
        pixels: (N,) integer, for an unorganised cloud cut from an image: flat index of each point into it.
        image_shape: (H, W) of that image.
        limits: Range and size of objects; others have no grasp.
        held: Best grasp of this object in the previous cloud of a stream; method "stable" returns it again unless
            another one is better by more than `hold`, on three clouds in a row. Its own axis counts if it is as good an
            axis of the present cloud.
        hold: In units of the score.

    Returns:
        The plan. If the cloud allows no grasp, its status is "no_grasp" and it contains the reason.

    Raises:
        CloudError: If `pixels` do not belong to the cloud.
        GraspError: If `slide_m` is not finite, or is given together with `rng`.
    """
    if not math.isfinite(slide_m):
        raise GraspError(f"slide_m: {slide_m} is not finite")
    if rng is not None and slide_m != 0.0:
        raise GraspError(f"slide_m, rng: a slide of {slide_m} m and a random one exclude each other")
    points = finite_points(cloud, pixels, image_shape)
    plan = GraspPlan(slide_m=slide_m, counts={"n_points": cloud.size, "n_dropped": points.n_dropped})
    try:
        check_table(plane, limits)
        if config.method == "stable":
            _plan_stable(plan, points, plane, config, rng, limits, None if held is None else (held, hold))
        else:
            _plan_original(plan, points, plane, config, rng, limits)
    except CloudError as err:
        plan.reason = str(err)
    plan.ms["total"] = sum(plan.ms.values())
    return plan


def _random_slide(xyz: Float32, centroid: Float64, axis: Float64, fraction: float, rng: np.random.Generator) -> float:
    """A shift of the grasp plane [m], uniform over a fraction of the object's extent on either side of the centroid (P2)."""
    along = (xyz.astype(np.float64) - centroid) @ axis
    return float(rng.uniform(fraction * along.min(), fraction * along.max()))


def _plan_original(
    plan: GraspPlan,
    points: FinitePoints,
    plane: Plane,
    config: GeoGraspConfig,
    rng: np.random.Generator | None,
    limits: ObjectLimits,
) -> None:
    counts = plan.counts
    with timed(plan.ms, "outliers"):
        downsampled = points.downsampled(config)
        check_object(points.xyz, limits)
        counts["n_thinned"] = len(points.xyz) - len(downsampled.xyz)
        xyz = downsampled.without_flying(config, counts).without_outliers(config)
        counts["n_filtered"] = len(xyz)
    with timed(plan.ms, "axis"):
        found = find_axis(xyz, plane, config)
        plan.axis, plan.centroid, plan.axis_ratio = found.direction, found.centroid, found.ratio
        counts["n_voxel"] = len(found.grid.counts)
        counts["n_nan_normals"] = count_without_normal(xyz, config.normal_radius_m)
    with timed(plan.ms, "slab"):
        if rng is not None:
            plan.slide_m = _random_slide(xyz, found.centroid, found.direction, config.slide_fraction, rng)
        centre = found.centroid + plan.slide_m * found.direction
        grasp_plane = find_grasp_plane(xyz, centre, found.direction, found.side, config.slab_half_width_m)
        counts["n_plane"] = grasp_plane.n_points
        plan.initial_points = xyz[[grasp_plane.first, grasp_plane.second]].astype(np.float64)
    with timed(plan.ms, "candidates"):
        sides = contact_sides(xyz, grasp_plane, config)
        counts["n_first"], counts["n_second"] = (side.n_points for side in sides)
        counts["n_fv"], counts["n_sv"] = (len(side.candidates.xyz) for side in sides)
    _best_grasps(plan, sides, grasp_plane, found.centroid, config.count)


def _best_grasps(
    plan: GraspPlan, sides: tuple[ContactSide, ContactSide], grasp_plane: GraspPlane, centroid: Float64, count: int
) -> None:
    """The best ranked pairs, or the initial points if no pair passes the filters."""
    with timed(plan.ms, "ranking"):
        ranking = rank_pairs(sides, grasp_plane, centroid)
        plan.counts.update(ranking.counts)
        ranked, pairs = len(ranking.score), ranking.counts["n_pairs"]
        score, unscored = (0.0, "") if ranked else initial_score(sides, grasp_plane, centroid)
    with timed(plan.ms, "pose"):
        if ranked:
            best = zip(ranking.first[:count], ranking.second[:count], ranking.score[:count], strict=True)
            contacts = [(sides[0].candidates.xyz[a], sides[1].candidates.xyz[b], float(s)) for a, b, s in best]
            reason = f"{ranked} of {pairs} pairs of candidates pass the filters"
        else:
            contacts = [(sides[0].initial.xyz[0], sides[1].initial.xyz[0], score)]
            reason = f"grasp at the initial points: none of {pairs} pairs of candidates passes the filters"
        axis = grasp_plane.normal
        plan.grasps = tuple(Grasp(g1, g2, hand_rotation(g1, g2, axis), s) for g1, g2, s in contacts)
        parallel = sum(is_parallel(g.g1, g.g2, axis) for g in plan.grasps)
    notes = [reason, unscored] if unscored else [reason]
    if parallel:
        notes.append(f"{parallel} grasps run along the object's axis: their X follows a coordinate axis by convention")
    plan.status, plan.reason = "ok" if ranked else "initial_points", "; ".join(notes)


def _plan_stable(
    plan: GraspPlan,
    points: FinitePoints,
    plane: Plane,
    config: GeoGraspConfig,
    rng: np.random.Generator | None,
    limits: ObjectLimits,
    held: tuple[HeldGrasp, float] | None,
) -> None:
    """The method `stable` (see `foretouch.grasp.stable`), with the held grasp and the margin that keeps it."""
    counts = plan.counts
    with timed(plan.ms, "outliers"):
        downsampled = points.downsampled(config, sort=True)
        check_object(points.xyz, limits)
        counts["n_thinned"] = len(points.xyz) - len(downsampled.xyz)
        downsampled = downsampled.without_flying(config, counts)
        weighted = weigh_points(downsampled.xyz, mean_neighbour_distance(downsampled.xyz, config.neighbours), config)
        counts["n_filtered"] = int(np.count_nonzero(weighted.inlier > 0.0))
        counts["n_isolated"] = weighted.n_isolated
    with timed(plan.ms, "axis"):
        frame = object_frame(weighted, plane)
        plan.axis, plan.centroid, plan.axis_ratio = frame.axis, frame.centroid, frame.ratio
    with timed(plan.ms, "slab"):
        if rng is not None:
            kept = downsampled.xyz[weighted.inlier > 0.0]
            plan.slide_m = _random_slide(kept, frame.centroid, frame.axis, config.slide_fraction, rng)
        initial, counts["n_plane"] = soft_extremes(weighted, frame, plan.slide_m, config.slab_half_width_m)
        plan.initial_points = initial
    with timed(plan.ms, "candidates"):
        width = float(np.linalg.norm(initial[1] - initial[0]))
        first, second = (stable_side(weighted, one, frame, width, config) for one in initial)
        counts["n_first"], counts["n_second"] = first.n_points, second.n_points
        counts["n_fv"], counts["n_sv"] = len(first.xyz) - 1, len(second.xyz) - 1
    with timed(plan.ms, "ranking"):
        ranking = StableRanking(weighted, (first, second), frame, plan.slide_m, config.normal_radius_m)
        pairs = ranking.pairs()
        score, passes = ranking.score(pairs.contacts)
        counts["n_pairs"], counts["n_pairs_ranked"] = pairs.score.size, int(np.count_nonzero(pairs.passes))
    with timed(plan.ms, "pose"):
        g1, g2 = pairs.contacts
        best = Grasp(g1, g2, hand_rotation(g1, g2, frame.axis), score)
        if held is not None:
            last, margin = held
            held_score, held_passes = ranking.score_held(last)
            best, plan.outdone = held_or_new(last, held_score, best, margin)
            passes = held_passes if best.g1 is last.grasp.g1 else passes
        others = []
        if passes:
            order = np.argsort(-np.where(pairs.passes, pairs.score, -np.inf), axis=None, kind="stable")
            i, j = np.unravel_index(order[: min(config.count - 1, counts["n_pairs_ranked"])], pairs.score.shape)
            others = [(first.xyz[a], second.xyz[b], float(pairs.score[a, b])) for a, b in zip(i, j, strict=True)]
        plan.grasps = (best, *(Grasp(g1, g2, hand_rotation(g1, g2, frame.axis), s) for g1, g2, s in others))
    plan.status, plan.reason = "ok", f"mean of {counts['n_pairs']} weighted pairs of candidates"
    if not passes:
        plan.status, plan.reason = "initial_points", f"{plan.reason}, which passes no filter of a ranked pair"
