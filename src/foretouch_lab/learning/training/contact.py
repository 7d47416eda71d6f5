# SPDX-License-Identifier: Apache-2.0
"""Fit the contact model: forests by scikit-learn, and a kernel whose ridge and gain are chosen on objects left out.

The generalisation gain says how far the kernel holds on objects that it was not fitted to. The kernel predicts each
training object from the others. What held there is a share λ of its predicted differences from the mean, one for each modality: the slope of the actual differences over the predicted ones, where every object weighs
the same, since it is divided by its own error of the mean. The share is shrunk by how much it changes with the objects,
as the jackknife over objects shows [Efron and Stein 1981]: λ · max(0, 1 - var(λ) / λ²), within [0, 1].

Objects differ in more than their shape shows, and a training set of a few objects confounds the two. The kernel is
fitted beside an effect of each object, as in a mixed model [Rasmussen and Williams 2006, section 2.7]: K + ρ [same
object] + ridge I. What is special to an object is then not taken for a consequence of its shape, and the effect of an
unknown object is zero.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import CloudError, DatasetError
from foretouch.models.contact.estimator import TOGETHER, ContactEstimator, NoveltyDetector
from foretouch.models.contact.features import CONDITIONS, HandFrameFeatures
from foretouch.models.contact.regressors import Forest, KernelRegression, laplacian
from foretouch.models.novelty import object_sizes, standardisation
from foretouch.tactile import BIOTAC, P2_RANGES, Ranges, TactileRanges
from foretouch.types import Float64, Sample
from foretouch.types.channels import Channels
from foretouch_lab.learning.data import channels_of
from foretouch_lab.learning.data.folds import Indices, object_folds
from foretouch_lab.learning.training.calibration import rest_level, resting_labels

DECAY: Final = 2.0
"""Of the kernel, over the mean distance per standardised feature."""

_OBJECT_EFFECT: Final = 1.0  # variance of what is an object's own, beside its shape, over the variance of the kernel
_RIDGES: Final = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # candidates for the ratio of noise to signal


def _training_kernel(known: Float64, objects: Sequence[str] | npt.NDArray[np.str_]) -> Float64:
    """Return (S, S) kernel of (S, F) standardised rows with the effects of their objects, before the ridge."""
    _, index = np.unique(np.asarray(objects), return_inverse=True)
    return np.asarray(laplacian(known, known, DECAY) + _OBJECT_EFFECT * (index[:, None] == index), np.float64)


def choose_ridge(rows: Float64, scaled: Float64, objects: Sequence[str], channels: Channels) -> tuple[float, Float64]:
    """Return the ridge of least error on objects left out, each object and modality weighing the same, and its gain there.

    Args:
        rows: (S, F) features.
        scaled: (S, D) standardised labels.
        objects: (S,) names.
        channels: Of the labels.

    Returns:
        The ridge, and (M,) gains λ of the modalities; of a single object the largest ridge and zeros.
    """
    if len(set(objects)) < 2:
        return max(_RIDGES), np.zeros(len(channels.modalities))
    products, powers = _held_out(rows, scaled, np.asarray(objects), channels)
    best = int(np.argmin((powers - 2.0 * products).sum(axis=(1, 2))))
    return _RIDGES[best], np.array([shrunken_slope(*terms) for terms in zip(products[best], powers[best], strict=True)])


def _held_out(
    rows: Float64, scaled: Float64, objects: npt.NDArray[np.str_], channels: Channels
) -> tuple[Float64, Float64]:
    """Return (R, M, G) sums of predicted times actual differences from the mean, and of squared predicted ones.

    Both are divided by the object's sum of squared actual differences.
    """
    groups = np.unique(objects)
    products, powers = (np.zeros((len(_RIDGES), len(channels.modalities), len(groups))) for _ in range(2))
    for fold in object_folds(list(objects)):
        centre, scale = standardisation(rows[fold.train])
        known, test = ((rows[index] - centre) / scale for index in (fold.train, fold.test))
        mean = scaled[fold.train].mean(axis=0)
        values, vectors = np.linalg.eigh(_training_kernel(known, objects[fold.train]))
        cross, turned = laplacian(test, known, DECAY) @ vectors, vectors.T @ (scaled[fold.train] - mean)
        actual = scaled[fold.test] - mean
        for r, ridge in enumerate(_RIDGES):
            predicted = cross @ (turned / (values + ridge)[:, None])
            for g in np.flatnonzero(np.isin(groups, objects[fold.test])):
                mine = objects[fold.test] == groups[g]
                for m, own in enumerate(channels.modality_columns.values()):
                    x, y = (part[mine][:, own] for part in (predicted, actual))
                    size = max(float((y * y).sum()), 1e-12)
                    products[r, m, g], powers[r, m, g] = (x * y).sum() / size, (x * x).sum() / size
    return products, powers


def shrunken_slope(products: Float64, powers: Float64) -> float:
    """Return λ of one modality from (G,) products and powers of the objects; 0 where nothing was predicted, or G is 1."""
    total, power = products.sum(), powers.sum()
    left = power - powers
    if len(products) < 2 or left.min() <= 1e-12 or total <= 0.0:
        return 0.0
    slope = total / power
    variance = (len(products) - 1) * ((total - products) / left).var()  # of the jackknife
    return float(np.clip(slope * max(0.0, 1.0 - variance / slope**2), 0.0, 1.0))


FEWEST_SAMPLES: Final = 5
MOST_SAMPLES: Final = 20_000
"""The kernel of their pairs takes 3.2 GB."""

_FEWEST_POINTS: Final = 16  # that a thinned cloud keeps, if it has them


@dataclass(frozen=True, kw_only=True)
class ContactTrainingConfig(Settings):
    """Settings of the fit of a contact model."""

    trees: int = setting(60, "Trees of each forest", bounds=(1, 10_000))
    leaf: int = setting(3, "Fewest samples in a leaf", bounds=(1, 1000))
    thinned: float = setting(
        0.5,
        "Share of the points in copies of the training clouds, to which the forests are fitted as well; 1 fits to no copies",
        bounds=(0.1, 1.0),
    )
    feature_share: float = setting(0.5, "Share of the features tried at each split", bounds=(0.01, 1.0))
    seed: int = setting(0, "Seed of the trees", minimum=0)
    ranges: TactileRanges = P2_RANGES


def describe_samples(samples: Sequence[Sample]) -> Float64:
    """Return (S, F) float64 features of each sample's grasp; raises `DatasetError` if a cloud cannot be used."""
    return np.concatenate(
        [
            _of(sample, lambda shown: HandFrameFeatures(shown.cloud.xyz, shown.table).describe([shown.grasp]))
            for sample in samples
        ]
    )


def describe_objects(samples: Sequence[Sample]) -> Float64:
    """Return (S, 8) float64 `object_sizes` of each sample's cloud; a `DatasetError` names a sample that cannot be described."""
    return np.array([_of(sample, lambda shown: object_sizes(shown.cloud.xyz)) for sample in samples])


def _of(sample: Sample, describe: Callable[[Sample], Float64]) -> Float64:
    try:
        return describe(sample)
    except CloudError as err:
        raise DatasetError(f"{sample.id}: {err}") from err


def _describe_thinned(samples: Sequence[Sample], config: ContactTrainingConfig) -> Float64 | None:
    """Return (S, F) features on clouds with a random share of their points, by the seed; None if the share is 1."""
    if config.thinned == 1.0:
        return None
    rng = np.random.default_rng(config.seed)
    copies = []
    for sample in samples:
        finite = np.flatnonzero(np.isfinite(sample.cloud.xyz.reshape(-1, 3)).all(axis=1))
        kept = rng.permutation(finite)[: max(round(config.thinned * len(finite)), min(len(finite), _FEWEST_POINTS))]
        copies.append(replace(sample, cloud=sample.cloud.take(np.sort(kept))))
    return describe_samples(copies)


def ranges_of(config: ContactTrainingConfig, channels: Channels) -> Ranges:
    """Return ranges of the values of a sensor: for the BioTac SP from the settings, for others from the description.

    Args:
        config: Whose ranges are of the BioTac SP.
        channels: Of the sensor.
    """
    return config.ranges.ranges if channels == BIOTAC else Ranges.of_sensor(channels)


def fit_contact(
    rows: Float64,
    labels: Float64,
    objects: Sequence[str],
    config: ContactTrainingConfig,
    thinned: Float64 | None = None,
    ranges: Ranges | None = None,
) -> ContactEstimator:
    """Fit forests, kernel and novelty detection.

    Args:
        rows: (S, F) of `describe_samples`.
        labels: (S, D) [counts].
        objects: (S,) names.
        config: Settings.
        thinned: (S, F) of the same grasps on thinned clouds. Forests are fitted to both, with twice the samples in a
            leaf.
        ranges: Of the sensor; by default the ranges of the BioTac SP in the settings.

    Raises:
        DatasetError: If there are fewer than five samples or more than `MOST_SAMPLES`, or a tared value of the labels is constant.
    """
    if (missing := FEWEST_SAMPLES - len(rows)) > 0:
        rule = f"{len(rows)} samples are fewer than {FEWEST_SAMPLES}: {missing} more grasps are needed"
        raise DatasetError(f"contact model: {rule}")
    if len(rows) > MOST_SAMPLES:
        raise DatasetError(f"contact model: {len(rows)} samples exceed {MOST_SAMPLES}, whose pairs its kernel holds")
    ranges = ranges or config.ranges.ranges
    channels = ranges.channels
    mean, deviation = labels.mean(axis=0), labels.std(axis=0)
    # Of a value that never changes, such as the force of a taxel beyond all contacts.
    deviation = np.where(deviation > 0.0, deviation, channels.resolution)
    same = np.ptp(labels, axis=0) == 0.0
    # A noisy value is never the same.
    noisy = channels.by_modality([channel.noise > 0.0 for channel in channels.channel_of.values()])
    constant = same & (noisy | same.all())
    if constant.any():
        raise DatasetError(f"contact model: value {int(np.argmax(constant))} of the touch is the same in all samples")
    scaled = (labels - mean) / deviation
    inputs = rows[:, len(CONDITIONS) :]
    ridge, gain = choose_ridge(inputs, scaled, objects, channels)
    kernel = _kernel(inputs, scaled, objects, ridge)
    grown = inputs
    targets = scaled
    leaf = config.leaf
    if thinned is not None:
        grown, targets = np.concatenate([inputs, thinned[:, len(CONDITIONS) :]]), np.concatenate([scaled, scaled])
        leaf = 2 * leaf
    columns = {TOGETHER: np.arange(channels.size), **channels.modality_columns}
    forest_config = config.replace(leaf=leaf)
    forests = {name: _forest(grown, targets[:, own], forest_config) for name, own in columns.items()}
    return ContactEstimator(
        forests, kernel, NoveltyDetector.fit(rows, objects), mean, deviation, generalisation_gain=gain, ranges=ranges
    )


def _forest(rows: Float64, scaled: Float64, config: ContactTrainingConfig) -> Forest:
    from sklearn.ensemble import ExtraTreesRegressor

    fitted = ExtraTreesRegressor(
        config.trees,
        min_samples_leaf=config.leaf,
        max_features=config.feature_share,
        random_state=config.seed,
        n_jobs=1,
    ).fit(rows, scaled if scaled.shape[1] > 1 else scaled[:, 0])
    return Forest.from_trees([tree.tree_ for tree in fitted.estimators_])


def _kernel(rows: Float64, scaled: Float64, objects: Sequence[str], ridge: float) -> KernelRegression:
    from scipy.linalg import cho_factor, cho_solve

    centre, scale = standardisation(rows)
    known = (rows - centre) / scale
    weight = cho_solve(cho_factor(_training_kernel(known, objects) + ridge * np.eye(len(known))), scaled)
    return KernelRegression(centre, scale, known.astype(np.float32), weight.astype(np.float32), np.array(DECAY))


class ContactPredictor:
    """Fits contact models to samples with (S, D) labels [counts], whose features it computes once.

    Attributes:
        rest: (D,) rest level of its predictions [counts].
        rows: (S, F) features of the training samples.
    """

    def __init__(self, train: Sequence[Sample], labels: Float64, config: ContactTrainingConfig) -> None:
        self.rest, _ = rest_level(train)
        self.rows = describe_samples(train)
        self._thinned = _describe_thinned(train, config)
        self._train = list(train)
        self._config = config
        self._ranges = ranges_of(config, channels_of(train))
        self._resting = resting_labels(train, labels, self.rest)

    def fit(self, chosen: Indices, config: ContactTrainingConfig | None = None) -> ContactEstimator:
        """Return a model fitted to some of the training samples, at the rest level of all of them; by other settings, if given."""
        config = config or self._config
        objects = [self._train[k].object for k in chosen]
        thinned = None if self._thinned is None or config.thinned == 1.0 else self._thinned[chosen]
        return fit_contact(self.rows[chosen], self._resting[chosen], objects, config, thinned, self._ranges)

    def predict(self, samples: Sequence[Sample]) -> Float64:
        """Return (S, D) predictions from vision alone [counts]; labels and tares of the samples are not used."""
        return self.fit(np.arange(len(self._train))).predict_rows(describe_samples(samples))[0]
