# SPDX-License-Identifier: Apache-2.0
"""The contact model: touch from the geometry at each contact.

    cloud, grasp ─► 56 features ─┬─ forests ── readings of similar training grasps ──┐
                                 └─ kernel ─── an estimate that fades to the mean ───┴─ w·forests + (1 - w)·λ·kernel
    cloud, grasp ─► sizes, conditions ─► novelty detector ─► in-distribution score w, 1 … 0

Forests predict best on objects that were trained on, and worse than the mean of the training labels on others.
The kernel's parameters are selected on objects left out, so that it predicts only what generalises, and its estimate is
multiplied by the generalisation gain λ, the share of it that held on them (`learning.training.contact`).

Its weights hold forests, kernel and novelty detector.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final, Self

import numpy as np
from scipy.spatial.distance import cdist

from foretouch.errors import ConfigError, ModelError
from foretouch.models.card import CardCalibration, card_sensor, load_calibration, save_model
from foretouch.models.contact.features import (
    CHECKED,
    CONDITIONS,
    FEATURES,
    OBJECT_FEATURES,
    UPPER_FEATURES,
    VIEW,
    HandFrameFeatures,
)
from foretouch.models.contact.regressors import CompiledForests, Forest, KernelRegression
from foretouch.models.files import TensorRecord, read_part, read_tensors
from foretouch.models.novelty import IN_DISTRIBUTION, standardisation
from foretouch.models.predictor import Estimate
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import Ranges
from foretouch.types import AnyArray, Bool, Cloud, Float64, Grasp, Plane

TOGETHER: Final = "together"
"""Name of the forest with all values as outputs."""

_ARRAYS: Final = ("mean", "deviation", "generalisation_gain")

_AROUND: Final = [name.startswith(("g1_", "g2_")) and "_depth" not in name for name in FEATURES[len(CONDITIONS) :]]
"""Inputs that describe the points around each contact."""

_USUAL: Final = (0.93, 0.98)  # quantiles of the distances within training between which the score falls from 1 to 0
_LEAST: Final = 0.05  # variance within objects that a size has at least, over that between all clouds
_OTHER_VIEW_M: Final = 1e-3 * np.array([3, 5, 4, 15, 23, 20, 6, 7, 7, 16, 15])
"""How far each size of the upper side of one object differs between views, six standard deviations by `benchmarks/views` [m].

The sizes are in the order of `KnownSizes.of_upper`."""
_ONE_IN_TEN: Final = 0.1
_AROUND_LIMIT: Final = (0.8, 1.2)  # shares of a limit between which the score falls from 1 to 0
_BEYOND: Final = {"spacing": 2.5, "width": 1.5, "distance": 1.25}  # factors beyond them
_ANY: Final = 1e9
"""A limit that no view exceeds."""
_TURN: Final = {"approach": 0.05, "rise": 0.05, "tilt": float(np.radians(5.0))}  # what is added: cosines, an angle
_LIMITED: Final = (*VIEW, "spacing", "width", "approach", "rise")
_LIMITED_COLUMNS, _WHOLE, _UPPER = (
    [CHECKED.index(name) for name in names] for names in (_LIMITED, OBJECT_FEATURES, UPPER_FEATURES)
)
_LONGEST: Final = OBJECT_FEATURES.index("spread_3")


@dataclass(frozen=True, eq=False)
class KnownSizes(TensorRecord):
    """Sizes of S training clouds, and from which distance to the nearest of them on others are unlike.

    The distance counts less what varies between clouds of one object: its pose, and what is seen of it.
    """

    centre: Float64  # (11,) float64, mean of the sizes [m]
    turn: Float64  # (11, 11) float64: differences of sizes times it have unit variance within objects
    known: Float64  # (S, 11) float64, sizes minus `centre`, times `turn`
    span: Float64  # (2,) float64: the distances up to which the score is 1, and from which it is 0

    RULES = {"centre": "C", "turn": "CC", "known": "SC", "span": "2"}  # noqa: RUF012

    @classmethod
    def of_whole(cls, sizes: Float64, objects: Sequence[str]) -> Self:
        """From (S, 11) sizes of all points, S of at least 5, and their objects."""
        _, scale = standardisation(sizes)
        centre, turn, known = cls._moved(sizes, objects, _LEAST * scale**2)
        start, end = np.quantile(np.sort(cdist(known, known), axis=1)[:, 1], _USUAL)
        return cls(centre, turn, known, np.array([start, max(end, start + 1e-9)]))

    @classmethod
    def of_upper(cls, sizes: Float64, objects: Sequence[str]) -> Self:
        """From (S, 11) sizes of the upper sides, S of at least 5, and their objects.

        The limit is the least distance of training objects from all other objects, but for one cloud in ten. Where objects are alike, it is
        the largest distance between clouds of training, but for one in ten.
        """
        centre, turn, known = cls._moved(sizes, objects, _OTHER_VIEW_M**2)
        apart = cdist(known, known)
        np.fill_diagonal(apart, np.inf)
        limit = np.quantile(apart.min(axis=1), 1.0 - _ONE_IN_TEN)
        _, index = np.unique(np.asarray(objects), return_inverse=True)
        if index.any():
            apart[index[:, None] == index] = np.inf
            limit = max(limit, np.quantile(apart.min(axis=1), _ONE_IN_TEN))
        return cls(centre, turn, known, max(float(limit), 1e-9) * np.array(_AROUND_LIMIT))

    @staticmethod
    def _moved(sizes: Float64, objects: Sequence[str], added: Float64) -> tuple[Float64, Float64, Float64]:
        """`centre`, `turn` and `known`, from sizes whose variances within objects are larger by (11,) `added` [m²]."""
        centre, scale = standardisation(sizes)
        within = (sizes - centre) / scale
        names = np.asarray(objects)
        for name in np.unique(names):
            within[names == name] -= within[names == name].mean(axis=0)
        values, axes = np.linalg.eigh(within.T @ within / len(within) + np.diag(added / scale**2))
        turn = axes / np.sqrt(values) / scale[:, None]
        return centre, turn, (sizes - centre) @ turn

    def scores(self, sizes: Float64) -> Float64:
        """Return (K,) of (K, 11): 1 for sizes as in training, 0 for others."""
        moved = ((sizes - self.centre)[:, :, None] * self.turn).sum(axis=1)  # the same for any K
        start, end = self.span
        return np.asarray(np.clip((end - cdist(moved, self.known).min(axis=1)) / (end - start), 0.0, 1.0), np.float64)

    @cached_property
    def longest(self) -> tuple[float, float]:
        """The least and the largest deviation along the longest axis of a training cloud [m]."""
        sizes = (self.known @ np.linalg.inv(self.turn) + self.centre)[:, _LONGEST]
        return float(sizes.min()), float(sizes.max())

    def _check(self) -> None:
        super()._check()
        if len(self.centre) != len(OBJECT_FEATURES):
            raise ModelError(f"centre: shape {self.centre.shape} is not ({len(OBJECT_FEATURES)},)")
        if not len(self.known) or not self.span[0] < self.span[1]:
            raise ModelError("known, span: no cloud, or a span that is empty")


@dataclass(frozen=True, eq=False)
class Limits(TensorRecord):
    """What view, density of points, width and direction of the hand the training has."""

    low: Float64  # (6,) float64 of tilt, distance, spacing, width, approach and rise
    high: Float64  # (6,) float64

    RULES = {"low": "6", "high": "6"}  # noqa: RUF012

    @classmethod
    def fit(cls, rows: Float64) -> Self:
        """From (S, F) rows of training grasps, whose first columns are `CHECKED`."""
        low, high = np.quantile(rows[:, _LIMITED_COLUMNS], (0.01, 0.99), axis=0)
        added, factor = (
            np.array([table.get(name, usual) for name in _LIMITED]) for table, usual in ((_TURN, 0.0), (_BEYOND, 1.0))
        )
        low, high = low / factor - added, high * factor + added
        low[_LIMITED.index("spacing")] = 0.0  # points cannot be too many
        return cls(low, high)

    def exceeded(self, rows: Float64) -> tuple[Bool, Bool]:
        """Return (K, 6) bool each, whether (K, F) rows are below and above a limit."""
        values = rows[:, _LIMITED_COLUMNS]
        return values < self.low, values > self.high

    def has_view(self, view: Float64) -> Bool:
        """Return (…,) whether the training has such a view as (…, 2) of `VIEW`."""
        size = len(VIEW)
        return np.asarray(((view >= self.low[:size]) & (view <= self.high[:size])).all(axis=-1), np.bool_)


@dataclass(frozen=True, eq=False)
class NoveltyDetector:
    """Whether a cloud and a grasp, in the frame of the hand, resemble the training of a model.

    In a view as in training, the sizes of all points are compared. In another view other walls are seen, and the sizes of
    the upper side are compared instead. Conditions under which the training data say nothing are unfamiliar too: too few points, another width or direction of the
    hand. No view is.
    """

    whole: KnownSizes
    upper: KnownSizes
    limits: Limits

    @classmethod
    def fit(cls, rows: Float64, objects: Sequence[str]) -> Self:
        """Fit to (S, F) rows of training grasps, whose first columns are `CHECKED`, and their objects.

        S of at least 5.
        """
        whole = KnownSizes.of_whole(rows[:, _WHOLE], objects)
        return cls(whole, KnownSizes.of_upper(rows[:, _UPPER], objects), Limits.fit(rows))

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, AnyArray]) -> Self:
        """Make the detector of the arrays of a file, which errors name.

        In a file of 0.2 or 0.3, which has no upper sides, the sizes of all points are compared in any view.
        """
        if "novelty/low" not in tensors:
            whole, upper = (read_part(KnownSizes, tensors, f"novelty/{side}/") for side in ("whole", "upper"))
            return cls(whole, upper, read_part(Limits, tensors, "novelty/limits/"))
        whole = read_part(KnownSizes, tensors, "novelty/")
        # The first of five limits there was for the distance of the camera, and was not used.
        limits = {name: tensors.get(f"novelty/{name}", np.empty(0))[1:] for name in ("low", "high")}
        views = {"low": np.full(len(VIEW), -_ANY), "high": np.full(len(VIEW), _ANY)}
        joined = {f"novelty/{name}": np.concatenate([views[name], limits[name]]) for name in limits}
        return cls(whole, whole, read_part(Limits, joined, "novelty/"))

    def parts(self) -> dict[str, TensorRecord]:
        """Return what a file has, by the beginning of its names."""
        return {"novelty/whole": self.whole, "novelty/upper": self.upper, "novelty/limits": self.limits}

    def scores(self, rows: Float64) -> Float64:
        """Return (K,) shares for (K, F) rows: 1 where they are as in training, 0 where not.

        Compare with `IN_DISTRIBUTION`.
        """
        below, above = self.limits.exceeded(rows)
        outside, scores = below | above, np.empty(len(rows))
        whole = ~outside[:, : len(VIEW)].any(axis=1)
        for seen, sizes, columns in ((whole, self.whole, _WHOLE), (~whole, self.upper, _UPPER)):
            if seen.any():
                scores[seen] = sizes.scores(rows[seen][:, columns])
        scores[outside[:, len(VIEW) :].any(axis=1)] = 0.0
        return scores

    def reasons(self, rows: Float64) -> dict[str, Bool]:
        """Return (K,) bool each, what of (K, F) rows is unlike the training, by the names of `UNFAMILIAR`."""
        below, above = (dict(zip(_LIMITED, beyond.T, strict=True)) for beyond in self.limits.exceeded(rows))
        whole = self.limits.has_view(rows[:, : len(VIEW)])
        longest = np.where(whole, rows[:, _WHOLE[_LONGEST]], rows[:, _UPPER[_LONGEST]])
        least, most = np.where(whole[:, None], self.whole.longest, self.upper.longest).T
        larger, smaller = longest > most, longest < least
        turned = below["approach"] | above["approach"] | below["rise"] | above["rise"]
        limited = above["spacing"] | above["width"] | below["width"] | turned
        return {
            "larger_object": larger,
            "smaller_object": smaller,
            "other_shape": ~(larger | smaller | limited),
            "wider_grasp": above["width"],
            "narrower_grasp": below["width"],
            "other_direction": turned,
            "sparse_points": above["spacing"],
        }


@dataclass(frozen=True, eq=False)
class ContactEstimator:
    """A fitted contact model; immutable, so threads may share it.

    Attributes:
        forests: One for all D values together, and one for each modality; a value is the mean of its two.
        kernel: Of all D values.
        novelty: Fitted to the training objects.
        mean, deviation: (D,) float64 of the training labels [counts], which standardise the outputs of forests and
            kernel.
        generalisation_gain: (M,) float64 in [0, 1], λ of each modality.
        ranges: Ranges outside which a predicted value is flagged, and the channels of the readings.
        surroundings: Whether it looks at the points around the contacts; else it takes their means in training, and describes
            the object, the hand and the place of the grasp on the object as before.
    """

    forests: Mapping[str, Forest]
    kernel: KernelRegression
    novelty: NoveltyDetector
    mean: Float64
    deviation: Float64
    generalisation_gain: Float64
    ranges: Ranges
    surroundings: bool = True

    uses_colours: ClassVar = False

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp], table: Plane | None = None) -> Estimate:
        """Predict (K, D) counts of grasps on a cloud, and whether they are in the distribution of training."""
        features = HandFrameFeatures(cloud.xyz, table)
        upper = not self.novelty.limits.has_view(features.view)
        rows = features.describe(grasps, surroundings=self.surroundings, upper=upper)
        where = rows[:, len(CONDITIONS) :] if self.surroundings else None
        counts, known = self.predict_rows(rows)
        return Estimate(counts, known, where, {} if known.all() else self.novelty.reasons(rows))

    def predict_rows(self, rows: Float64) -> tuple[Float64, Bool]:
        """Predict from (K, F) rows of `HandFrameFeatures.describe`, each of which may be of another object.

        Returns:
            (K, D) [counts], and (K,) whether the object is in distribution.
        """
        scores = self.novelty.scores(rows)
        inputs = rows[:, len(CONDITIONS) :]
        if not self.surroundings:
            inputs = np.where(_AROUND, self.kernel.centre, inputs)
        # Most rows are either known or new, and each part takes half of the time. Scores that are not finite count as both.
        known, new = ~(scores <= 0.0), ~(scores >= 1.0)
        scaled = np.zeros((len(rows), self.ranges.channels.size))
        scaled[known] = scores[known, None] * self._trees(inputs[known])
        scaled[new] += (1.0 - scores[new, None]) * (self.kernel.predict(inputs[new]) * self._gain)
        return scaled * self.deviation + self.mean, scores >= IN_DISTRIBUTION

    def _trees(self, inputs: Float64) -> Float64:
        both = self._compiled.predict(inputs)  # modalities are in the order of their columns
        size = self.ranges.channels.size
        return (both[:, :size] + both[:, size:]) / 2.0

    @cached_property
    def _compiled(self) -> CompiledForests:
        return CompiledForests([self.forests[name] for name in (TOGETHER, *self.ranges.channels.modalities)])

    @cached_property
    def _gain(self) -> Float64:
        return np.asarray(self.ranges.channels.by_modality(self.generalisation_gain), np.float64)

    def to_tensors(self) -> dict[str, AnyArray]:
        """Arrays by name, for a file."""
        forests = {f"forest_{name}": forest for name, forest in self.forests.items()}
        parts: dict[str, TensorRecord] = {"kernel": self.kernel, **self.novelty.parts(), **forests}
        tensors = {
            f"{part}/{key}": value for part, member in parts.items() for key, value in member.to_tensors().items()
        }
        return tensors | {name: getattr(self, name) for name in _ARRAYS}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, AnyArray], ranges: Ranges) -> Self:
        """Make the object of the arrays of `to_tensors`.

        Raises:
            ModelError: Names the array that is missing or damaged.
        """
        channels = ranges.channels
        for name in _ARRAYS:
            shape = (len(channels.modalities) if name == "generalisation_gain" else channels.size,)
            if name not in tensors or tensors[name].shape != shape or not np.isfinite(tensors[name]).all():
                raise ModelError(f"{name}: is missing, of another shape than {shape}, or not finite")
        mean, deviation, gain = (tensors[name] for name in _ARRAYS)
        if not ((gain >= 0.0) & (gain <= 1.0)).all():
            raise ModelError("generalisation_gain: a value is not in [0, 1]")
        inputs = len(FEATURES) - len(CONDITIONS)
        forests = {name: read_part(Forest, tensors, f"forest_{name}/") for name in (TOGETHER, *channels.modalities)}
        for name, forest in forests.items():
            size = channels.size if name == TOGETHER else channels.channel_of[name].size
            if forest.output_size != size or forest.feature.max() >= inputs:
                raise ModelError(f"forest_{name}: does not fit {inputs} features and {size} values")
        kernel = read_part(KernelRegression, tensors, "kernel/")
        if kernel.known.shape[1] != inputs or kernel.weight.shape[1] != channels.size:
            raise ModelError(f"kernel: does not fit {inputs} features and {channels.size} values")
        return cls(forests, kernel, NoveltyDetector.from_tensors(tensors), mean, deviation, gain, ranges)


def save_contact(
    folder: str | Path,
    name: str,
    estimator: ContactEstimator,
    facts: Mapping[str, Any],
    calibration: CardCalibration | None = None,
) -> Path:
    """Write a contact model and return the path of its card; see `save_model`."""
    facts = {"config": {}, "ranges": estimator.ranges.to_mapping(), **facts}
    return save_model(Path(folder) / f"{name}.json", "contact", estimator.to_tensors(), facts, calibration)


def load_model(card_path: Path, card: Mapping[str, Any]) -> TouchModel:
    """Return the contact model of a card, with its calibration.

    Raises:
        ModelError: Names the file and the field: absent, damaged, with another hash than the card's, or not fitting.
    """
    try:
        ranges = Ranges.from_mapping(card_sensor(card, card_path).channels, card["ranges"], f"{card_path}: ranges")
    except ConfigError as err:
        raise ModelError(str(err)) from err
    calibration, _ = load_calibration(card_path, card, ranges.channels)
    tracker = None if calibration is None else calibration.tracker_parameters
    if tracker and tracker.where_ratio.any() and tracker.where_scale.size != len(FEATURES) - len(CONDITIONS):
        raise ModelError(f"{card_path}: where_scale: {tracker.where_scale.size} features are not those of the model")
    path, tensors = read_tensors(card_path, card)
    try:
        return TouchModel(ContactEstimator.from_tensors(tensors, ranges), card, calibration)
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
