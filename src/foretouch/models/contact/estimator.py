# SPDX-License-Identifier: Apache-2.0
"""The contact model: touch from the geometry at each contact.

    cloud, grasp ─► 56 features ─┬─ forests ── readings of similar training grasps ──┐
                                 └─ kernel ─── an estimate that fades to the mean ───┴─ w·forests + (1 - w)·λ·kernel
    cloud, grasp ─► sizes, conditions ─► novelty detector ─► in-distribution score w, 1 … 0

Forests predict best on objects that were trained on, and worse than the mean of the training labels on others.
The kernel's parameters are selected on objects left out, so that it predicts only what generalises, and its estimate is
multiplied by λ, the share of it that held on them (`learning.training.claims`).

`contact-v1` has no λ, describes a grasp by 88 features in the camera's frame (`features`) instead of those in the
hand's (`hand_features`), and detects new objects by sizes alone.

Its files are the card `<name>.json`, which names the others with their hashes, and `<name>.safetensors` holds forests,
kernel and novelty detector; `<name>.trust.safetensors` the calibration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import ConfigError, ModelError, quoted
from foretouch.models.calibration import Calibration, calibration_file, load_calibration
from foretouch.models.card import card_text, new_card
from foretouch.models.contact import features, hand_features
from foretouch.models.contact.hand_novelty import HandNoveltyDetector
from foretouch.models.contact.regressors import CompiledForests, Forest, KernelRegression
from foretouch.models.files import TensorRecord, file_beside, packed, read_part, read_tensors, replace_files
from foretouch.models.novelty import IN_DISTRIBUTION, SizeNoveltyDetector
from foretouch.models.touch_model import Estimate, TouchModel
from foretouch.tactile import MODALITIES, P2_RANGES, TactileRanges, columns
from foretouch.types import TOUCH_SIZE, Cloud, Float64, Grasp

TOGETHER: Final = "together"
"""Name of the forest with all values as outputs."""

_CLAIM: Final = "claim"  # its tensor distinguishes the two kinds of features


@dataclass(frozen=True, eq=False)
class ContactEstimator:
    """A fitted contact model; immutable, so threads may share it.

    Attributes:
        forests: One for all 50 values together, and one for each modality; a value is the mean of its two.
        kernel: Of all 50 values.
        novelty: Fitted to the training objects.
        mean, deviation: (50,) float64 of the training labels [counts], which standardise the outputs of forests and
            kernel.
        ranges: Ranges outside which a predicted value is flagged.
        claim: (4,) float64 in [0, 1], λ of each modality; None if features are in the camera's frame, as in
            `contact-v1`.
    """

    forests: Mapping[str, Forest]
    kernel: KernelRegression
    novelty: SizeNoveltyDetector | HandNoveltyDetector
    mean: Float64
    deviation: Float64
    ranges: TactileRanges = P2_RANGES
    claim: Float64 | None = None

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """See `Estimator.estimate`."""
        scene = (features.ContactScene if self.claim is None else hand_features.HandScene)(cloud.xyz)
        return Estimate(*self.predict_rows(scene.describe(grasps)))

    def predict_rows(self, rows: Float64) -> tuple[Float64, npt.NDArray[np.bool_]]:
        """Predict from feature rows, each of which may be of another object.

        Args:
            rows: (K, F) of `HandScene.describe`, or of `ContactScene.describe` if `claim` is None.

        Returns:
            (K, 50) [counts], and (K,) whether the object is in distribution.
        """
        scores = self.novelty.scores(rows)
        weight = scores[:, None]
        inputs = rows if self.claim is None else rows[:, len(hand_features.CONDITIONS) :]
        unknown = self.kernel.predict(inputs)
        if self.claim is not None:
            unknown = unknown * self._claim
        scaled = weight * self._trees(inputs) + (1.0 - weight) * unknown
        return scaled * self.deviation + self.mean, scores >= IN_DISTRIBUTION

    @property
    def inputs(self) -> int:
        """F, the number of columns that forests and kernel see."""
        hand = len(hand_features.FEATURES) - len(hand_features.CONDITIONS)
        return len(features.FEATURES) if self.claim is None else hand

    def _trees(self, rows: Float64) -> Float64:
        both = self._compiled.predict(rows)  # modalities are in the order of their columns
        return (both[:, :TOUCH_SIZE] + both[:, TOUCH_SIZE:]) / 2.0

    @cached_property
    def _compiled(self) -> CompiledForests:
        return CompiledForests([self.forests[name] for name in (TOGETHER, *MODALITIES)])

    @cached_property
    def _claim(self) -> Float64:
        """(50,) `claim` of each value."""
        return np.ones(TOUCH_SIZE) if self.claim is None else by_modality(self.claim)

    def to_tensors(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays by name, for a file."""
        parts: dict[str, TensorRecord] = {"kernel": self.kernel, "novelty": self.novelty}
        parts |= {f"forest_{name}": forest for name, forest in self.forests.items()}
        tensors = {f"{part}/{key}": value for part, one in parts.items() for key, value in one.to_tensors().items()}
        claim = {} if self.claim is None else {_CLAIM: self.claim}
        return tensors | {"mean": self.mean, "deviation": self.deviation} | claim

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]], ranges: TactileRanges) -> ContactEstimator:
        """From `to_tensors`.

        Raises:
            ModelError: Names the array that is missing or damaged.
        """
        for name in ("mean", "deviation"):
            if name not in tensors or tensors[name].shape != (TOUCH_SIZE,) or not np.isfinite(tensors[name]).all():
                raise ModelError(f"{name}: is missing, of another shape, or not finite")
        claim = tensors.get(_CLAIM)
        if claim is not None and (claim.shape != (len(MODALITIES),) or not ((claim >= 0.0) & (claim <= 1.0)).all()):
            raise ModelError(f"{_CLAIM}: shape {claim.shape} is not ({len(MODALITIES)},), or a value is not in [0, 1]")
        forests = {name: read_part(Forest, tensors, f"forest_{name}/") for name in (TOGETHER, *MODALITIES)}
        kernel = read_part(KernelRegression, tensors, "kernel/")
        detector: type[SizeNoveltyDetector | HandNoveltyDetector]
        detector = SizeNoveltyDetector if claim is None else HandNoveltyDetector
        novelty = read_part(detector, tensors, "novelty/")
        found = cls(forests, kernel, novelty, tensors["mean"], tensors["deviation"], ranges, claim)
        found._check()
        return found

    def _check(self) -> None:
        for name, forest in self.forests.items():
            size = TOUCH_SIZE if name == TOGETHER else len(columns([name]))
            if forest.output_size != size or forest.feature.max() >= self.inputs:
                raise ModelError(f"forest_{name}: does not fit {self.inputs} features and {size} values")
        if self.kernel.known.shape[1] != self.inputs or self.kernel.weight.shape[1] != TOUCH_SIZE:
            raise ModelError(f"kernel: does not fit {self.inputs} features and {TOUCH_SIZE} values")


def by_modality(values: Float64) -> Float64:
    """(50,) values of a touch, from (4,) of the modalities."""
    spread = np.empty(TOUCH_SIZE)
    for name, value in zip(MODALITIES, values, strict=True):
        spread[columns([name])] = value
    return spread


def save_contact(
    folder: str | Path,
    name: str,
    estimator: ContactEstimator,
    facts: Mapping[str, Any],
    calibration: tuple[Calibration, Mapping[str, Any]] | None = None,
) -> Path:
    """Write weights, card and, where there is one, the calibration: all of them or none.

    Args:
        folder: Made if absent.
        name: Of the model and of its files.
        estimator: The fitted model.
        facts: `summary`, `config`, `data`, `split`, `skill`, `baselines`, `limits` of the card; empty if omitted.
        calibration: With its facts for the card, as in `add_calibration`.

    Returns:
        Path of the card.

    Raises:
        FileError: If a file cannot be written; the files before are kept.
    """
    path = Path(folder) / f"{name}.json"
    weights = path.with_suffix(".safetensors")
    content, sha256 = packed(estimator.to_tensors())
    empty: dict[str, Any] = {"summary": "", "config": {}, "data": {}, "split": {}, "skill": {}, "baselines": {}}
    rest: dict[str, Any] = {"limits": [], "calibration": None, "ranges": estimator.ranges.to_mapping()}
    card = new_card(name, "contact", weights=weights.name, sha256=sha256, **{**empty, **rest, **facts})
    files = {weights: content}
    if calibration is not None:
        files |= calibration_file(path, card, *calibration)
    replace_files({**files, path: card_text(card).encode()})
    return path


def load_model(card_path: Path, card: Mapping[str, Any]) -> TouchModel:
    """The contact model of a card, with its calibration.

    Raises:
        ModelError: Names the file and the field: absent, damaged, with another hash than the card's, or not fitting.
    """
    stored = card.get("ranges", {})
    if not isinstance(stored, dict):
        raise ModelError(f"{card_path}: ranges: {quoted(stored)} is of type {type(stored).__name__}")
    try:
        ranges = TactileRanges.from_mapping(stored, f"{card_path}: ranges")
    except ConfigError as err:
        raise ModelError(str(err)) from err
    calibration, _ = load_calibration(card_path, card)
    path = file_beside(card_path, card["weights"], "weights")
    tensors = read_tensors(path, card["sha256"], card_path.name)
    try:
        return TouchModel(ContactEstimator.from_tensors(tensors, ranges), card, calibration)
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
