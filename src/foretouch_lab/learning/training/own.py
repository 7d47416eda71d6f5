# SPDX-License-Identifier: Apache-2.0
"""A touch model from a predictor of the user: held-out predictions of it, and their calibration.

A predictor with `fit(samples)` is fitted again without the samples of each fold, as foretouch's own models are. Another one is
used as it is: then only the calibration is held out, and whether the predictor was trained on the samples is not known here.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch import __version__
from foretouch.dataset.samples import SampleSet
from foretouch.errors import ConfigError, DatasetError, ForetouchError, ModelError, described, none_of
from foretouch.models.card import OWN, CardCalibration, load_calibration, save_model
from foretouch.models.files import read_tensors
from foretouch.models.own import find_predictor, name_of, require_predictor, save_own
from foretouch.models.predictor import Predictor
from foretouch.models.registry import temporary_model
from foretouch.models.touch_model import TouchModel
from foretouch.tactile.description import Sensor, require_same, with_sensor
from foretouch.types import Float64, Grasps, Sample
from foretouch_lab.learning.data.dataset import Dataset, dataset_from
from foretouch_lab.learning.data.folds import SPLITS, Fold
from foretouch_lab.learning.data.training_set import labels_of
from foretouch_lab.learning.evaluation.evaluate import trained_on
from foretouch_lab.learning.training.calibration import calibrate_on_folds, guarantee
from foretouch_lab.learning.training.run_config import RunConfig

_OF_FILES: Final = ("format", "format_version", "kind", "name", "weights", "sha256", "calibration")
"""Fields of a card that follow from its files."""

_LEFT_OUT: Final = {
    "random": "other grasps of the same sessions",
    "time": "other times of the same objects",
    "object": "objects left out",
}


@dataclass(frozen=True, eq=False)
class OwnHoldOut:
    """Predicts the test side of folds by a predictor, which is fitted to their training side where it is `refitted`.

    Attributes:
        model: With the predictor, and no calibration.
        samples: Labelled samples that folds index.
        refitted: Whether the predictor is fitted in each fold.
    """

    model: TouchModel
    samples: Sequence[Sample]
    refitted: bool = True

    def __call__(self, fold: Fold) -> Float64:
        """Return (T, D) predictions of the test side [counts]."""
        train, test = fold.sides(self.samples)
        if self.refitted:
            return predict_samples(plain_model(fitted(self.model.predictor, train), self.model.sensor), test)
        asked = [k for k in fold.test.tolist() if k not in self._given]
        self._given.update(zip(asked, predict_samples(self.model, [self.samples[k] for k in asked]), strict=True))
        return np.array([self._given[k] for k in fold.test.tolist()])

    @cached_property
    def _given(self) -> dict[int, Float64]:
        """Predictions so far of a predictor that is given as it is, which other folds ask for again."""
        return {}


def calibrate(
    predictor: Any,
    samples: SampleSet | Sequence[Sample] | str | Path,
    split: str = "object",
    *,
    name: str = "",
    refit: bool | None = None,
    seed: int = 0,
    workers: int = 1,
) -> TouchModel:
    """Make a touch model of a predictor; see `foretouch.calibrate`."""
    if split not in SPLITS:
        raise ConfigError(f"split: {none_of(split, SPLITS)}")
    data = dataset_from(samples)
    if isinstance(predictor, TouchModel) and predictor.card.get("kind") != OWN:
        if refit:
            raise ModelError(f"refit: {predictor.name} is fitted by `foretouch train`, or foretouch.fit")
        return _recalibrated(predictor, data, split, name or predictor.name, seed)
    predictor = predictor.predictor if isinstance(predictor, TouchModel) else find_predictor(predictor)
    refit = can_refit(predictor, refit)
    name = RunConfig(name=name or type(predictor).__name__).name  # which checks it
    known = data.partition(None).train
    labelled = [data.filled[k] for k in known]
    final = fitted(predictor, labelled) if refit else predictor
    model = plain_model(final, data.sensor)
    calibrated, facts = _calibrated(OwnHoldOut(model, labelled, refit), data, split, seed, workers)
    fate = "fitted to" if refit else "given as it is, calibrated on"
    origin = {key: value for key, value in data.origin.items() if key != "limits"}
    hashes = {"sample_hashes": "".join(sorted(data.hashes(known)))}
    trained = {**facts["calibrated_on"], **hashes} if refit else {}  # else it is not known
    facts |= {
        "summary": f"{name_of(final)}, {fate} {len(labelled)} labelled samples of {data.name}",
        "data": {**trained, **origin},
        "version": __version__,
    }
    facts = with_sensor(facts, data.sensor)
    try:
        return temporary_model(lambda folder: save_own(folder / f"{name}.json", final, facts, calibrated), final)
    except ModelError as err:  # of errors that are almost zero
        raise ModelError(f"{name}: no calibration can be made of its errors: {err}; was it trained on them?") from err


def _recalibrated(model: TouchModel, data: Dataset, split: str, name: str, seed: int) -> TouchModel:
    """Return a model of foretouch, with a calibration by samples that it was not trained on."""
    require_same(data.sensor.channels, model.sensor.channels, data.name)
    if model.path is None:
        raise ModelError(f"{model.name}: was not loaded from files, so it cannot be calibrated")
    index = data.partition(None).train
    own = trained_on(model.card, data, index)
    kept = index if own is None else index[~own]
    if not len(kept):
        raise DatasetError(f"{data.name}: {model.name} was trained on all of its samples; calibrate it on others")
    plain = TouchModel(model.predictor, model.card)
    held_out = OwnHoldOut(plain, [data.filled[k] for k in kept], refitted=False)
    calibrated, facts = _calibrated(held_out, data, split, seed, workers=1, known=own is not None)
    _, tensors = read_tensors(model.path, model.card)
    _, fallback = load_calibration(model.path, model.card, model.sensor.channels)
    facts = {key: value for key, value in model.card.items() if key not in _OF_FILES} | facts
    kind = model.card["kind"]
    card = f"{RunConfig(name=name).name}.json"
    return temporary_model(lambda folder: save_model(folder / card, kind, tensors, facts, calibrated, fallback))


def _calibrated(
    held_out: OwnHoldOut, data: Dataset, split: str, seed: int, workers: int, *, known: bool = False
) -> tuple[CardCalibration, dict[str, Any]]:
    """Return a calibration by held-out predictions, and what a card says about it.

    Args:
        held_out: The predictor, and the samples.
        data: That they are of.
        split: What is left out for the intervals of unfamiliar grasps.
        seed: Of random folds.
        workers: Number of processes.
        known: Whether a predictor that is given as it is, is known not to be trained on the samples.
    """
    samples = held_out.samples
    first = held_out.model.estimate(samples[0].cloud, Grasps.of([samples[0].grasp]), samples[0].table)
    calibration, held = calibrate_on_folds(samples, labels_of(samples), held_out, seed, split=split, workers=workers)
    limits = _limits(split, given=not held_out.refitted and not known, says=first.familiar is not None)
    source = {"name": data.name, "sha256": data.sha256, "samples": len(samples)}
    facts = {"calibrated_on": source, "limits": [guarantee(held), *limits]}
    return (calibration, {**held, "split": split}), facts


def _limits(split: str, *, given: bool, says: bool) -> list[str]:
    """Return what a card says about how a predictor was calibrated."""
    limits = [f"The intervals of {'unfamiliar' if says else 'all'} grasps are of {_LEFT_OUT[split]} (split {split})."]
    if not says:
        limits.append(
            "The predictor does not say which grasps resemble its training, so that none is flagged unfamiliar."
        )
    if given:
        limits.append(
            "The predictor was given as it is, and only its calibration is held out. Whether it was trained on these samples is "
            "not known: if it was, its errors on others are larger than the intervals say."
        )
    return limits


def can_refit(predictor: Any, refit: bool | None) -> bool:
    """Return whether a predictor is fitted in each fold; by default if it can be."""
    able = callable(getattr(predictor, "fit", None))
    if refit and not able:
        raise ModelError(f"refit: {name_of(predictor)} has no fit(samples)")
    return able if refit is None else refit


def fitted(predictor: Predictor, samples: Sequence[Sample]) -> Predictor:
    """Return a copy of a predictor that is fitted to samples; a `ModelError` names it if that fails."""
    twin: Any = copy.deepcopy(predictor)
    try:
        result = twin.fit(list(samples))
    except ForetouchError:
        raise
    except Exception as err:
        raise ModelError(f"{name_of(predictor)}: fit: {described(err)}") from err
    return twin if result is None else require_predictor(result)


def plain_model(predictor: Predictor, sensor: Sensor) -> TouchModel:
    """Return a model of a predictor without a calibration."""
    card = {"kind": OWN, "name": name_of(predictor), "sha256": "", "data": {}, "split": {}}
    return TouchModel(predictor, with_sensor(card, sensor))


def predict_samples(model: TouchModel, samples: Sequence[Sample]) -> Float64:
    """Return (S, D) predictions of samples from vision alone [counts].

    Raises:
        ModelError: Names the sample that cannot be predicted, or whose prediction is not finite.
    """
    counts = np.empty((len(samples), model.sensor.channels.size))
    for k, sample in enumerate(samples):
        try:
            counts[k] = model.estimate(sample.cloud, Grasps.of([sample.grasp]), sample.table).counts[0]
        except ForetouchError as err:
            raise ModelError(f"{sample.id}: {err}") from err
        if not np.isfinite(counts[k]).all():
            raise ModelError(f"{sample.id}: {model.name}: estimate: returned a value that is not finite")
    return counts
