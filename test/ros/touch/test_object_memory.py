# SPDX-License-Identifier: Apache-2.0
"""Which object is the one that was touched."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from calibrated_models import REST, save_calibrated_network

from foretouch.errors import TactileError
from foretouch.models import TouchModel, load_model
from foretouch.models.hand_history import Extent, HandHistory
from foretouch.models.touch_model import ObjectResiduals
from foretouch.ros.touch.tactile_state import HandMemory, ObjectMemory
from foretouch.types import Cloud, Grasp, Touch

NEAR_M = 0.02
GRASP = Grasp(np.array([0.03, 0.0, 0.8]), np.array([-0.03, 0.0, 0.8]), np.eye(3))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> TouchModel:
    return load_model(save_calibrated_network(tmp_path_factory.mktemp("model")))


def can(shift: float = 0.0, scale: float = 1.0, frame: str = "cam", seed: int = 0) -> Cloud:
    points = np.random.default_rng(seed).uniform(-0.04, 0.04, (2000, 3))
    return Cloud((scale * points + [shift, 0.0, 0.8]).astype(np.float32), None, frame)


def touch(shift: float = 0.0) -> Touch:
    return Touch.from_vector(REST + shift)


@pytest.fixture
def memory(model: TouchModel) -> ObjectMemory:
    one = ObjectMemory(model)
    one.add(can(), GRASP, touch(-40.0), None, NEAR_M)
    return one


@pytest.mark.parametrize(
    ("cloud", "same"),
    [
        (can(seed=1), True),  # another image of it
        (can(0.015), True),
        (can(0.03), False),
        (can(scale=2.0), False),  # in the same place, but larger
        (can(frame="base"), False),
        (Cloud(np.full((5, 3), np.nan, np.float32), None, "cam"), False),
    ],
)
def test_the_object_is_told_by_place_and_size(memory: ObjectMemory, cloud: Cloud, *, same: bool) -> None:
    assert (memory.of(cloud, NEAR_M) is not None) == same


@pytest.mark.parametrize("value", [3e38, -3e38, 1e20])
def test_a_point_whose_square_no_float32_holds_makes_another_object(memory: ObjectMemory, value: float) -> None:
    cloud = can()
    xyz = cloud.xyz.copy()
    xyz[:2, 1] = value
    assert memory.of(Cloud(xyz, None, "cam"), NEAR_M) is None
    assert memory.of(cloud, NEAR_M) is not None


def test_a_touch_of_another_object_begins_anew(memory: ObjectMemory) -> None:
    memory.add(can(0.01), GRASP, touch(-40.0), None, NEAR_M)
    assert memory.count == 2
    memory.add(can(0.3), GRASP, touch(-40.0), None, NEAR_M)
    assert memory.count == 1
    assert memory.of(can(), NEAR_M) is None


def clocked_memories(model: TouchModel) -> Iterator[tuple[ObjectMemory | HandMemory, Callable[[float], None]]]:
    """Both kinds, each with a function that advances its clock [s]."""
    seconds, stamp = [100.0], [1_800_000_000_000_000_000]
    yield ObjectMemory(model, lambda: seconds[0]), lambda by: seconds.append(seconds.pop() + by)
    history = HandHistory(load_model("default"))
    yield HandMemory(history, lambda: stamp[0]), lambda by: stamp.append(stamp.pop() + round(by * 1e9))


def test_an_object_is_forgotten_by_the_clock_of_its_memory(model: TouchModel) -> None:
    for memory, advance in clocked_memories(model):
        memory.add(can(), GRASP, touch(-40.0), None, same_object_m=NEAR_M)
        advance(50.0)
        memory.expire(after_s=60.0)
        assert memory.count == 1
        advance(11.0)
        memory.expire(after_s=60.0)
        assert memory.count == 0


def test_later_readings_are_moved_to_the_first_tare(model: TouchModel) -> None:
    drifting, still = ObjectMemory(model), ObjectResiduals(model, touch())
    for drift in (0.0, 25.0, 50.0):
        drifting.add(can(), GRASP, touch(drift - 40.0), touch(drift), NEAR_M)
        still.add(can(), GRASP, touch(-40.0))
    leaned = drifting.of(can(), NEAR_M)
    assert leaned is not None
    (a,), (b,) = (model.predict(can(), [GRASP], residuals=one) for one in (leaned, still))
    assert a.value is not None
    assert b.value is not None
    np.testing.assert_allclose(a.value.vector(), b.value.vector(), rtol=1e-12)


def test_a_refused_reading_leaves_the_memory_as_it_was(memory: ObjectMemory) -> None:
    with pytest.raises(TactileError, match="pdc_th"):
        memory.add(can(0.5), GRASP, Touch(-22072.0, 1700.0, REST[2:26], REST[26:]), None, NEAR_M)
    assert memory.count == 1
    assert memory.of(can(), NEAR_M) is not None


def test_position_and_size_of_a_large_cloud_are_computed_in_double() -> None:
    points = (np.random.default_rng(0).normal(size=(1_000_000, 3)) * 0.03 + [0.1, 0.05, 1.2]).astype(np.float32)
    exact = points.astype(np.float64)
    expected = np.concatenate([exact.mean(axis=0), exact.std(axis=0)])
    np.testing.assert_allclose(Extent.of(Cloud(points)).numbers, expected, rtol=0.0, atol=1e-9)  # in float32: 0.3 mm
