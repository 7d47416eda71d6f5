# SPDX-License-Identifier: Apache-2.0
"""Dead, stuck and saturated taxels, in readings that are made up."""

import numpy as np
from every_case import every_case
from other_sensor import USKIN

from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.dead_taxels import filled, usable, with_dead_taxels
from foretouch.tactile.description import sensor_of, with_sensor
from foretouch.types import Float64

COLUMNS = BIOTAC_SP.taxel_columns[..., 0]  # (finger, taxel)


def readings(count: int = 40) -> Float64:
    """Every electrode has a level of its own, and all of a finger move together."""
    rng = np.random.default_rng(3)
    level = rng.uniform(1500.0, 3500.0, 50)
    return np.clip(np.round(level + rng.normal(0.0, 150.0, (count, 1)) + rng.normal(0.0, 30.0, (count, 50))), 2, 4094)


def test_what_is_constant_at_a_limit_or_not_read_is_dead_and_nothing_else() -> None:
    rng = np.random.default_rng(1)

    def check(values: object, dead: dict[str, list[int]]) -> None:
        found = readings()
        found[:, COLUMNS[0, 5]] = values
        assert with_dead_taxels(BIOTAC_SP, found).dead == dead

    every_case(
        [
            (readings()[:, 9], {}),
            (800.0, {"TH": [5]}),
            (np.nan, {"TH": [5]}),
            (0.0, {"TH": [5]}),
            (np.where(rng.random(40) < 0.5, 1.0, 4095.0), {"TH": [5]}),
            (np.r_[[4095.0] * 39, 4000.0], {}),
            (np.r_[[np.nan] * 30, np.arange(2000.0, 2010.0)], {}),
            (np.r_[[800.0] * 39, np.nan], {"TH": [5]}),
        ],
        check,
    )
    assert with_dead_taxels(BIOTAC_SP, np.full((4, 50), 800.0)) is BIOTAC_SP  # too few readings
    half = readings()
    half[:, COLUMNS[1, :12]] = 0.0
    half[:, COLUMNS[0, 2]] = 7.0
    assert with_dead_taxels(BIOTAC_SP, half).dead == {"TH": [2]}  # the middle finger does not work


def test_a_declared_one_stays_and_a_card_holds_all() -> None:
    found = readings()
    found[:, COLUMNS[0, 5]] = 800.0
    declared = BIOTAC_SP.with_dead(np.arange(24) == np.array([[7], [23]]))
    both = with_dead_taxels(declared, found)
    assert both.dead == {"TH": [5, 7], "MF": [23]}
    assert both.sha256 == BIOTAC_SP.sha256
    assert both.channels == BIOTAC_SP.channels
    again = sensor_of(with_sensor({}, both)["sensor"], "card")
    assert again.dead == both.dead
    assert with_sensor({}, BIOTAC_SP) == {}


def test_a_dead_taxel_has_the_mean_of_its_neighbours_and_one_that_was_missed_once_moves_with_its_finger() -> None:
    whole = readings()
    broken = whole.copy()
    broken[:, COLUMNS[0, 5]] = 4095.0
    broken[3, COLUMNS[1, 9]] = np.nan
    sensor = with_dead_taxels(BIOTAC_SP, broken)
    found = filled(broken, sensor)
    distance = np.linalg.norm(sensor.layout.positions - sensor.layout.positions[5], axis=1)
    distance[5] = np.inf
    nearest = np.flatnonzero(distance < 1.001 * distance.min())
    np.testing.assert_array_equal(found[:, COLUMNS[0, 5]], whole[:, COLUMNS[0, nearest]].mean(axis=1))
    assert abs(found[3, COLUMNS[1, 9]] - whole[3, COLUMNS[1, 9]]) < 100.0  # of a range of about 450
    others = np.setdiff1d(np.arange(50), [COLUMNS[0, 5], COLUMNS[1, 9]])
    np.testing.assert_array_equal(found[:, others], whole[:, others])
    assert filled(whole, BIOTAC_SP) is not whole
    np.testing.assert_array_equal(filled(whole, BIOTAC_SP), whole)
    hidden = usable(broken, sensor.channels, sensor.valid_values)
    assert np.isnan(hidden).sum() == len(whole) + 1
    scalar = np.where(np.arange(50) == 0, -22072.0, whole)
    np.testing.assert_array_equal(usable(scalar, BIOTAC_SP.channels), scalar)  # a pressure is of the whole finger


def test_of_a_taxel_with_three_numbers_one_is_enough_and_forces_without_noise_may_be_constant() -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(20000.0, 300.0, (30, USKIN.channels.size))
    values[:, USKIN.taxel_columns[1, 6, 2]] = 12345.0
    found = with_dead_taxels(USKIN, values)
    assert found.dead == {USKIN.channels.fingers[1]: [6]}
    assert np.isfinite(filled(values, found)).all()
    mapping = USKIN.to_mapping()
    for one in mapping["values"]:
        one |= {"unit": "N", "dtype": "float32", "range": [-50.0, 50.0], "rest": "zero"}
    forces = sensor_of(mapping, "forces")
    values[:, forces.taxel_columns[1, 6]] = 0.0
    assert with_dead_taxels(forces, np.clip(values / 30000.0, -49.0, 49.0)).dead == {}
