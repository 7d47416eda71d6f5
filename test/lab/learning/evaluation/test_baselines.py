# SPDX-License-Identifier: Apache-2.0
"""Baselines: what they see, and what they must not see."""

import dataclasses

import numpy as np
from numpy.testing import assert_allclose

from foretouch.types import Cloud
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.evaluation.baselines import (
    clock,
    geometry_trees,
    object_mean,
    object_time_trees,
    training_mean,
)


def test_means_of_training_and_of_known_and_new_objects(samples) -> None:
    labels = labels_of(samples[:40])
    assert_allclose(training_mean(samples[:40], labels, samples[40:], 0), np.tile(labels.mean(axis=0), (20, 1)))
    train = [sample for sample in samples if sample.object != "box3"]
    labels = labels_of(train)
    new = next(sample for sample in samples if sample.object == "box3")
    predicted = object_mean(train, labels, [train[0], new], 0)
    same = np.array([sample.object == train[0].object for sample in train])
    assert_allclose(predicted[0], labels[same].mean(axis=0))
    assert_allclose(predicted[1], labels.mean(axis=0))


def test_object_time_trees_are_blind_and_geometry_trees_find_what_geometry_tells(samples) -> None:
    labels = labels_of(samples[:40])
    blind = [
        dataclasses.replace(sample, cloud=Cloud(np.ones((1, 3), np.float32)), grasp=samples[0].grasp, touch=None)
        for sample in samples[40:]
    ]
    one, other = (object_time_trees(samples[:40], labels, asked, 1) for asked in (blind, samples[40:]))
    assert_allclose(one, other)
    train, test = samples[:45], samples[45:]
    labels, actual = labels_of(train), labels_of(test)
    predicted = geometry_trees(train, labels, test, 1)
    mean = training_mean(train, labels, test, 1)
    assert ((predicted - actual) ** 2).mean() < 0.5 * ((mean - actual) ** 2).mean()
    assert np.array_equal(predicted, geometry_trees(train, labels, test, 1))


def test_the_clock_knows_the_time_and_nothing_else(samples) -> None:
    ordered = sorted(samples, key=lambda sample: sample.stamp_ns)
    train, test = ordered[:-10], ordered[-10:]
    labels = labels_of(train)
    one_time = [dataclasses.replace(sample, stamp_ns=test[0].stamp_ns) for sample in test]
    assert np.ptp(clock(train, labels, one_time, 0), axis=0).max() < 1e-9
    assert np.abs(clock(train, labels, test, 0) - labels.mean(axis=0)).max() > 1e-3
