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
from typing import Literal, TypedDict, Unpack

import numpy as np

from foretouch.cloud.geometry.limits import DEFAULT_LIMITS, ObjectLimits, check_object, check_table
from foretouch.cloud.geometry.pcl_filters import count_without_normal, mean_neighbour_distance
from foretouch.cloud.timing import timed
from foretouch.errors import CloudError, FrameError, GraspError
from foretouch.grasp.axis import find_axis
from foretouch.grasp.carry import CANNOT_CARRY
from foretouch.grasp.completed import (
    COMPLETED_POINTS,
    MAY_NOT_FIT,
    SCORE_OF_NONE,
    CompletedObject,
    as_in_image,
    best_grasps,
    blocking_objects,
    why_no_line,
)
from foretouch.grasp.config import DEFAULT_HAND, CarriedConfig, GeoGraspConfig, HandConfig
from foretouch.grasp.frame import object_frame, weigh_points
from foretouch.grasp.hold import APART_M, HeldGrasp, keep_held
from foretouch.grasp.outline import SeenOutline
from foretouch.grasp.pose import hand_rotation, is_parallel
from foretouch.grasp.preprocessing import FinitePoints, finite_points
from foretouch.grasp.ranking import ContactSide, GraspPlane, contact_sides, find_grasp_plane, initial_score, rank_pairs
from foretouch.grasp.unseen import BESIDE_UNSEEN, DepthAround
from foretouch.types import NO_GRASPS, Cloud, Float32, Float64, Grasp, Grasps, Integer, Plane
from foretouch.types.arrays import objects
from foretouch.types.scene import Object, Obstacles
from foretouch.types.summary import Summarised

PlanStatus = Literal["ok", "initial_points", "no_grasp", "unknown_frame"]


@dataclass(eq=False, repr=False)
class GraspPlan(Summarised):
    """The grasps of one object, with the intermediate results of GeoGrasp, None where planning failed before.

    With the status "initial_points", of method "original" alone, no pair of candidates passes, and the only grasp is that
    of the initial points.
    """

    status: PlanStatus = "no_grasp"
    reason: str = ""  # explanation of the status
    grasps: Grasps = NO_GRASPS  # best first
    initial_points: Float64 | None = (
        None  # (2, 3) float64 [m], extremes near the grasp plane; `completed`: its contacts
    )
    axis: Float64 | None = None  # (3,) float64, the object's axis
    centroid: Float64 | None = None  # (3,) float64 [m], of the object
    slide_m: float = 0.0  # shift of the grasp plane along the axis [m]
    lost: float = 0.0  # score of the best grasp that other objects cost; infinite if they block all ("completed" only)
    blocked_by: tuple[int, ...] = ()  # ids of the objects that block some grasps, ascending
    outdone: int = 0  # number of clouds in a row on which another grasp was better than the held one
    counts: dict[str, int] = field(default_factory=dict)  # points, candidates and pairs after each stage, by name
    ms: dict[str, float] = field(default_factory=dict)  # wall time of each stage and their `total` [ms]


class PlanOptions(TypedDict, total=False):
    """What a plan takes besides the object, by name; each may be absent."""

    slide_m: float  # shift of the grasp plane along the object's axis [m] (variety as in P2); by default 0
    rng: np.random.Generator | None  # draws `slide_m` from a part of the object's extent (`slide_fraction`) instead
    pixels: Integer | None  # (N,) integer, for an unorganised cloud cut from an image: flat index of each point into it
    image_shape: tuple[int, int] | None  # (H, W) of that image
    object_id: str  # that the grasps name; by default none
    limits: ObjectLimits  # range and size of objects; others have no grasp
    # Best grasp of this object in the previous cloud of a stream. Method "completed" returns it again, first and in the place
    # of its twin, unless another one is better by more than `hold`, on three clouds in a row.
    held: HeldGrasp | None
    hold: float  # in units of the score; by default 0
    hand: HandConfig  # what the hand can execute; method "completed" only
    carried: CarriedConfig  # what is known of the object besides; method "completed" only
    obstacles: Obstacles | None  # what stands around the object; method "completed" only
    around: DepthAround | None  # the depth image around the object; method "completed" only


def plan_grasps(cloud: Cloud, plane: Plane, config: GeoGraspConfig, **options: Unpack[PlanOptions]) -> GraspPlan:
    """Plan two-finger contacts on an object, best first, with the pose of the hand at each.

    The same cloud results in the same plan, whether its pixels are known or not.

    Args:
        cloud: The object's points, organised or not, with the sensor at the origin; those not finite are counted.
        plane: The table, in the cloud's frame.
        config: Settings; at most `config.count` grasps are returned.
        options: See `PlanOptions`, such as `hand=HandConfig(name="franka_hand")`.

    Returns:
        The plan. Without a grasp it has the reason and the status "no_grasp", or "unknown_frame" off an optical frame.

    Raises:
        CloudError: If `pixels` do not belong to the cloud.
        GraspError: If `slide_m` is not finite, or is given together with `rng`.
    """
    slide_m, rng = options.get("slide_m", 0.0), options.get("rng")
    if not math.isfinite(slide_m):
        raise GraspError(f"slide_m: {slide_m} is not finite")
    if rng is not None and slide_m != 0.0:
        raise GraspError(f"slide_m, rng: a slide of {slide_m} m and a random one exclude each other")
    points = finite_points(cloud, options.get("pixels"), options.get("image_shape"))
    plan = GraspPlan(slide_m=slide_m, counts={"n_points": cloud.size, "n_dropped": points.n_dropped})
    limits = options.get("limits", DEFAULT_LIMITS)
    try:
        check_object(points.xyz, limits)
        check_table(plane, limits, points.xyz)
        if config.method == "completed":
            _plan_completed(plan, points, plane, config, options)
        else:
            _plan_original(plan, points, plane, config, rng)
    except CloudError as err:
        plan.reason = str(err)
        plan.status = "unknown_frame" if isinstance(err, FrameError) else "no_grasp"
    plan.ms["total"] = sum(plan.ms.values())
    plan.grasps = plan.grasps.replace(status=plan.status, reason=plan.reason, object_id=options.get("object_id", ""))
    return plan


def _random_slide(xyz: Float32, centroid: Float64, axis: Float64, fraction: float, rng: np.random.Generator) -> float:
    """Return a shift of the grasp plane [m], uniform over a fraction of the object's extent on either side of the centroid (P2)."""
    along = (xyz.astype(np.float64) - centroid) @ axis
    return float(rng.uniform(fraction * along.min(), fraction * along.max()))


def _plan_original(
    plan: GraspPlan, points: FinitePoints, plane: Plane, config: GeoGraspConfig, rng: np.random.Generator | None
) -> None:
    counts = plan.counts
    with timed(plan.ms, "outliers"):
        downsampled = points.downsampled(config)
        counts["n_thinned"] = len(points.xyz) - len(downsampled.xyz)
        xyz = downsampled.without_flying(config, counts).without_outliers(config)
        counts["n_filtered"] = len(xyz)
    with timed(plan.ms, "axis"):
        axis = find_axis(xyz, plane, config)
        plan.axis, plan.centroid = axis.direction, axis.centroid
        counts["n_voxel"] = len(axis.cells[1])
        counts["n_nan_normals"] = count_without_normal(xyz, config.normal_radius_m)
    with timed(plan.ms, "slab"):
        if rng is not None:
            plan.slide_m = _random_slide(xyz, axis.centroid, axis.direction, config.slide_fraction, rng)
        centre = axis.centroid + plan.slide_m * axis.direction
        grasp_plane = find_grasp_plane(xyz, centre, axis.direction, axis.side, config.slab_half_width_m)
        counts["n_plane"] = grasp_plane.n_points
        plan.initial_points = xyz[[grasp_plane.first, grasp_plane.second]].astype(np.float64)
    with timed(plan.ms, "candidates"):
        sides = contact_sides(xyz, grasp_plane, config)
        counts["n_first"], counts["n_second"] = (side.n_points for side in sides)
        counts["n_fv"], counts["n_sv"] = (len(side.candidates.xyz) for side in sides)
    _best_grasps(plan, sides, grasp_plane, axis.centroid, config.count)


def _best_grasps(
    plan: GraspPlan, sides: tuple[ContactSide, ContactSide], grasp_plane: GraspPlane, centroid: Float64, count: int
) -> None:
    """Return the best ranked pairs, or the initial points if no pair passes the filters."""
    with timed(plan.ms, "ranking"):
        first, second, scores, counts = rank_pairs(sides, grasp_plane, centroid)
        plan.counts.update(counts)
        ranked, pairs = len(scores), counts["n_pairs"]
        score, unscored = (0.0, "") if ranked else initial_score(sides, grasp_plane, centroid)
    with timed(plan.ms, "pose"):
        if ranked:
            best = zip(first[:count], second[:count], scores[:count], strict=True)
            contacts = [(sides[0].candidates.xyz[a], sides[1].candidates.xyz[b], float(s)) for a, b, s in best]
            reason = f"{ranked} of {pairs} pairs of candidates pass the filters"
        else:
            contacts = [(sides[0].initial.xyz[0], sides[1].initial.xyz[0], score)]
            reason = f"grasp at the initial points: none of {pairs} pairs of candidates passes the filters"
        axis = grasp_plane.normal
        plan.grasps = Grasps.of([Grasp(g1, g2, hand_rotation(g1, g2, axis), s) for g1, g2, s in contacts])
        parallel = sum(is_parallel(g.g1, g.g2, axis) for g in plan.grasps)
    notes = [reason, unscored] if unscored else [reason]
    if parallel:
        notes.append(f"{parallel} grasps run along the object's axis: their X follows a coordinate axis by convention")
    plan.status, plan.reason = "ok" if ranked else "initial_points", "; ".join(notes)


def unseen_side(target: Object) -> Float64:
    """Estimate the side of an object that the camera does not see, as the planner does.

    Args:
        target: The object.

    Returns:
        (M, 3) float64 [m], points of it, camera frame; none where nothing is estimated.
    """
    points, config = finite_points(target.cloud), GeoGraspConfig()
    try:
        xyz = points.every_kth_pixel(COMPLETED_POINTS).without_flying(config, {}).xyz
        spacing = mean_neighbour_distance(xyz, config.neighbours)
        known = weigh_points(xyz, spacing, config), spacing, target.plane
        return CompletedObject(*known, DEFAULT_HAND, None, np.zeros(3), config.neighbours).hidden
    except CloudError:
        return np.empty((0, 3))


def _plan_completed(
    plan: GraspPlan, points: FinitePoints, plane: Plane, config: GeoGraspConfig, options: PlanOptions
) -> None:
    """Plan by the method of `foretouch.grasp.completed`."""
    counts = plan.counts
    rng, held = options.get("rng"), options.get("held")
    hand, obstacles = options.get("hand", DEFAULT_HAND), options.get("obstacles")
    with timed(plan.ms, "outliers"):
        downsampled = points.every_kth_pixel(min(config.max_points or COMPLETED_POINTS, COMPLETED_POINTS))
        xyz = downsampled.without_flying(config, counts).xyz
        counts["n_thinned"] = len(points.xyz) - len(downsampled.xyz)
        spacing = mean_neighbour_distance(xyz, config.neighbours)
        weighted = weigh_points(xyz, spacing, config)
        counts["n_filtered"] = int(np.count_nonzero(weighted.inlier > 0.0))
        counts["n_isolated"] = weighted.n_isolated
    with timed(plan.ms, "axis"):
        plan.centroid, axis = object_frame(weighted, plane)
        plan.axis = axis
        if rng is not None:
            kept = xyz[weighted.inlier > 0.0]
            plan.slide_m = _random_slide(kept, plan.centroid, axis, config.slide_fraction, rng)
    with timed(plan.ms, "completion"):
        around = options.get("around")
        outline, shift = SeenOutline.of(points, around), plan.slide_m * axis
        completed = CompletedObject(
            *(weighted, spacing, plane, hand, obstacles, shift), neighbours=config.neighbours, outline=outline
        )
        counts["n_completed"] = completed.n_completed
    with timed(plan.ms, "candidates"):
        lines = free = completed.lines()
        if around is not None:
            lines = completed.beside_unseen(free, around)
        counts |= lines.counts
        plan.lost, plan.blocked_by = lines.lost, blocking_objects(lines, obstacles)
    with timed(plan.ms, "ranking"):
        best = best_grasps(completed, lines, config.count + (held is not None))  # one may be the twin of the held
        counts |= lines.counts
        plan.grasps = Grasps.of(
            [Grasp(g1, g2, hand_rotation(g1, g2, axis), SCORE_OF_NONE - cost, way=way) for (g1, g2), way, cost in best]
        )
        if held is not None and plan.grasps:
            way, _ = completed.way_in(*as_in_image(held[0]))
            cost = float(lines.cost[completed.nearest_line(held[0])])
            cost += np.inf if way is None else completed.tightness(way)
            held_score = SCORE_OF_NONE - min(cost, 2.0 * SCORE_OF_NONE)  # finite, also where it is refused now
            grasps, plan.outdone = keep_held(held, held_score, plan.grasps, options.get("hold", 0.0))
            plan.grasps = grasps[: config.count]
        looked_at = lines is not free or len(plan.grasps) > 1 or held is not None
        plan.grasps = _flagged(plan.grasps, completed, around if looked_at else None, options)
    if plan.grasps:
        plan.initial_points = np.stack([plan.grasps.g1[0], plan.grasps.g2[0]])
        plan.status, plan.reason = "ok", f"the best of {counts['n_free']} possible grasps ({counts['n_lines']} tried)"
        if len(plan.grasps) < config.count:
            near = f"all others are within {APART_M * 1e3:g} mm of one of these"
            plan.reason += f"; {len(plan.grasps)} grasps instead of {config.count}: {near}"
    else:
        plan.reason = why_no_line(lines, hand, obstacles)


def _flagged(grasps: Grasps, completed: CompletedObject, around: DepthAround | None, options: PlanOptions) -> Grasps:
    """Return grasps with the flags of those that may not fit the hand, have a contact beside pixels without depth, or cannot carry the object."""
    if not grasps:
        return grasps
    hand, carried = options.get("hand", DEFAULT_HAND), options.get("carried", CarriedConfig())
    mass_kg, none = carried.mass_kg, len(grasps) * [False]
    marks = {
        MAY_NOT_FIT: [way.width_at_most_m > hand.opening for way in grasps.way],
        BESIDE_UNSEEN: none if around is None else around.beside(grasps.g1, grasps.g2) > 0.0,
        CANNOT_CARRY: none
        if mass_kg is None
        else [completed.strain(one, mass_kg, carried.friction) > 1.0 for one in grasps],
    }
    flags = [tuple(flag for flag, which in marks.items() if which[k]) for k in range(len(grasps))]
    return grasps if flags == grasps.flags.tolist() else grasps.replace(flags=objects(flags))
