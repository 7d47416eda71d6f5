# SPDX-License-Identifier: Apache-2.0
"""Selection of the target object, and ambiguous cases."""

import numpy as np
import pytest
from every_case import every_case

from foretouch.cloud.segmentation.objects import TargetConfig, select_targets
from foretouch.errors import ConfigError
from foretouch.types import ASSUMED_TABLE, Cloud
from foretouch.types.scene import Object


def _object(number: int, centre: tuple[float, float, float], n: int) -> Object:
    """A square of n points, 4 cm wide."""
    side = np.stack(np.meshgrid(np.linspace(-0.02, 0.02, n // 10), np.linspace(-0.02, 0.02, 10)), -1).reshape(-1, 2)
    xyz = np.column_stack([side, np.zeros(len(side))]) + centre
    bounds = np.stack([xyz.min(axis=0), xyz.max(axis=0)])
    return Object(str(number), Cloud(xyz.astype(np.float32)), ASSUMED_TABLE, xyz.mean(axis=0), bounds)


OBJECTS = [_object(1, (0.0, 0.0, 0.8), 500), _object(2, (0.2, 0.0, 0.9), 1000), _object(3, (-0.2, 0.1, 1.1), 300)]


def test_the_rule_decides_and_no_target_is_explained() -> None:
    def check(config: TargetConfig, ids: list[int], why: str = "") -> None:
        chosen, reason = select_targets(OBJECTS, config)
        assert ([int(obj.id) for obj in chosen], reason) == (ids, why)

    far = "no object within 0.03 m of the point (0, 0, 1): the nearest is 0.200 m away"
    cases = [
        (TargetConfig(), [1]),
        (TargetConfig(mode="largest"), [2]),
        (TargetConfig(mode="all"), [1, 2, 3]),
        (TargetConfig(mode="all", max_objects=2), [1, 2], "the 2 nearest of 3 objects (target.max_objects)"),
        (TargetConfig(mode="point", point=(-0.2, 0.1, 1.1)), [3]),
        (TargetConfig(mode="point", point=(0.24, 0.0, 0.9)), [2]),
        (TargetConfig(mode="point", point=(0.0, 0.0, 1.0)), [], far),
    ]
    every_case(cases, check)
    for mode in ("nearest", "all"):
        assert select_targets([], TargetConfig(mode=mode)) == ([], "there is no object")
    with pytest.raises(ConfigError, match="2 numbers are not x, y, z"):
        TargetConfig(mode="point", point=(1.0, 2.0))
    with pytest.raises(ConfigError, match="mode point needs x, y, z"):
        TargetConfig(mode="point")


def test_of_equal_objects_the_previous_or_most_central_then_the_leftmost_is_selected() -> None:
    def check(reason: str, objects: list[Object], config: TargetConfig, chosen: int) -> None:
        found, why = select_targets(objects, config)
        assert [int(obj.id) for obj in found] == [chosen]
        assert why == f"ambiguous_target: objects {reason}; object {chosen} is nearest to the optical axis"

    beside, at_point = _object(2, (0.05, 0.0, 0.8), 500), TargetConfig(mode="point", point=(0.025, 0.0, 0.8))
    aside, behind = _object(1, (0.05, 0.0, 0.8), 500), _object(2, (0.0, 0.0, 0.802), 500)
    larger, by_size = _object(2, (0.05, 0.0, 0.9), 510), TargetConfig(mode="largest")
    cases = [
        ("1 and 2 are equally near to the point (0.025, 0, 0.8), 0.005 and 0.005 m", [OBJECTS[0], beside], at_point, 1),
        ("1 and 2 are equally near to the camera, 0.802 and 0.802 m", [aside, behind], TargetConfig(), 2),
        ("2 and 1 are equally large, 510 and 500 points", [OBJECTS[0], larger], by_size, 1),
    ]
    every_case(cases, check)
    pair = [_object(1, (0.1, 0.0, 0.8), 500), _object(2, (-0.1, 0.0, 0.8), 500)]
    found, why = select_targets(pair, TargetConfig())
    assert [obj.id for obj in found] == ["2"]
    assert why.endswith("object 2 is the leftmost of those nearest to the optical axis")
    pair = [OBJECTS[0], _object(2, (0.05, 0.0, 0.8), 500)]
    found, why = select_targets(pair, TargetConfig(), previous=np.array([0.052, 0.001, 0.8]))
    assert [obj.id for obj in found] == ["2"]
    assert why.endswith("object 2 was the target before")
    assert select_targets(pair, TargetConfig(), previous=np.array([0.3, 0.0, 0.8]))[0] == [pair[0]]
    nearer = [_object(1, (0.0, 0.0, 0.78), 500), pair[1]]
    assert select_targets(nearer, TargetConfig(), previous=pair[1].centroid) == ([nearer[0]], "")
    assert select_targets(pair, TargetConfig(margin_m=0.0))[0] == [pair[0]]
