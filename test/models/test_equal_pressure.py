# SPDX-License-Identifier: Apache-2.0
"""Grasps whose predicted pressures differ by less than their intervals: by hand-made numbers, and by the released models."""

from itertools import permutations
from pathlib import Path

import numpy as np

from foretouch.cloud.io.files import read_cloud
from foretouch.models.equal_pressure import equal_groups, equal_pressures
from foretouch.models.registry import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import ASSUMED_TABLE, Predictions
from foretouch.types.scene import Object

CAN = Path(__file__).parents[2] / "examples" / "data" / "can.ply"


def test_costs_within_the_half_width_of_the_lowest_of_a_group_are_one_group_in_any_order():
    costs, half = np.array([0.40, 0.44, 0.46, 0.52, 0.56, np.inf, np.nan]), np.full(7, 0.05)
    for order in permutations(range(7)):
        groups = equal_groups(costs[list(order)], half)
        assert groups[np.argsort(order)][:5].tolist() == [0, 0, 1, 2, 2]
        assert len(set(groups[np.argsort(order)][5:])) == 2
    assert equal_groups([0.4, 0.41], [np.nan, np.nan]).tolist() == [0, 1]  # no intervals
    assert equal_groups([-3.0, -3.0], [0.0, 0.0]).tolist() == [0, 1]  # scores have none


def grasps_around(target, pipeline, count):
    xyz = target.cloud.xyz.reshape(-1, 3)
    heights = np.random.default_rng(0).choice(xyz[np.isfinite(xyz).all(axis=1), 1], count)
    bands = [xyz[np.abs(xyz[:, 1] - y) < 0.005].astype(float) for y in heights]
    return [pipeline.grasp_between(target, band[band[:, 0].argmin()], band[band[:, 0].argmax()]) for band in bands]


def test_one_grasp_refused_grasps_and_models_without_intervals_get_no_flag():
    model, pipeline = load_model(), Pipeline(PipelineConfig())
    target = Object.of("1", read_cloud(CAN), ASSUMED_TABLE)
    grasps = grasps_around(target, pipeline, 3)
    rows = model.predict(target, grasps)
    refused = Predictions.refused(rows.grasps[:1], rows.channels, "refused", "not finite")
    alone = Predictions.join([refused, rows[:1]])
    assert not equal_pressures(alone, model).any()
    assert equal_pressures(Predictions.join([refused, rows]), model)[:2].tolist() == [False, True]
    plain = TouchModel(model.predictor, model.card)
    assert not equal_pressures(plain.predict(target, grasps), plain).any()
