# SPDX-License-Identifier: Apache-2.0
"""What friction carries, worked by hand, and the flag of grasps that cannot."""

from dataclasses import replace

import numpy as np
import pytest
from seen_solids import Camera, box

import foretouch as ft
from foretouch.grasp.carry import CANNOT_CARRY, strain
from foretouch.types import Float64
from foretouch.types.scene import Object

FORCE_N, FRICTION = 5.0, 0.8
WEIGHT_M_S2 = 9.81 + 1.6  # with the acceleration of a lift


def walls(slope: float = 0.0) -> Float64:
    """(N, 3) points of two walls, 60 mm apart at a height of 50 mm, which lean outwards by `slope` over height."""
    beside, up = np.meshgrid(np.linspace(-0.02, 0.02, 21), np.linspace(0.03, 0.07, 21))
    outwards = 0.03 + slope * (up - 0.05)
    return np.concatenate([np.stack([sign * outwards, beside, up], axis=-1).reshape(-1, 3) for sign in (-1, 1)])


def strain_of(mass_kg: float, slope: float = 0.0, along_m: float = 0.0) -> float:
    """Of contacts at a height of 50 mm, whose middle is so far beside the centre of mass along their line."""
    points, ends = walls(slope), np.array([[-0.03, 0.0, 0.05], [0.03, 0.0, 0.05]])
    shift = np.array([along_m, 0.0, 0.0])
    return strain(ends + shift, points + shift, np.ones(len(points)), mass_kg, FRICTION, FORCE_N)


def test_on_upright_walls_the_friction_of_both_contacts_carries_the_weight() -> None:
    for mass_kg in (0.1, 0.5, 0.9):
        assert strain_of(mass_kg) == pytest.approx(mass_kg * WEIGHT_M_S2 / (2.0 * FRICTION * FORCE_N))
    whole = strain_of(0.3, along_m=0.03)  # the centre is over one contact, which carries all
    assert whole == pytest.approx(2.0 * strain_of(0.3))
    assert strain_of(0.3, along_m=-0.03) == pytest.approx(whole)


def test_walls_that_face_downwards_carry_more_and_upwards_less() -> None:
    """By the angle between the force and the normal, on either side of the friction angle."""
    for slope in (-0.2, 0.2):
        force = np.arctan2(0.5 * 0.6 * WEIGHT_M_S2, FORCE_N)
        expected = np.tan(force - np.arctan(slope)) / FRICTION
        assert strain_of(0.6, slope) == pytest.approx(expected, rel=1e-3)
    assert strain_of(0.7, -0.2) > 1.0 > strain_of(0.7, 0.2)


def test_of_a_side_without_points_nothing_but_upright_walls_is_assumed() -> None:
    ends, none = np.array([[-0.03, 0.0, 0.05], [0.03, 0.0, 0.05]]), np.empty((0, 3))
    assert strain(ends, none, np.empty(0), 0.4, FRICTION, FORCE_N) == pytest.approx(strain_of(0.4))


def test_a_given_mass_flags_the_grasps_that_cannot_carry_it() -> None:
    camera = Camera(60.0)
    target = Object.of("1", camera.see(box(0.05, 0.12, 0.08)), camera.table())
    unknown = ft.plan(target)
    assert unknown.flags.tolist() == [()]
    light, heavy = ft.plan(target, mass_kg=0.4), ft.plan(target, mass_kg=1.0)
    assert light.flags.tolist() == [()]
    assert heavy.flags.tolist() == [(CANNOT_CARRY,)]
    for grasps in (light, heavy):
        np.testing.assert_array_equal(grasps.g1, unknown.g1)
    assert CANNOT_CARRY in ft.plan(target, mass_kg=0.4, friction=0.3).flags[0]
    strong = ft.PipelineConfig.from_mapping({"hand": {"force_n": 10.0}, "object": {"mass_kg": 1.0}})
    assert ft.plan(target, config=strong).flags.tolist() == [()]
    assert heavy[0].to_dict()["flags"] == [CANNOT_CARRY]
    assert all(CANNOT_CARRY in flags for flags in ft.load_model().predict(replace(target, id="2"), heavy).flags)
    assert ft.plan(target, mass_kg=np.float32(0.5)).score.tolist() == ft.plan(target, mass_kg=0.5).score.tolist()
    with pytest.raises(ft.ForetouchError, match="mass_kg"):
        ft.plan(target, mass_kg=-1.0)
