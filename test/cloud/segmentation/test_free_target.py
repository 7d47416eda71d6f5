# SPDX-License-Identifier: Apache-2.0
"""Mode `free`: the object of a pile whose best grasp no other object blocks is grasped first."""

import numpy as np
import pytest
from seen_solids import Camera, about_vertical, box, can

from foretouch.cloud.segmentation.objects import AMBIGUOUS_TARGET, TargetConfig, select_free
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import ASSUMED_TABLE, Cloud
from foretouch.types.scene import Object, Scene

_BOX, _WALL, _CAN = box(0.05, 0.05, 0.09), box(0.15, 0.035, 0.09), can(0.03, 0.1)
_CAMERA = Camera(50.0, 0.95)


def _pile(*solids: tuple, yaw: float = 0.0) -> Cloud:
    """Solids at places of the table, turned about the vertical together, as the camera sees them and the table."""
    rays = _CAMERA.see(box(9.0, 9.0, 1e-6)).xyz  # the table
    depth, turn = [rays[..., 2]], about_vertical(yaw)
    for solid, x, y in solids:
        depth.append(_CAMERA.see(solid, at=tuple((turn @ [x, y, 0.0])[:2]), yaw=yaw).xyz[..., 2])
    nearest = np.nanmin(np.stack(depth), axis=0)
    return Cloud((rays / rays[..., 2:] * nearest[..., None]).astype(np.float32))


def _scene(cloud: Cloud, mode: str) -> Scene:
    return Pipeline(PipelineConfig().updated({"target.mode": mode, "target.confidence_margin": 1.0})).segment(cloud)


_ENCLOSED = ((_BOX, -0.06, 0.0), (_WALL, -0.03, 0.0575), (_WALL, -0.03, -0.0575))  # the box is nearest to the camera


@pytest.mark.parametrize("yaw", [0.0, 0.15])
def test_the_nearest_object_is_blocked(yaw: float) -> None:
    cloud = _pile(*_ENCLOSED, (_CAN, 0.2, 0.0), yaw=yaw)
    nearest, found = _scene(cloud, "nearest"), _scene(cloud, "free")
    assert len(found.objects) == 4
    assert [one.id for one in nearest.targets] == ["1"]
    (target,) = found.targets
    centre = _CAMERA.to_world(target.cloud.xyz.astype(np.float64)).mean(axis=0)
    assert np.linalg.norm(centre[:2] - (about_vertical(yaw) @ [0.2, 0.0, 0.0])[:2]) < 0.03  # the can
    assert found.status == "ok"
    assert found.reason.startswith("object 1 is blocked by object ")
    plan = Pipeline().plan(target)
    assert (plan.lost, plan.blocked_by) == (0.0, ())
    alone = Pipeline().plan(nearest.targets[0]), _scene(_pile(_ENCLOSED[0], yaw=yaw), "free")
    assert alone[0].lost > 0.2  # of the box; without the walls nothing costs it anything
    assert [one.id for one in alone[1].targets] == ["1"]
    assert alone[1].reason == ""


def test_no_object_is_free() -> None:
    found = _scene(_pile(*_ENCLOSED), "free")
    losses = {one.id: Pipeline().plan(one).lost for one in _scene(_pile(*_ENCLOSED), "all").targets}
    (target,) = found.targets
    assert min(losses.values()) > 0.2
    assert losses[target.id] == min(losses.values())
    assert found.reason.startswith("no object is free: object 1 is blocked by object")
    assert found.reason.endswith(f"object {target.id} is hindered least")


def _object(k: int, z: float) -> Object:
    xyz = np.array([[0.0, 0.01 * k, z]], np.float32)
    return Object.of(str(k), Cloud(xyz), ASSUMED_TABLE)


def test_the_rule_by_hand() -> None:
    objects = [_object(1, 0.7), _object(2, 0.8), _object(3, 0.801), _object(4, 0.9)]
    asked: list[int] = []

    def chosen(losses: dict[int, float], **settings: int) -> tuple[list[int], str]:
        asked.clear()

        def loss(one: Object) -> tuple[float, str]:
            asked.append(int(one.id))
            return losses.get(int(one.id), 0.0), "is blocked"

        found, why = select_free(objects, TargetConfig(mode="free", **settings), loss)
        return [int(one.id) for one in found], why

    assert chosen({}) == ([1], "")
    assert asked == [1]  # no grasp is planned behind the first free object
    ids, why = chosen({1: np.inf})
    assert ids == [2]
    assert why.startswith(f"{AMBIGUOUS_TARGET}: objects 2 and 3 are equally near")
    assert why.endswith("; object 1 is blocked")
    assert chosen({1: 0.3, 2: 0.21}) == ([3], "object 1 is blocked; object 2 is blocked")
    assert chosen(dict.fromkeys(range(1, 5), np.inf))[0] == [1]  # none has a grasp: the nearest
    assert chosen({1: 0.9, 2: 0.5, 3: 0.7}, max_objects=3)[0] == [2]
    assert chosen({1: 0.9, 2: 0.5, 3: 0.5}, max_objects=3)[1].endswith("object 2 is hindered least")
