# SPDX-License-Identifier: Apache-2.0
"""How wide a planned grasp says that the object is, beside the true solid along the same line."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from every_case import every_case
from seen_solids import Camera, Solid, box, can

from foretouch.grasp import GeoGraspConfig, HandConfig, plan_grasps
from foretouch.grasp.completed import MAY_NOT_FIT
from foretouch.grasp.geograsp import GraspPlan
from foretouch.grasp.messages import decode_grasp, encode_grasp
from foretouch.types import Grasp

SOLIDS = {"can": can(0.033, 0.1), "box": box(0.06, 0.09, 0.08), "low box": box(0.05, 0.12, 0.05)}


def plan_of(solid: Solid, camera: Camera, opening_m: float = 0.1) -> GraspPlan:
    return plan_grasps(camera.see(solid), camera.table(), GeoGraspConfig(), hand=HandConfig(opening_m=opening_m))


def true_width(solid: Solid, camera: Camera, grasp: Grasp) -> float:
    found = camera.to_world(np.stack([grasp.g1, grasp.g2]))
    true = solid.contacts(found.mean(axis=0), (found[1] - found[0]) / np.linalg.norm(found[1] - found[0]))
    return float(np.linalg.norm(true[1] - true[0]))


def test_the_planned_width_is_the_object_s_and_the_bound_is_above_it() -> None:
    wrong: list[float] = []

    def check(solid: Solid, elevation_deg: float) -> None:
        camera = Camera(elevation_deg)
        (grasp,) = plan_of(solid, camera).grasps
        true = true_width(solid, camera, grasp)
        wrong.append(true - grasp.width_m)
        assert abs(wrong[-1]) < 0.006
        assert grasp.way is not None
        assert true < grasp.way.width_at_most_m < true + 0.022

    cases = [(solid, elevation) for solid in SOLIDS.values() for elevation in (50.0, 70.0, 90.0)]
    every_case(cases, check)
    assert abs(np.median(wrong)) < 0.003


def test_a_grasp_that_may_not_fit_the_hand_is_flagged_and_one_that_does_not_is_refused() -> None:
    solid, camera = SOLIDS["low box"], Camera(60.0)
    width_m = plan_of(solid, camera).grasps[0].width_m
    assert plan_of(solid, camera).grasps[0].flags == ()
    tight = plan_of(solid, camera, opening_m=width_m + 0.004)
    assert MAY_NOT_FIT in tight.grasps[0].flags
    assert tight.grasps[0].to_dict()["width_at_most_m"] > width_m + 0.004
    narrow = plan_of(solid, camera, opening_m=width_m - 0.015)
    assert all(grasp.width_m <= width_m - 0.015 + 1e-9 for grasp in narrow.grasps)
    assert narrow.counts["n_too_wide"] > 0


def test_the_bound_of_a_message_before_it_is_unknown() -> None:
    (grasp,) = plan_of(SOLIDS["can"], Camera(60.0)).grasps
    fields = vars(encode_grasp(replace(grasp, way=None)))
    assert decode_grasp(SimpleNamespace(**fields)).way is None
    assert np.isfinite(grasp.way.width_at_most_m)
