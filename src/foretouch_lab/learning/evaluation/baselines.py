# SPDX-License-Identifier: Apache-2.0
"""Baselines: predictors without a cloud, or with a few geometric features of it, that a model has to beat.

With few objects, each recorded on different days, object, time and sensor drift are confounded: a model may seem to
predict touch from shape while it only recognises the recording session. The object mean and the trees on object and
time show how far that alone goes.
"""

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

import numpy as np

from foretouch.types import Float64, Sample
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.data.folds import Fold

_CONTACT_RADIUS_M: Final = 0.02  # about the size of a fingertip's pad


def _geometry_features(sample: Sample) -> Float64:
    """Return (44,) float64: lengths in metres, camera frame; contacts relative to the centroid.

    Centroid, extents, spreads along the principal axes, radius and logarithm of the number of points; g1, g2, width, offset
    of the midpoint, rotation; of the points near each contact their share, spreads, gap and mean offset. Where no point is
    near a contact, its share, spreads and offset are 0.
    """
    xyz = sample.cloud.finite.astype(np.float64)
    centroid = xyz.mean(axis=0)
    centred = xyz - centroid
    grasp = sample.grasp
    radius = float(np.linalg.norm(centred, axis=1).max())
    return np.concatenate(
        [
            centroid,
            np.ptp(xyz, axis=0),
            _spreads(centred),
            [radius, np.log(len(xyz))],
            grasp.g1 - centroid,
            grasp.g2 - centroid,
            [grasp.width_m, float(np.linalg.norm(grasp.midpoint - centroid))],
            grasp.rotation.reshape(-1),
            _contact(xyz, grasp.g1),
            _contact(xyz, grasp.g2),
        ]
    )


def _contact(xyz: Float64, contact: Float64) -> Float64:
    offset = xyz - contact
    distance = np.linalg.norm(offset, axis=1)
    near = offset[distance < _CONTACT_RADIUS_M]
    if len(near) == 0:
        return np.array([0.0, 0.0, 0.0, 0.0, distance.min(), 0.0, 0.0, 0.0])
    mean = near.mean(axis=0)
    return np.concatenate([[len(near) / len(xyz)], _spreads(near - mean), [distance.min()], mean])


def _spreads(centred: Float64) -> Float64:
    """Return (3,) standard deviations along the principal axes [m], ascending."""
    values = np.linalg.eigvalsh(centred.T @ centred / len(centred))
    return np.asarray(np.sqrt(np.maximum(values, 0.0)), np.float64)


def _pose_free_features(sample: Sample) -> Float64:
    """Return (28,) float64: `_geometry_features` without the pose of the camera.

    Centroid, extents along the camera's axes, rotation and the number of points are left out; places of the contacts, and of
    the points near them, are in the frame of the hand, x away from the camera.
    """
    every, hand = _geometry_features(sample), sample.grasp.rotation
    hand = hand * np.array([-1.0, -1.0, 1.0]) if hand[2, 0] < 0.0 else hand
    turned = [every[at : at + 3] @ hand for at in (11, 14, 33, 41)]
    return np.concatenate([every[6:10], *turned[:2], every[17:19], every[28:33], turned[2], every[36:41], turned[3]])


TREES: Final = 300
"""Trees of a forest."""

_DAY_NS: Final = 86_400e9
_MEMORY_DAYS: Final = 10.0
_LEAF: Final = 3
_FEATURE_SHARE: Final = 0.5

Baseline: TypeAlias = Callable[[Sequence[Sample], Float64, Sequence[Sample], int], Float64]
"""Fits to training samples and their (S, D) labels, and gives (T, D) predictions of test samples [counts]; the last is the seed."""


def training_mean(_train: Sequence[Sample], labels: Float64, test: Sequence[Sample], _seed: int) -> Float64:
    """Return the mean of all labels for every sample: skill 0 by definition."""
    return np.tile(labels.mean(axis=0), (len(test), 1))


def object_mean(train: Sequence[Sample], labels: Float64, test: Sequence[Sample], seed: int) -> Float64:
    """Return the mean of the labels of the same object; the training mean where the object is new."""
    predicted = training_mean(train, labels, test, seed)
    known = np.array([sample.object for sample in train])
    for name in np.unique(known):
        predicted[[i for i, sample in enumerate(test) if sample.object == name]] = labels[known == name].mean(axis=0)
    return predicted


def object_time_trees(
    train: Sequence[Sample], labels: Float64, test: Sequence[Sample], seed: int, trees: int = TREES
) -> Float64:
    """Fit extremely randomised trees on object and time of recording alone."""
    names = sorted({sample.object for sample in train})
    return _forest(_object_time(train, names), labels, _object_time(test, names), seed, trees)


def geometry_trees(
    train: Sequence[Sample], labels: Float64, test: Sequence[Sample], seed: int, trees: int = TREES
) -> Float64:
    """Fit extremely randomised trees on `_geometry_features`."""
    known, asked = (np.array([_geometry_features(sample) for sample in side]) for side in (train, test))
    return _forest(known, labels, asked, seed, trees)


def geometry_trees_pose_free(
    train: Sequence[Sample], labels: Float64, test: Sequence[Sample], seed: int, trees: int = TREES
) -> Float64:
    """Fit extremely randomised trees on `_pose_free_features`: what a model knows that ignores where the camera is."""
    known, asked = (np.array([_pose_free_features(sample) for sample in side]) for side in (train, test))
    return _forest(known, labels, asked, seed, trees)


def clock(train: Sequence[Sample], labels: Float64, test: Sequence[Sample], _seed: int) -> Float64:
    """Return the level of the sensors at the time of recording, without the cloud: what drift alone predicts of any object.

    The mean of a Gaussian process in time [Rasmussen and Williams 2006, eq. 2.25]: a level with a memory of 10 days, an
    effect of each object and noise, with variances of 1, 1 and 1, around the mean of the labels. It knows the recordings
    before and after each sample.
    """
    known, wanted = (np.array([sample.stamp_ns for sample in side]) / _DAY_NS for side in (train, test))
    objects, mean = np.array([sample.object for sample in train]), labels.mean(axis=0)
    covariance = _level(known, known) + (objects[:, None] == objects)
    weight = np.linalg.solve(covariance + np.eye(len(known)), labels - mean)
    return np.asarray(mean + _level(wanted, known) @ weight, np.float64)


def _level(days: Float64, other: Float64) -> Float64:
    return np.asarray(np.exp(-np.abs(days[:, None] - other) / _MEMORY_DAYS), np.float64)


def predict_part(baseline: Baseline, samples: Sequence[Sample], seed: int, fold: Fold) -> Float64:
    """Return (T, D) predictions of the test side of a fold by a baseline that is fitted to its training side [counts].

    Args:
        baseline: The baseline.
        samples: All samples.
        seed: For what is drawn at random.
        fold: Its sides.
    """
    train, test = fold.sides(samples)
    return baseline(train, labels_of(train), test, seed)


BASELINES: Final[dict[str, Baseline]] = {
    predict.__name__: predict
    for predict in (training_mean, object_mean, object_time_trees, geometry_trees, geometry_trees_pose_free)
}


def _object_time(samples: Sequence[Sample], names: Sequence[str]) -> Float64:
    """Return (S, 1 + objects): time in days, then the object one-hot; all zero for an object unseen in training."""
    days = [sample.stamp_ns / _DAY_NS for sample in samples]
    return np.column_stack([days, [[float(sample.object == name) for name in names] for sample in samples]])


def _forest(train: Float64, labels: Float64, test: Float64, seed: int, trees: int) -> Float64:
    from sklearn.ensemble import ExtraTreesRegressor

    forest = ExtraTreesRegressor(
        n_estimators=trees, min_samples_leaf=_LEAF, max_features=_FEATURE_SHARE, random_state=seed, n_jobs=1
    )
    scale = labels.std(axis=0) + 1e-9  # so that no electrode outweighs another in the choice of a split
    forest.fit(train, labels / scale)
    return np.asarray(forest.predict(test) * scale, np.float64)
