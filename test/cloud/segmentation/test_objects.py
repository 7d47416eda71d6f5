# SPDX-License-Identifier: Apache-2.0
"""Selection of the target object, and ambiguous cases."""

from __future__ import annotations

import numpy as np
import pytest

from foretouch.cloud.segmentation.objects import ObjectSegment, TargetConfig, select_targets
from foretouch.errors import ConfigError
from foretouch.types import Cloud


def _object(number: int, centre: tuple[float, float, float], n: int) -> ObjectSegment:
    """A square of n points, 4 cm wide."""
    side = np.stack(np.meshgrid(np.linspace(-0.02, 0.02, n // 10), np.linspace(-0.02, 0.02, 10)), -1).reshape(-1, 2)
    xyz = np.column_stack([side, np.zeros(len(side))]) + centre
    bounds = np.stack([xyz.min(axis=0), xyz.max(axis=0)])
    return ObjectSegment(number, Cloud(xyz.astype(np.float32)), np.arange(len(xyz)), xyz.mean(axis=0), bounds)


OBJECTS = [_object(1, (0.0, 0.0, 0.8), 500), _object(2, (0.2, 0.0, 0.9), 1000), _object(3, (-0.2, 0.1, 1.1), 300)]


@pytest.mark.parametrize(
    ("config", "ids"),
    [
        (TargetConfig(), [1]),
        (TargetConfig(mode="largest"), [2]),
        (TargetConfig(mode="all"), [1, 2, 3]),
        (TargetConfig(mode="point", point=(-0.2, 0.1, 1.1)), [3]),
        (TargetConfig(mode="point", point=(0.24, 0.0, 0.9)), [2]),
    ],
)
def test_the_rule_decides(config: TargetConfig, ids: list[int]) -> None:
    chosen, reason = select_targets(OBJECTS, config)
    assert [obj.id for obj in chosen] == ids
    assert reason == ""


@pytest.mark.parametrize(
    ("objects", "config", "reason"),
    [
        ([], TargetConfig(), "there is no object"),
        ([], TargetConfig(mode="all"), "there is no object"),
        (
            OBJECTS,
            TargetConfig(mode="point", point=(0.0, 0.0, 1.0)),
            "no object within 0.03 m of the point (0, 0, 1): the nearest is 0.200 m away",
        ),
        (
            [OBJECTS[0], _object(2, (0.05, 0.0, 0.8), 500)],
            TargetConfig(mode="point", point=(0.025, 0.0, 0.8)),
            "objects 1 and 2 are equally near to the point (0.025, 0, 0.8), 0.005 and 0.005 m",
        ),
        (
            [OBJECTS[0], _object(2, (0.05, 0.0, 0.8), 500)],
            TargetConfig(),
            "objects 1 and 2 are equally near to the camera, 0.800 and 0.802 m",
        ),
        (
            [OBJECTS[0], _object(2, (0.05, 0.0, 0.9), 510)],
            TargetConfig(mode="largest"),
            "objects 2 and 1 are equally large, 510 and 500 points",
        ),
    ],
)
def test_ambiguity_is_reported(objects: list[ObjectSegment], config: TargetConfig, reason: str) -> None:
    assert select_targets(objects, config) == ([], reason)


def test_the_margin_is_a_setting() -> None:
    pair = [OBJECTS[0], _object(2, (0.05, 0.0, 0.8), 500)]
    assert select_targets(pair, TargetConfig(margin_m=0.0))[0] == [pair[0]]


def test_a_point_is_three_numbers() -> None:
    with pytest.raises(ConfigError, match="2 numbers are not x, y, z"):
        TargetConfig(mode="point", point=(1.0, 2.0))
    with pytest.raises(ConfigError, match="mode point needs x, y, z"):
        TargetConfig(mode="point")
