# SPDX-License-Identifier: Apache-2.0
"""The contact model: forests on known objects, the kernel and its gain on new ones, and what it calls unfamiliar."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_model_builders import moved, scaled, small_estimator
from every_case import every_case
from experiment_samples import make_samples
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from foretouch.errors import ModelError
from foretouch.models.contact.estimator import ContactEstimator, NoveltyDetector
from foretouch.models.contact.features import CONDITIONS, FEATURES, OBJECT_FEATURES, HandFrameFeatures
from foretouch.tactile import BIOTAC, MODALITIES, P2_RANGES
from foretouch.types import Cloud, Grasp, Plane

SAMPLES = make_samples(5, 10)


@pytest.fixture
def estimator() -> ContactEstimator:
    return small_estimator()


def with_span(estimator: ContactEstimator, low: float, high: float) -> ContactEstimator:
    """The same with scores of 1 up to the distance `low`, and of 0 from `high`."""
    novelty = estimator.novelty
    whole = replace(novelty.whole, span=np.array([low, high]))
    return replace(estimator, novelty=replace(novelty, whole=whole))


def test_forests_predict_known_objects_the_gain_of_the_kernel_new_ones_and_a_blend_between(estimator) -> None:
    cloud, grasp = scaled(SAMPLES[3].cloud, 1.1), SAMPLES[3].grasp
    rows = HandFrameFeatures(cloud.xyz).describe([grasp])
    inputs, whole = rows[:, len(CONDITIONS) :], estimator.novelty.whole
    sizes = rows[:, [FEATURES.index(name) for name in OBJECT_FEATURES]]
    distance = float(np.linalg.norm((sizes - whole.centre) @ whole.turn - whole.known, axis=1).min())
    gain = np.array([0.25, 0.5, 0.0, 1.0])
    kernel = estimator.kernel.predict(inputs) * np.repeat(gain, [1, 1, 24, 24])
    together, forests = estimator.forests["together"].predict(inputs), np.empty((1, 50))
    for name in MODALITIES:
        index = BIOTAC.columns([name])
        forests[:, index] = (together[:, index] + estimator.forests[name].predict(inputs)) / 2.0

    def check(share: float) -> None:
        low, high = (2 * distance, 3 * distance) if share == 1.0 else (0.0, distance / (1.0 - share))
        found = replace(with_span(estimator, low, high), generalisation_gain=gain).estimate(cloud, [grasp])
        wanted = (share * forests + (1.0 - share) * kernel) * estimator.deviation + estimator.mean
        assert_allclose(found.counts, wanted, rtol=1e-9)
        assert found.familiar.tolist() == [share >= 0.5]

    every_case([0.0, 0.25, 0.51, 0.75, 1.0], check)


def test_rows_of_known_and_new_objects_are_predicted_alike_alone_and_together(estimator) -> None:
    known = HandFrameFeatures(SAMPLES[3].cloud.xyz).describe([SAMPLES[3].grasp])
    new = HandFrameFeatures(scaled(SAMPLES[3].cloud, 3.0).xyz).describe([SAMPLES[3].grasp])
    rows = np.concatenate([known, new, np.full_like(known, np.nan)])
    assert estimator.novelty.scores(rows)[:2].tolist() == [1.0, 0.0]
    together = estimator.predict_rows(rows)[0]
    assert np.isnan(together).all(axis=1).tolist() == [False, False, True]
    for k in range(len(rows)):
        np.testing.assert_array_equal(estimator.predict_rows(rows[[k]])[0], together[[k]])
    assert estimator.predict_rows(rows[:0])[0].shape == (0, 50)


def test_damage_is_refused_by_part_and_name(estimator) -> None:
    def check(rule: str, name: str, value: Any) -> None:
        tensors = dict(estimator.to_tensors())
        tensors[name] = value(tensors[name]) if callable(value) else value
        if value is None:
            del tensors[name]
        with pytest.raises(ModelError, match=f"^{rule}"):
            ContactEstimator.from_tensors(tensors, P2_RANGES.ranges)

    cases = [
        ("deviation: .* of another shape", "deviation", np.ones(49)),
        ("mean: .* not finite", "mean", np.full(50, np.nan)),
        (r"generalisation_gain: a value is not in \[0, 1\]", "generalisation_gain", np.full(4, 1.5)),
        ("forest_E_TH/leaf: is missing", "forest_E_TH/leaf", None),
        ("forest_together: does not fit 56 features and 50", "forest_together/value", lambda a: a[:, :49]),
        ("forest_PDC_MF: does not fit 56", "forest_PDC_MF/feature", lambda a: a + a.dtype.type(56) * (a >= 0)),
        ("kernel: does not fit 56 features and 50 values", "kernel/weight", lambda a: a[:, :49]),
        (r"novelty/limits/low: shape \(3,\) is not \(6,\)", "novelty/limits/low", lambda a: a[:3]),
        ("novelty/whole/known, span: ", "novelty/whole/span", np.array([1.0, 0.0])),
        (r"novelty/upper/turn: shape \(11, 11\) is not \(10, 10\)", "novelty/upper/centre", lambda a: a[:10]),
    ]
    every_case(cases, check)


def turned_by(degrees: float, one) -> tuple[Cloud, list]:
    """Cloud and grasp, seen by a camera that is tilted against them."""
    R = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    centre = np.asarray(one.cloud.xyz.reshape(-1, 3).mean(axis=0), np.float64)
    shift = centre - R @ centre
    xyz = (one.cloud.xyz.reshape(-1, 3).astype(np.float64) @ R.T + shift).astype(np.float32)
    return Cloud(xyz), [moved(one.grasp, R, shift)]


def test_what_training_never_covered_is_unfamiliar(estimator) -> None:
    flagged = {"half the range": 0, "far away": 0, "few points": 0, "another approach": 0, "as trained": 0}
    for sample in SAMPLES[::5]:
        xyz = sample.cloud.xyz.reshape(-1, 3)
        centre = xyz.mean(axis=0)
        places = {"half the range": -0.55 * centre, "far away": 1.5 * centre}
        for name, shift in places.items():
            grasp = moved(sample.grasp, np.eye(3), shift.astype(np.float64))
            flagged[name] += not estimator.estimate(Cloud(xyz + shift), [grasp]).familiar[0]
        few = Cloud(xyz[np.random.default_rng(0).permutation(len(xyz))[: len(xyz) // 10]])
        flagged["few points"] += not estimator.estimate(few, [sample.grasp]).familiar[0]
        flagged["another approach"] += not estimator.estimate(*turned_by(80.0, sample)).familiar[0]
        flagged["as trained"] += not estimator.estimate(sample.cloud, [sample.grasp]).familiar[0]
    assert flagged.pop("as trained") <= 2
    assert (
        flagged.pop("half the range") + flagged.pop("far away") <= 4
    )  # where the camera stands is no part of the object
    assert set(flagged.values()) == {10}


def box_seen(edges: tuple[float, float, float], tilt_deg: float, turn_deg: float) -> tuple[np.ndarray, Plane, Grasp]:
    """A box that stands on a table, 0.8 m from a tilted camera: the points that it sees, the table, and a grasp across."""
    size = np.array(edges)
    faces = []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        u, v = np.meshgrid(*(np.arange(-size[k] / 2.0, size[k] / 2.0, 0.0025) for k in others))
        for side in (-1.0, 1.0):
            points = np.full((u.size, 3), side * size[axis] / 2.0)
            points[:, others] = np.stack([u.ravel(), v.ravel()], axis=1)
            faces.append((points, side * np.eye(3)[axis]))
    turn = Rotation.from_euler("xz", [180.0 - tilt_deg, turn_deg], degrees=True).as_matrix()  # z of the table is up
    centre = np.array([0.0, 0.0, 0.8])
    seen = [points @ turn.T + centre for points, normal in faces if (turn @ normal) @ centre < 0.0]
    up, across = turn[:, 2], turn[:, 0]
    ends = centre + 0.5 * size[0] * across, centre - 0.5 * size[0] * across
    grasp = Grasp(*ends, np.stack([-up, np.cross(across, -up), across], axis=1))
    return np.concatenate(seen), Plane(up, size[2] / 2.0 - float(up @ centre)), grasp


def test_known_objects_are_known_in_views_that_training_has_not_and_others_are_not() -> None:
    boxes = {
        "low": (0.05, 0.12, 0.04),
        "cube": (0.07, 0.07, 0.07),
        "bar": (0.04, 0.18, 0.05),
        "tall": (0.06, 0.10, 0.13),
    }

    def rows(edges: tuple[float, float, float], tilt_deg: float) -> np.ndarray:
        views = (box_seen(edges, tilt_deg, turn_deg) for turn_deg in (5.0, 31.0, 62.0, 77.0))
        return np.concatenate([HandFrameFeatures(points, table).describe([grasp]) for points, table, grasp in views])

    objects = np.repeat(list(boxes), 4).tolist()
    novelty = NoveltyDetector.fit(np.concatenate([rows(edges, 1.0) for edges in boxes.values()]), objects)
    for tilt_deg in (1.0, 40.0, 55.0):
        known = np.concatenate([novelty.scores(rows(edges, tilt_deg)) for edges in boxes.values()])
        assert np.mean(known < 0.5) <= 0.1, tilt_deg
        for other, reason in (((0.07, 0.30, 0.05), "larger_object"), ((0.055, 0.14, 0.09), "other_shape")):
            strange = rows(other, tilt_deg)
            assert (novelty.scores(strange) < 0.5).all(), (tilt_deg, other)
            assert novelty.reasons(strange)[reason].all(), (tilt_deg, other)
