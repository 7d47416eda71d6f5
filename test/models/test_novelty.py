# SPDX-License-Identifier: Apache-2.0
"""Novelty detection of networks: training objects are in distribution, objects of another size are not."""

from typing import Any

import numpy as np
import pytest
from contact_model_builders import cylinder
from every_case import every_case
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.errors import CloudError, ModelError
from foretouch.models.network.preparation import LengthRangeCheck
from foretouch.models.novelty import Fallback, object_sizes
from foretouch.tactile import BIOTAC

HERE = np.array([0.0, 0.0, 1.2])
SIDES = np.array([[0.05, 0.08, 0.1], [0.06, 0.06, 0.15], [0.1, 0.12, 0.05]])
LABELS = np.arange(3000.0).reshape(60, 50)


def box(sides: np.ndarray, rng: np.random.Generator, points: int = 300) -> np.ndarray:
    return rng.uniform(-0.5, 0.5, (points, 3)) * sides * rng.normal(1.0, 0.03, 3)


@pytest.fixture
def trained(rng: np.random.Generator) -> np.ndarray:
    """Sizes of twenty clouds of each of three boxes."""
    return np.array([object_sizes(HERE + box(side, rng)) for side in SIDES for _ in range(20)])


@pytest.fixture
def fallback(trained: np.ndarray) -> Fallback:
    return Fallback.fit(BIOTAC, trained, LABELS)


def test_sizes_are_what_they_are_called_and_do_not_depend_on_the_place(rng) -> None:
    cloud = box(SIDES[0], rng)
    found, centred = object_sizes(HERE + cloud), cloud - cloud.mean(axis=0)
    assert_allclose(found[:3], np.ptp(cloud, axis=0))
    assert_allclose(found[3:6], np.linalg.svd(centred, compute_uv=False)[::-1] / np.sqrt(len(cloud)))
    assert_allclose(found[6:], [np.linalg.norm(centred, axis=1).max(), np.log(len(cloud))])
    assert_allclose(object_sizes(cloud + np.array([0.7, 0.0, 2.5])), found, atol=1e-9)
    with pytest.raises(CloudError, match="all 20 finite points are in one place"):
        object_sizes(np.ones((20, 3)))


def test_training_clouds_are_in_distribution_a_house_and_a_pea_get_the_mean(fallback, trained, rng) -> None:
    assert np.mean([fallback.score(one) >= 0.5 for one in trained]) >= 0.9
    others = [fallback.score(object_sizes(HERE + box(side, rng))) for side in SIDES for _ in range(30)]
    assert np.mean(np.array(others) >= 0.5) >= 0.8  # about the quantile of the usual distances
    known = fallback.known.astype(np.float64)
    distance = np.abs(known[:, None] - known[None]).sum(axis=2)
    np.fill_diagonal(distance, np.inf)
    nearest = np.sort(distance, axis=1)[:, :3].mean(axis=1)
    assert [(nearest <= end).mean() for end in fallback.span] == pytest.approx([0.90, 0.97], abs=0.02)
    clouds = [HERE + box(sides, rng) for sides in (SIDES[0] * 100.0, SIDES[0] / 20.0)] + [cylinder(0.2, HERE)]
    sizes = np.array([object_sizes(cloud) for cloud in clouds])
    assert [fallback.score(size) for size in sizes] == [0.0, 0.0, 0.0]
    counts, inside = fallback.fade(np.full((3, 50), 1234.0), sizes)
    assert_array_equal(counts, np.tile(LABELS.mean(axis=0), (3, 1)))
    assert not inside.any()


def test_tensors_give_it_back_to_the_bit_and_damage_is_refused_by_name(fallback, trained) -> None:
    again = Fallback.from_tensors(fallback.to_tensors(), channels=BIOTAC)
    assert [again.score(one) for one in trained] == [fallback.score(one) for one in trained]

    def check(rule: str, name: str, value: Any) -> None:
        tensors = fallback.to_tensors() | {name: value}
        if value is None:
            del tensors[name]
        with pytest.raises(ModelError, match=rule):
            Fallback.from_tensors(tensors, channels=BIOTAC)

    cases = [
        ("span: is missing", "span", None),
        (r"known: shape \(9, 7\) is not \(9, 8\)", "known", np.zeros((9, 7), np.float32)),
        (r"known: shape \(\) is not \(-1, 8\)", "known", np.array(1.0, np.float32)),
        ("known: .* not within", "known", np.full((9, 8), np.nan, np.float32)),
        ("known, span: too few clouds", "known", np.zeros((2, 8), np.float32)),
        ("scale: .* not within", "scale", np.zeros(8)),
        ("known, span: .* a span that is empty", "span", np.array([2.0, 2.0])),
    ]
    every_case(cases, check)


def test_lengths_may_leave_their_range_by_a_tenth_of_it() -> None:
    check = LengthRangeCheck.fit(np.array([[1.0] * 5, [2.0] * 5]))
    rows = np.array([[0.91, 1.0, 1.5, 2.0, 2.09], [0.89, 1.5, 1.5, 1.5, 1.5], [1.5] * 4 + [2.11]])
    assert check.within(rows).tolist() == [True, False, False]
    assert not check.within(np.full((1, 5), np.nan)).any()
    again = LengthRangeCheck.from_card(check.to_card())
    assert_array_equal([again.low, again.high], [check.low, check.high])
    for wrong in (None, [1.0], [2.0, 1.0], ["a", "b"]):
        with pytest.raises(ModelError, match=r"familiar: must give \[low, high\] for each of range_m"):
            LengthRangeCheck.from_card(check.to_card() | {"gap_m": wrong})
