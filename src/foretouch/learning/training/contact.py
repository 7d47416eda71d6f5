# SPDX-License-Identifier: Apache-2.0
"""Fit the contact model: forests by scikit-learn, and a kernel whose ridge is chosen on objects left out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import CloudError, ConfigError, DatasetError
from foretouch.learning.data.folds import Fold, group_folds
from foretouch.models.contact.estimator import TOGETHER, ContactEstimator
from foretouch.models.contact.features import OBJECT_FEATURES, ContactScene
from foretouch.models.contact.forest import Forest
from foretouch.models.contact.kernel_regression import KernelRegression, laplacian, standardisation
from foretouch.models.novelty import SizeNoveltyDetector
from foretouch.tactile import MODALITIES, P2_RANGES, TactileRanges, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

__all__ = [
    "ContactConfig",
    "describe_objects",
    "describe_samples",
    "fit_contact",
    "object_folds",
    "rest_level",
    "resting_labels",
]

_FEWEST_SAMPLES: Final = 5
_MOST_FOLDS: Final = 10
_PDC_REST, _ELECTRODE_REST = 0.01, 0.95  # quantiles of the labels: PDC rises with pressure, electrodes fall


@dataclass(frozen=True, kw_only=True)
class ContactConfig(Settings):
    """How a contact model is fitted."""

    trees: int = setting(150, "Trees of each forest", minimum=1, maximum=10_000)
    leaf: int = setting(3, "Fewest samples in a leaf", minimum=1, maximum=1000)
    feature_share: float = setting(1.0, "Share of the features tried at each split", minimum=0.01, maximum=1.0)
    decay: float = setting(2.0, "Of the kernel, over the mean distance per standardised feature", minimum=0.01)
    ridges: tuple[float, ...] = setting(
        (0.3, 1.0, 3.0, 10.0),
        "Noise over signal that the kernel may assume; chosen on objects left out",
        minimum=1e-3,
    )
    seed: int = setting(0, "Of the trees", minimum=0)
    ranges: TactileRanges = P2_RANGES

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.ridges:
            raise ConfigError("ContactConfig.ridges: [] must hold at least one value")


def describe_samples(samples: Sequence[GraspSample]) -> Float64:
    """(S, len(FEATURES)) float64: each sample's own grasp on its own cloud.

    Raises:
        DatasetError: If a cloud cannot be used; named by id.
    """
    return np.concatenate([_scene(sample).describe([sample.grasp]) for sample in samples])


def describe_objects(samples: Sequence[GraspSample]) -> Float64:
    """(S, len(OBJECT_FEATURES)) float64: each sample's cloud, whatever its grasp.

    Raises:
        DatasetError: If a cloud cannot be used; named by id.
    """
    return np.array([_scene(sample).object_features for sample in samples])


def _scene(sample: GraspSample) -> ContactScene:
    try:
        return ContactScene(sample.cloud.xyz)
    except CloudError as err:
        raise DatasetError(f"{sample.id}: {err}") from err


def rest_level(samples: Sequence[GraspSample]) -> tuple[Float64, bool]:
    """What the sensors read without contact, and whether tares tell it.

    Without any tare it is guessed from the labels, channel by channel: pressure from its low end, electrodes, which
    contact lowers, from their high end.

    Args:
        samples: Labelled, at least one.

    Returns:
        (50,) [counts]; True if it is the mean of recorded tares.
    """
    tares = [sample.tare.vector() for sample in samples if sample.tare is not None]
    if tares:
        return np.mean(tares, axis=0), True
    labels = np.array([sample.touch.vector() for sample in samples if sample.touch is not None])
    rest = np.quantile(labels, _ELECTRODE_REST, axis=0)
    pressure = columns(["PDC_TH", "PDC_MF"])
    rest[pressure] = np.quantile(labels[:, pressure], _PDC_REST, axis=0)
    return rest, False


def resting_labels(samples: Sequence[GraspSample], labels: Float64, rest: Float64) -> Float64:
    """(S, 50) labels as sensors at rest level `rest` would have read them: moved by each sample's tare, where it has one."""
    moved = labels.copy()
    for k, sample in enumerate(samples):
        if sample.tare is not None:
            moved[k] -= sample.tare.vector() - rest
    return moved


def object_folds(objects: Sequence[str]) -> list[Fold]:
    """One object left out at a time, or a tenth of them where there are more than ten.

    Raises:
        DatasetError: If there is one object only.
    """
    if len(set(objects)) <= _MOST_FOLDS:
        return group_folds(objects)
    return group_folds(objects, _MOST_FOLDS, np.random.default_rng(0))


def fit_contact(rows: Float64, labels: Float64, objects: Sequence[str], config: ContactConfig) -> ContactEstimator:
    """Fit forests, kernel and novelty.

    Args:
        rows: (S, F) of `describe_samples`.
        labels: (S, 50) [counts].
        objects: (S,) names.
        config: How.

    Raises:
        DatasetError: If there are fewer than five samples, or a label never changes.
    """
    if len(rows) < _FEWEST_SAMPLES:
        raise DatasetError(f"contact model: {len(rows)} samples are fewer than {_FEWEST_SAMPLES}")
    mean, deviation = labels.mean(axis=0), labels.std(axis=0)
    if not (span := np.ptp(labels, axis=0)).all():
        raise DatasetError(f"contact model: value {int(np.argmin(span))} of the touch is the same in all samples")
    scaled = (labels - mean) / deviation
    return ContactEstimator(
        forests={name: _forest(rows, scaled[:, place], config) for name, place in _targets()},
        kernel=_kernel(rows, scaled, objects, config),
        novelty=SizeNoveltyDetector.fit(rows[:, : len(OBJECT_FEATURES)]),
        mean=mean,
        deviation=deviation,
        ranges=config.ranges,
    )


def _targets() -> Iterator[tuple[str, npt.NDArray[np.intp]]]:
    yield TOGETHER, np.arange(TOUCH_SIZE)
    for name in MODALITIES:
        yield name, columns([name])


def _forest(rows: Float64, scaled: Float64, config: ContactConfig) -> Forest:
    from sklearn.ensemble import ExtraTreesRegressor

    fitted = ExtraTreesRegressor(
        config.trees,
        min_samples_leaf=config.leaf,
        max_features=config.feature_share,
        random_state=config.seed,
        n_jobs=1,
    ).fit(rows, scaled if scaled.shape[1] > 1 else scaled[:, 0])
    return Forest.from_trees([tree.tree_ for tree in fitted.estimators_])


def _kernel(rows: Float64, scaled: Float64, objects: Sequence[str], config: ContactConfig) -> KernelRegression:
    ridge = _choose_ridge(rows, scaled, objects, config)
    centre, scale = standardisation(rows)
    known = (rows - centre) / scale
    weight = _ridge_weights(laplacian(known, known, config.decay), scaled, ridge)
    return KernelRegression(
        centre, scale, known.astype(np.float32), weight.astype(np.float32), np.array(config.decay, np.float64)
    )


def _choose_ridge(rows: Float64, scaled: Float64, objects: Sequence[str], config: ContactConfig) -> float:
    """The ridge of least squared error on objects left out, each modality weighing the same.

    One for all values: chosen for each, it follows the accidents of a handful of objects. A single object tells nothing of
    others, so the largest is taken.
    """
    if len(set(objects)) < 2:
        return max(config.ridges)
    errors = np.zeros((len(config.ridges), TOUCH_SIZE))
    for fold in object_folds(objects):
        centre, scale = standardisation(rows[fold.train])
        known, asked = ((rows[index] - centre) / scale for index in (fold.train, fold.test))
        mean = scaled[fold.train].mean(axis=0)
        kernel, cross = laplacian(known, known, config.decay), laplacian(asked, known, config.decay)
        for k, ridge in enumerate(config.ridges):
            weight = _ridge_weights(kernel, scaled[fold.train] - mean, ridge)
            errors[k] += ((cross @ weight + mean - scaled[fold.test]) ** 2).sum(axis=0)
    total = sum(errors[:, columns([name])].mean(axis=1) for name in MODALITIES)
    return config.ridges[int(np.argmin(total))]


def _ridge_weights(kernel: Float64, scaled: Float64, ridge: float) -> Float64:
    """(S, M) solution of (K + ridge I) weight = scaled."""
    from scipy.linalg import cho_factor, cho_solve

    return np.asarray(cho_solve(cho_factor(kernel + ridge * np.eye(len(kernel))), scaled), np.float64)
