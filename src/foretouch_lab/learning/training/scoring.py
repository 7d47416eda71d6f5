# SPDX-License-Identifier: Apache-2.0
"""Scores of any models and every baseline, in one call of Python.

A recipe, and a predictor that can be fitted, is fitted again without the samples of each fold. A model that is given as it is
predicts them, but for those that it was trained on, which are left out for all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.dataset.samples import SampleSet
from foretouch.errors import DatasetError
from foretouch.models.card import OWN
from foretouch.models.own import find_predictor
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import usual_ranges
from foretouch.tactile.description import require_same
from foretouch.types import Sample
from foretouch_lab.learning.data import Dataset, labels_of
from foretouch_lab.learning.data.dataset import dataset_from
from foretouch_lab.learning.data.folds import SPLITS, HoldOut
from foretouch_lab.learning.evaluation.baselines import BASELINES, Baseline
from foretouch_lab.learning.evaluation.evaluate import MODEL, trained_on
from foretouch_lab.learning.training.compare import Evaluation, HeldOutSamples, score_splits
from foretouch_lab.learning.training.learners import Learner, make_learner
from foretouch_lab.learning.training.own import OwnHoldOut, can_refit, plain_model
from foretouch_lab.learning.training.run_config import RunConfig, load_run_config


def evaluate(
    models: Any,
    samples: SampleSet | Sequence[Sample] | str | Path,
    splits: Sequence[str] = SPLITS,
    *,
    refit: bool | None = None,
    seed: int = 0,
    workers: int = 1,
    baselines: Mapping[str, Baseline] = BASELINES,
) -> Evaluation:
    """Score models and baselines on the same held-out samples; see `foretouch.evaluate`."""
    named = models if isinstance(models, Mapping) else {MODEL: models}
    options: dict[str, Any] = {"refit": refit, "seed": seed, "workers": workers, "baselines": baselines}
    return score_models(dataset_from(samples), named, splits, **options)


def score_models(
    data: Dataset,
    models: Mapping[str, Any],
    splits: Sequence[str],
    *,
    refit: bool | None = None,
    seed: int = 0,
    workers: int = 1,
    baselines: Mapping[str, Baseline] = BASELINES,
) -> Evaluation:
    """Score models by name, and baselines, on the labelled samples of a dataset; see `foretouch.evaluate`."""
    index = data.partition(None).train
    labelled = [data.filled[k] for k in index]
    held_out = {name: _held_out(model, data, labelled, refit) for name, model in models.items()}
    kept, notes = np.full(len(index), True), []
    for name, (_, card, note) in held_out.items():
        trained = ""
        own = None if card is None else trained_on(card, data, index)
        if own is not None and own.any():
            trained = f"; {int(own.sum())} samples that it was trained on are left out"
            kept &= ~own
        elif card is not None and own is None:
            trained = "; whether it was trained on these samples is not known"
        notes.append(f"{name}: {note}{trained}")
    if not kept.any():
        rule = "were trained on by a model, so that none is held out; pass refit=True, or a recipe such as 'contact-v3'"
        raise DatasetError(f"{data.name}: all {len(index)} samples {rule}")
    ranges = usual_ranges(data.sensor.channels)
    asked = HeldOutSamples(data.name, labelled, labels_of(labelled), ranges, data.sensor.valid_values, seed, kept)
    predictors = {name: predict for name, (predict, *_) in held_out.items()}
    result = score_splits(predictors, asked, splits, baselines=baselines, workers=workers)
    return replace(result, notes=tuple(notes))


_Card = Mapping[str, Any]
_REFITTED: Final = "fitted again without the samples of each fold"
_GIVEN: Final = "given as it is"


def _held_out(
    model: Any, data: Dataset, labelled: Sequence[Sample], refit: bool | None
) -> tuple[HoldOut, _Card | None, str]:
    """Return what predicts folds for a recipe, a model or a predictor; the card of one that is given as it is; and a note."""
    if isinstance(model, str):
        return _learner(load_run_config(model), data).predict_fold, None, f"recipe {model}, {_REFITTED}"
    if isinstance(model, TouchModel):
        require_same(data.sensor.channels, model.sensor.channels, data.name)
        if model.card.get("kind") != OWN:
            if refit:
                config = RunConfig.from_card(model.card, model.name).replace(split=None)
                return _learner(config, data).predict_fold, None, f"{model.name}, {_REFITTED}"
            return OwnHoldOut(model, labelled, refitted=False), model.card, f"{model.name}, {_GIVEN}"
    predictor = model.predictor if isinstance(model, TouchModel) else find_predictor(model)
    plain = plain_model(predictor, data.sensor)
    if can_refit(predictor, refit):
        return OwnHoldOut(plain, labelled), None, f"{plain.name}, {_REFITTED}"
    card = model.card if isinstance(model, TouchModel) else plain.card
    return OwnHoldOut(plain, labelled, refitted=False), card, f"{plain.name}, {_GIVEN}"


def _learner(config: RunConfig, data: Dataset) -> Learner:
    """Return the learner of a recipe for all samples; networks fade to the mean on other objects, as in a release."""
    return make_learner(config.replace(calibrate=True), data)
