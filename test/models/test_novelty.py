# SPDX-License-Identifier: Apache-2.0
"""Novelty detection: training objects are in distribution, objects of another size are not, wherever they lie."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from contact_model_builders import cylinder
from numpy.testing import assert_array_equal

from foretouch.errors import ModelError
from foretouch.models.contact.features import ContactScene
from foretouch.models.novelty import LengthRangeCheck, SizeNoveltyDetector

HERE = np.array([0.0, 0.0, 1.2])
SIDES = np.array([[0.05, 0.08, 0.1], [0.06, 0.06, 0.15], [0.1, 0.12, 0.05]])


def box(sides: np.ndarray, rng: np.random.Generator, points: int = 300) -> np.ndarray:
    return rng.uniform(-0.5, 0.5, (points, 3)) * sides * rng.normal(1.0, 0.03, 3)


def sizes(xyz: np.ndarray) -> np.ndarray:
    return ContactScene(xyz).object_features


@pytest.fixture
def trained(rng: np.random.Generator) -> np.ndarray:
    """Twenty clouds of each of three boxes."""
    return np.array([sizes(HERE + box(one, rng)) for one in SIDES for _ in range(20)])


def test_training_clouds_and_other_views_of_them_are_in_distribution(trained, rng) -> None:
    novelty = SizeNoveltyDetector.fit(trained)
    assert all(novelty.in_distribution_score(one) >= 0.5 for one in trained)
    others = [novelty.in_distribution_score(sizes(HERE + box(one, rng))) for one in SIDES for _ in range(30)]
    assert np.mean(np.array(others) >= 0.5) >= 0.9  # about the quantile of the usual distances


def test_a_house_and_a_pea_are_not(trained, rng) -> None:
    novelty = SizeNoveltyDetector.fit(trained)
    for sides in (SIDES[0] * 100.0, SIDES[0] / 20.0):
        assert novelty.in_distribution_score(sizes(HERE + box(sides, rng))) == 0.0
    assert novelty.in_distribution_score(sizes(cylinder(0.2, HERE))) == 0.0


def test_the_score_falls_as_an_object_grows(trained, rng) -> None:
    novelty = SizeNoveltyDetector.fit(trained)
    cloud = box(SIDES[2], rng)
    found = [novelty.in_distribution_score(sizes(HERE + factor * cloud)) for factor in np.linspace(1.0, 3.0, 30)]
    assert (np.diff(found) <= 1e-12).all()
    assert (found[0], found[-1]) == (1.0, 0.0)


def test_where_an_object_lies_does_not_matter(trained, rng) -> None:
    novelty = SizeNoveltyDetector.fit(trained)
    cloud = box(SIDES[1] * 1.15, rng)
    near, far = (
        novelty.in_distribution_score(sizes(cloud + np.array([x, 0.0, z]))) for x, z in ((0.0, 1.0), (0.7, 2.5))
    )
    assert near == pytest.approx(far, abs=1e-9)


def test_the_span_holds_the_usual_distances_within_training(trained) -> None:
    novelty = SizeNoveltyDetector.fit(trained)
    known = novelty.known.astype(np.float64)
    distance = np.abs(known[:, None] - known[None]).sum(axis=2)
    np.fill_diagonal(distance, np.inf)
    nearest = np.sort(distance, axis=1)[:, :3].mean(axis=1)
    assert (nearest <= novelty.span[0]).mean() == pytest.approx(0.90, abs=0.02)
    assert (nearest <= novelty.span[1]).mean() == pytest.approx(0.97, abs=0.02)


def test_one_size_in_all_of_training_is_finite(trained) -> None:
    novelty = SizeNoveltyDetector.fit(np.tile(trained[0], (8, 1)))
    assert novelty.in_distribution_score(trained[0]) == pytest.approx(1.0)
    assert novelty.in_distribution_score(trained[-1]) == 0.0


def test_tensors_give_it_back_to_the_bit(trained) -> None:
    novelty = SizeNoveltyDetector.fit(trained)
    again = SizeNoveltyDetector.from_tensors(novelty.to_tensors())
    assert_array_equal(
        [again.in_distribution_score(one) for one in trained], [novelty.in_distribution_score(one) for one in trained]
    )


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("span", None, "span: is missing"),
        ("centre", np.zeros(7), r"centre: shape \(7,\) is not \(8,\)"),
        ("known", np.zeros((9, 7), np.float32), "known: shape"),
        ("known", np.array(1.0, np.float32), r"known: shape \(\) is not"),
        ("known", np.full((9, 8), np.nan, np.float32), "known: .* or a value is not finite"),
        ("known", np.zeros((2, 8), np.float32), "known, span: too few clouds"),
        ("scale", np.zeros(8), "scale: a value is not above 0"),
        ("span", np.array([2.0, 2.0]), "known, span: .* a span that is empty"),
    ],
)
def test_damage_is_refused_by_name(trained, name: str, value: Any, rule: str) -> None:
    tensors = SizeNoveltyDetector.fit(trained).to_tensors() | {name: value}
    if value is None:
        del tensors[name]
    with pytest.raises(ModelError, match=rule):
        SizeNoveltyDetector.from_tensors(tensors)


def test_lengths_may_leave_their_range_by_a_tenth_of_it() -> None:
    check = LengthRangeCheck.fit(np.array([[1.0] * 5, [2.0] * 5]))
    rows = np.array([[0.91, 1.0, 1.5, 2.0, 2.09], [0.89, 1.5, 1.5, 1.5, 1.5], [1.5] * 4 + [2.11]])
    assert check.within(rows).tolist() == [True, False, False]
    assert not check.within(np.full((1, 5), np.nan)).any()
    again = LengthRangeCheck.from_card(check.to_card())
    assert_array_equal([again.low, again.high], [check.low, check.high])


@pytest.mark.parametrize("change", [{"gap_m": None}, {"gap_m": [1.0]}, {"gap_m": [2.0, 1.0]}, {"gap_m": ["a", "b"]}])
def test_ranges_of_a_card_that_cannot_be_right_are_refused(change: dict[str, Any]) -> None:
    card = LengthRangeCheck(np.zeros(5), np.ones(5)).to_card() | change
    with pytest.raises(ModelError, match=r"familiar: must give \[low, high\] for each of range_m"):
        LengthRangeCheck.from_card(card)
