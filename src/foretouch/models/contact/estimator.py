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
from typing import Any, Final, Self

import numpy as np
from scipy.spatial.distance import cdist

from foretouch.errors import ConfigError, ModelError
from foretouch.models.card import CardCalibration, card_sensor, load_calibration, save_model
from foretouch.models.contact.features import CHECKED, CONDITIONS, FEATURES, OBJECT_FEATURES, HandFrameFeatures
from foretouch.models.contact.regressors import CompiledForests, Forest, KernelRegression
from foretouch.models.files import TensorRecord, file_beside, read_part, read_tensors
from foretouch.models.novelty import IN_DISTRIBUTION, standardisation
from foretouch.models.touch_model import Estimate, TouchModel
from foretouch.tactile import Ranges
from foretouch.types import AnyArray, Bool, Cloud, Float64, Grasp, Plane

TOGETHER: Final = "together"
"""Name of the forest with all values as outputs."""

_ARRAYS: Final = ("mean", "deviation", "generalisation_gain")

_AROUND: Final = [name.startswith(("g1_", "g2_")) and "_depth" not in name for name in FEATURES[len(CONDITIONS) :]]
"""Inputs that describe the points around each contact."""

_USUAL: Final = (0.93, 0.98)  # quantiles of the distances within training between which the score falls from 1 to 0
_LEAST: Final = 0.05  # variance within objects that a size has at least, over that between all clouds
_BEYOND: Final = {"spacing": 2.5, "width": 1.5}  # factors beyond them
_SIZE: Final = CHECKED.index("spread_3")
_TURN: Final = 0.05  # what is added to the directions of the hand, which are cosines
_SIZES: Final = [CHECKED.index(name) for name in OBJECT_FEATURES]
_LIMITED: Final = tuple(name for name in CHECKED if name not in OBJECT_FEATURES)
_LIMITED_COLUMNS: Final = [CHECKED.index(name) for name in _LIMITED]


@dataclass(frozen=True, eq=False)
class NoveltyDetector(TensorRecord):
    """Whether a cloud and a grasp, in the frame of the hand, resemble those that a model was trained on.

    The sizes of a cloud are compared with those of the nearest of S training clouds, by a distance that counts less what varies
    between clouds of one object: its pose, and what is seen of it. Conditions under which the training data say nothing, `CHECKED`, are
    unfamiliar too: too few points, another width or direction of the hand.
    """

    centre: Float64  # (11,) float64, mean of the sizes
    turn: Float64  # (11, 11) float64: differences of sizes times it have unit variance within objects
    known: Float64  # (S, 11) float64, sizes minus `centre`, times `turn`
    span: Float64  # (2,) float64: the distances up to which the score is 1, and from which it is 0
    low: Float64  # (5,) float64 of `CHECKED` without `OBJECT_FEATURES`; the first, once of the camera's distance, is not used
    high: Float64  # (5,) float64 of `CHECKED` without `OBJECT_FEATURES`

    RULES = {"centre": "C", "turn": "CC", "known": "SC", "span": "2", "low": "5", "high": "5"}  # noqa: RUF012

    @classmethod
    def fit(cls, rows: Float64, objects: Sequence[str]) -> Self:
        """From (S, F) rows of training grasps, whose first columns are `CHECKED`, and their objects.

        S of at least 5.
        """
        sizes = rows[:, _SIZES]
        centre, scale = standardisation(sizes)
        within = (sizes - centre) / scale
        names = np.asarray(objects)
        for name in np.unique(names):
            within[names == name] -= within[names == name].mean(axis=0)
        values, axes = np.linalg.eigh(within.T @ within / len(within) + _LEAST * np.eye(len(centre)))
        turn = axes / np.sqrt(values) / scale[:, None]
        known = (sizes - centre) @ turn
        start, end = np.quantile(np.sort(cdist(known, known), axis=1)[:, 1], _USUAL)
        low, high = np.quantile(rows[:, _LIMITED_COLUMNS], (0.01, 0.99), axis=0)
        for k, name in enumerate(_LIMITED):
            factor = _BEYOND.get(name)
            low[k], high[k] = (
                (low[k] - _TURN, high[k] + _TURN) if factor is None else (low[k] / factor, high[k] * factor)
            )
        low[_LIMITED.index("spacing")] = 0.0  # points cannot be too many
        return cls(centre, turn, known, np.array([start, max(end, start + 1e-9)]), low, high)

    def scores(self, rows: Float64) -> Float64:
        """(K,) of (K, F) rows: 1 where they are like those of training, 0 where unlike.

        Compare with `IN_DISTRIBUTION`.
        """
        moved = ((rows[:, _SIZES] - self.centre)[:, :, None] * self.turn).sum(axis=1)  # the same for any K
        distance = cdist(moved, self.known).min(axis=1)
        start, end = self.span
        limited = rows[:, _LIMITED_COLUMNS]
        inside = ((limited >= self.low) & (limited <= self.high))[:, 1:].all(axis=1)  # no view is refused
        return np.where(inside, np.clip((end - distance) / (end - start), 0.0, 1.0), 0.0)

    def reasons(self, rows: Float64) -> dict[str, Bool]:
        """(K,) bool each, what of (K, F) rows is unlike the training, by the names of `UNFAMILIAR`."""
        below, above = (
            dict(zip(_LIMITED, (rows[:, _LIMITED_COLUMNS] < self.low).T, strict=True)),
            dict(zip(_LIMITED, (rows[:, _LIMITED_COLUMNS] > self.high).T, strict=True)),
        )
        least, most = self._longest
        larger, smaller = rows[:, _SIZE] > most, rows[:, _SIZE] < least
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

    @cached_property
    def _longest(self) -> tuple[float, float]:
        """The least and the largest deviation along the longest axis of a training cloud [m]."""
        sizes = (self.known @ np.linalg.inv(self.turn) + self.centre)[:, _SIZES.index(_SIZE)]
        return float(sizes.min()), float(sizes.max())

    def _check(self) -> None:
        super()._check()
        if len(self.centre) != len(_SIZES):
            raise ModelError(f"centre: shape {self.centre.shape} is not ({len(_SIZES)},)")
        if not len(self.known) or not self.span[0] < self.span[1]:
            raise ModelError("known, span: no cloud, or a span that is empty")


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

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp], table: Plane | None = None) -> Estimate:
        """See `Estimator.estimate`."""
        rows = HandFrameFeatures(cloud.xyz, table).describe(grasps, surroundings=self.surroundings)
        where = rows[:, len(CONDITIONS) :] if self.surroundings else None
        counts, known = self.predict_rows(rows)
        return Estimate(counts, known, where, {} if known.all() else self.novelty.reasons(rows))

    def predict_rows(self, rows: Float64) -> tuple[Float64, Bool]:
        """Predict from (K, F) rows of `HandFrameFeatures.describe`, each of which may be of another object.

        Returns:
            (K, D) [counts], and (K,) whether the object is in distribution.
        """
        scores = self.novelty.scores(rows)
        weight = scores[:, None]
        inputs = rows[:, len(CONDITIONS) :]
        if not self.surroundings:
            inputs = np.where(_AROUND, self.kernel.centre, inputs)
        scaled = weight * self._trees(inputs) + (1.0 - weight) * (self.kernel.predict(inputs) * self._gain)
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
        parts: dict[str, TensorRecord] = {"kernel": self.kernel, "novelty": self.novelty, **forests}
        tensors = {
            f"{part}/{key}": value for part, member in parts.items() for key, value in member.to_tensors().items()
        }
        return tensors | {name: getattr(self, name) for name in _ARRAYS}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, AnyArray], ranges: Ranges) -> Self:
        """From `to_tensors`.

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
        return cls(forests, kernel, read_part(NoveltyDetector, tensors, "novelty/"), mean, deviation, gain, ranges)


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
    """The contact model of a card, with its calibration.

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
    path = file_beside(card_path, card["weights"], "weights")
    tensors = read_tensors(path, card["sha256"], card_path.name)
    try:
        return TouchModel(ContactEstimator.from_tensors(tensors, ranges), card, calibration)
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
