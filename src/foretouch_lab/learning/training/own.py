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
from foretouch.errors import ConfigError, ForetouchError, ModelError, described, none_of
from foretouch.models.card import OWN
from foretouch.models.own import find_predictor, name_of, require_predictor, save_own
from foretouch.models.predictor import Predictor
from foretouch.models.touch_model import TouchModel
from foretouch.tactile.description import Sensor, with_sensor
from foretouch.types import Float64, Grasps, Sample
from foretouch_lab.learning.data.dataset import dataset_from
from foretouch_lab.learning.data.folds import SPLITS, Fold
from foretouch_lab.learning.data.training_set import labels_of
from foretouch_lab.learning.training.calibration import calibrate_on_folds, guarantee, with_conformal_start
from foretouch_lab.learning.training.fit import temporary_model
from foretouch_lab.learning.training.run_config import RunConfig

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
        if not self.refitted:
            return self._given[fold.test]
        train, test = fold.sides(self.samples)
        return predict_samples(plain_model(fitted(self.model.predictor, train), self.model.sensor), test)

    @cached_property
    def _given(self) -> Float64:
        return predict_samples(self.model, self.samples)


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
    predictor = find_predictor(predictor)
    refit = can_refit(predictor, refit)
    name = RunConfig(name=name or type(predictor).__name__).name  # which checks it
    data = dataset_from(samples)
    known = data.partition(None).train
    labelled = [data.filled[k] for k in known]
    final = fitted(predictor, labelled) if refit else predictor
    model = plain_model(final, data.sensor)
    says = model.estimate(labelled[0].cloud, Grasps.of([labelled[0].grasp])).familiar is not None
    held_out = OwnHoldOut(model, labelled, refit)
    calibration, held = calibrate_on_folds(labelled, labels_of(labelled), held_out, seed, split=split, workers=workers)
    calibrated = with_conformal_start(calibration), {**held, "split": split}
    fate = "fitted to" if refit else "given as it is, calibrated on"
    source = {"name": data.name, "sha256": data.sha256, "samples": len(data.samples)}
    origin = {key: value for key, value in data.origin.items() if key != "limits"}
    trained = {**source, "sample_hashes": "".join(sorted(data.hashes(known)))} if refit else {}  # else it is not known
    facts = {
        "summary": f"{name_of(final)}, {fate} {len(labelled)} labelled samples of {data.name}",
        "data": {**trained, **origin},
        "calibrated_on": source,
        "limits": [guarantee(held), *_limits(split, refit=refit, says=says)],
        "version": __version__,
    }
    facts = with_sensor(facts, data.sensor)
    try:
        return temporary_model(lambda folder: save_own(folder / f"{name}.json", final, facts, calibrated), final)
    except ModelError as err:  # of errors that are almost zero
        raise ModelError(f"{name}: no calibration can be made of its errors: {err}; was it trained on them?") from err


def _limits(split: str, *, refit: bool, says: bool) -> list[str]:
    """Return what a card says about how a predictor was calibrated."""
    limits = [f"The intervals of {'unfamiliar' if says else 'all'} grasps are of {_LEFT_OUT[split]} (split {split})."]
    if not says:
        limits.append(
            "The predictor does not say which grasps resemble its training, so that none is flagged unfamiliar."
        )
    if not refit:
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
            counts[k] = model.estimate(sample.cloud, Grasps.of([sample.grasp])).counts[0]
        except ForetouchError as err:
            raise ModelError(f"{sample.id}: {err}") from err
        if not np.isfinite(counts[k]).all():
            raise ModelError(f"{sample.id}: {model.name}: estimate: returned a value that is not finite")
    return counts
