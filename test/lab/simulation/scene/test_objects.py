# SPDX-License-Identifier: Apache-2.0
from typing import Any

import numpy as np
import pytest
from sim_builders import CAN

from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig, draw_families

MIXED = {"shapes": ["random", "can", "ball"], "rests": ["upright", "side"], "young_pa": [1e4, 1e6], "count": 40}


def drawn(**values: Any) -> list[ObjectConfig]:
    return draw_families([values], "")


def test_every_object_draws_its_own_values_within_the_ranges() -> None:
    items = drawn(**MIXED, size_m=[0.04, 0.09], thickness_m=[0.01, 0.02])
    assert [item.name for item in items[:2]] == ["obj_000", "obj_001"]
    assert len({item.size_m for item in items}) == len({item.young_pa for item in items}) == 40
    assert all(0.04 <= edge <= 0.09 for item in items for edge in item.size_m)
    assert all(item.thickness_m is not None and 0.01 <= item.thickness_m <= 0.02 for item in items)
    assert {item.shape for item in items} == {"random", "can", "ball"}
    assert {item.pose.rest for item in items} == {"upright", "side"}
    members = [item.first_variant for item in items if item.shape == "random"]
    assert len(set(members)) == len(members)
    assert all(item.rigid and item.thickness_m is None for item in drawn())


def test_stiffness_is_uniform_in_its_logarithm_and_more_objects_leave_the_first_as_they_were() -> None:
    """The median of the draws from 10 kPa to 1 MPa is near 100 kPa; uniform in the modulus it would be 505 kPa."""
    moduli = [item.young_pa for item in drawn(young_pa=[1e4, 1e6], count=400)]
    assert np.median(np.log10(np.array(moduli, np.float64))) == pytest.approx(5.0, abs=0.15)
    assert drawn(**MIXED | {"count": 60})[:40] == drawn(**MIXED)
    assert drawn(**MIXED, seed=1) != drawn(**MIXED)


def test_the_members_of_a_family_have_the_masses_that_it_states_and_are_otherwise_the_same() -> None:
    plain, heavy = drawn(count=8), drawn(count=8, mass_kg=[0.05, 0.2])
    assert all(one.mass_kg is None for one in plain)
    masses = [one.mass_kg or 0.0 for one in heavy]
    assert min(masses) >= 0.05 < max(masses) <= 0.2
    assert len(set(masses)) > 1
    assert [one.replace(mass_kg=None) for one in heavy] == plain


def test_a_scene_holds_its_families_in_full() -> None:
    config = SceneConfig.from_mapping({"objects": [CAN], "families": [{"count": 3}, {"name": "pad", "count": 2}]})
    assert [item.name for item in config.objects] == ["can", "obj_000", "obj_001", "obj_002", "pad_000", "pad_001"]
    assert SceneConfig.from_mapping(config.to_mapping()) == config
    assert config.replace(seed=5).objects == config.objects
