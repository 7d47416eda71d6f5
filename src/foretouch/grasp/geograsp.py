# SPDX-License-Identifier: Apache-2.0
"""GeoGrasp, the whole road: from an object's cloud and its table to ranked grasps.

GeoGrasp = Zapata-Impata et al., "Fast geometry-based computation of grasping points on
three-dimensional point clouds", 2019, written anew from a description of its public code. Departures:
normals are computed where a candidate needs them and nowhere else; where the original's score divides by
zero the case is named; a pose that the rule leaves open follows a stated convention; the slab may be slid along
the axis for variety, as in P2 (Zapata-Impata and Gil 2020); and clouds of more points than any recorded one are
thinned (`GeoGraspConfig.max_points`), so that a near object is planned on in time.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.normals import count_without_normal
from foretouch.cloud.geometry.outliers import inlier_mask
from foretouch.errors import CloudError, GraspError
from foretouch.grasp.axis import find_axis, side_coordinate
from foretouch.grasp.candidates import Slab, Spots, candidate_spots, contact_radius, grasp_slab
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.plan import GraspPlan, PlanLog
from foretouch.grasp.points import UsablePoints, usable_points
from foretouch.grasp.pose import hand_rotation, is_parallel
from foretouch.grasp.ranking import initial_score, rank_pairs
from foretouch.types import Cloud, Float32, Float64, Grasp, Plane

__all__ = ["plan_grasps", "random_slide"]


def plan_grasps(
    cloud: Cloud,
    plane: Plane,
    config: GeoGraspConfig,
    *,
    slide_m: float = 0.0,
    rng: np.random.Generator | None = None,
    pixels: npt.NDArray[np.integer] | None = None,
    image_shape: tuple[int, int] | None = None,
) -> GraspPlan:
    """Contacts for two fingers on an object, best first, with the pose of the hand at each.

    The same cloud gives the same plan, whether its pixels are known or not.

    Args:
        cloud: The object's points, organised or not, in a frame with the sensor at the origin.
            Points that are not finite are left out and counted.
        plane: The table, in the cloud's frame.
        config: Settings; `config.count` grasps are returned at most.
        slide_m: How far to move the grasp plane along the object's axis [m] (P2's variety).
        rng: Draws `slide_m` from the object's extent instead; see `random_slide`.
        pixels: (N,) integer, for an unorganised cloud cut from an image: flat index of each point into it.
        image_shape: (H, W) of that image.

    Returns:
        The plan. A cloud that allows no grasp gives one with status "no_grasp" and the reason.

    Raises:
        CloudError: If `pixels` do not belong to the cloud.
        GraspError: If `slide_m` is not finite, or is given together with `rng`.
    """
    if not math.isfinite(slide_m):
        raise GraspError(f"slide_m: {slide_m} is not finite")
    if rng is not None and slide_m != 0.0:
        raise GraspError(f"slide_m, rng: a slide of {slide_m} m and one to be drawn")
    points = usable_points(cloud, pixels, image_shape)
    log = PlanLog(slide_m=slide_m, counts={"n_points": cloud.size, "n_dropped": points.n_dropped})
    try:
        return _plan(points, plane, config, rng, log)
    except CloudError as err:
        return log.plan("no_grasp", str(err))


def random_slide(xyz: Float32, centroid: Float64, axis: Float64, fraction: float, rng: np.random.Generator) -> float:
    """A shift of the grasp plane, uniform over the middle part of the object's extent along its axis (P2).

    Args:
        xyz: (N, 3) float32 [m], the filtered cloud, N > 0.
        centroid: (3,) float64 [m], from where the shift counts.
        axis: (3,) float64, unit length.
        fraction: Part of the extent on either side of the centroid that is used, 0 ... 1.
        rng: Source of randomness.

    Returns:
        The shift [m].
    """
    along = (xyz.astype(np.float64) - centroid) @ axis
    return float(rng.uniform(fraction * along.min(), fraction * along.max()))


def _plan(
    points: UsablePoints, plane: Plane, config: GeoGraspConfig, rng: np.random.Generator | None, log: PlanLog
) -> GraspPlan:
    with log.stage("outliers"):
        points.require_usable()
        n_usable = len(points.xyz)
        points = points.thinned(config.max_points)
        log.counts["n_thinned"] = n_usable - len(points.xyz)
        xyz = points.xyz[inlier_mask(points.xyz, config.neighbours, config.outlier_deviations, points.pixel_grid())]
        log.counts["n_filtered"] = len(xyz)
    with log.stage("axis"):
        found = find_axis(xyz, plane, config)
        log.axis, log.centroid, log.axis_ratio = found.direction, found.centroid, found.ratio
        log.counts["n_voxel"] = len(found.grid.counts)
        log.counts["n_nan_normals"] = count_without_normal(xyz, config.normal_radius_m, found.grid)
    with log.stage("slab"):
        if rng is not None:
            log.slide_m = random_slide(xyz, found.centroid, found.direction, config.slide_fraction, rng)
        centre = found.centroid + log.slide_m * found.direction
        side = side_coordinate(found.direction, plane)
        slab = grasp_slab(xyz, centre, found.direction, side, config.slab_half_width_m)
        log.counts["n_plane"] = slab.n_points
        log.initial_points = xyz[[slab.first, slab.second]].astype(np.float64)
    with log.stage("candidates"):
        radius = contact_radius(slab.width_m, config)
        first, p1, log.counts["n_first"] = candidate_spots(xyz, slab.first, radius, config)
        second, p2, log.counts["n_second"] = candidate_spots(xyz, slab.second, radius, config)
        log.counts["n_fv"], log.counts["n_sv"] = len(first.xyz), len(second.xyz)
    return _choose((first, second), (p1, p2), slab, found.centroid, config.count, log)


def _choose(
    sides: tuple[Spots, Spots],
    initials: tuple[Spots, Spots],
    slab: Slab,
    centroid: Float64,
    count: int,
    log: PlanLog,
) -> GraspPlan:
    """The best ranked pairs, or the initial points where none ranks."""
    with log.stage("ranking"):
        ranking = rank_pairs(sides, initials, slab, centroid)
        log.counts.update(ranking.counts)
        ranked = len(ranking.score)
        score, unscored = (0.0, "") if ranked else initial_score(sides, initials, slab, centroid)
    with log.stage("pose"):
        if ranked:
            contacts = [
                (sides[0].xyz[a], sides[1].xyz[b], float(s))
                for a, b, s in zip(ranking.first[:count], ranking.second[:count], ranking.score[:count], strict=True)
            ]
            reason = f"{ranked} of {ranking.counts['n_pairs']} pairs of candidates rank"
        else:
            contacts = [(initials[0].xyz[0], initials[1].xyz[0], score)]
            reason = f"none of {ranking.counts['n_pairs']} pairs of candidates ranks"
        grasps = tuple(Grasp(g1, g2, hand_rotation(g1, g2, slab.normal), s) for g1, g2, s in contacts)
        parallel = sum(is_parallel(g.g1, g.g2, slab.normal) for g in grasps)
    notes = [reason, unscored] if unscored else [reason]
    if parallel:
        notes.append(f"{parallel} grasps run along the object's axis: their X follows a coordinate axis by convention")
    return log.plan("ok" if ranked else "initial_points", "; ".join(notes), grasps)
