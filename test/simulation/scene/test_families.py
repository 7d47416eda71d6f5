# SPDX-License-Identifier: Apache-2.0
from typing import Any

import numpy as np
import pytest
from sim_builders import CAN

from foretouch.errors import ConfigError
from foretouch.simulation.scene import FamilyConfig, SceneConfig, draw_objects

MIXED = {"shapes": ["random", "can", "ball"], "rests": ["upright", "side"], "young_pa": [1e4, 1e6], "count": 40}


def family(**values: Any) -> FamilyConfig:
    return FamilyConfig.from_mapping(values)


def test_every_object_draws_its_own_values_within_the_ranges() -> None:
    items = draw_objects(family(**MIXED, size_m=[0.04, 0.09], thickness_m=[0.01, 0.02]))
    assert [item.name for item in items[:2]] == ["obj_000", "obj_001"]
    assert len({item.size_m for item in items}) == len({item.young_pa for item in items}) == 40
    assert all(0.04 <= edge <= 0.09 for item in items for edge in item.size_m)
    assert all(item.thickness_m is not None and 0.01 <= item.thickness_m <= 0.02 for item in items)
    assert {item.shape for item in items} == {"random", "can", "ball"}
    assert {item.pose.rest for item in items} == {"upright", "side"}
    members = [item.first_variant for item in items if item.shape == "random"]
    assert len(set(members)) == len(members)


def test_stiffness_is_uniform_in_its_logarithm() -> None:
    """The median of the draws from 10 kPa to 1 MPa is near 100 kPa; uniform in the modulus it would be 505 kPa."""
    moduli = [item.young_pa for item in draw_objects(family(young_pa=[1e4, 1e6], count=400))]
    assert np.median(np.log10(np.array(moduli, np.float64))) == pytest.approx(5.0, abs=0.15)


def test_more_objects_leave_the_first_ones_as_they_were() -> None:
    assert draw_objects(family(**MIXED | {"count": 60}))[:40] == draw_objects(family(**MIXED))
    assert draw_objects(family(**MIXED, seed=1)) != draw_objects(family(**MIXED))


def test_a_family_without_a_modulus_is_rigid() -> None:
    assert all(item.rigid and item.thickness_m is None for item in draw_objects(family()))


def test_a_scene_holds_its_families_in_full() -> None:
    config = SceneConfig.from_mapping({"objects": [CAN], "families": [{"count": 3}, {"name": "pad", "count": 2}]})
    assert [item.name for item in config.objects] == ["can", "obj_000", "obj_001", "obj_002", "pad_000", "pad_001"]
    assert SceneConfig.from_mapping(config.to_mapping()) == config
    assert config.replace(seed=5).objects == config.objects


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"size_m": [0.1, 0.05]}, r"s.yaml: FamilyConfig.size_m: \[0.1, 0.05\] is not \[low, high\]"),
        ({"young_pa": [1e5]}, r"FamilyConfig.young_pa: \[100000.0\] is not \[low, high\]"),
        ({"shapes": []}, r"FamilyConfig.shapes: there is none"),
        ({"shapes": ["cube"]}, r"FamilyConfig.shapes\[0\]: 'cube' is none of"),
        ({"number": 3}, r"families\[0\].number: unknown setting; known: name, count"),
    ],
)
def test_a_family_that_makes_no_sense_is_named(mapping: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SceneConfig.from_mapping({"families": [mapping]}, "s.yaml")
