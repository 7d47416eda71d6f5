# SPDX-License-Identifier: Apache-2.0
"""Scores of any models and every baseline, in one call of Python.

A recipe, and a predictor that can be fitted, is fitted again without the samples of each fold. A model that is given as it is
predicts them, but for those that it was trained on, which are left out for all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.dataset.samples import SampleSet
from foretouch.errors import ConfigError, DatasetError, none_of, quoted
from foretouch.models.card import OWN
from foretouch.models.own import find_predictor
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import usual_ranges
from foretouch.tactile.description import require_same
from foretouch.types import Index, Sample
from foretouch_lab.learning.data import Dataset, labels_of
from foretouch_lab.learning.data.dataset import dataset_from
from foretouch_lab.learning.data.folds import SPLITS, Fold, HoldOut
from foretouch_lab.learning.evaluation.baselines import BASELINES, Baseline
from foretouch_lab.learning.evaluation.evaluate import MODEL, trained_on
from foretouch_lab.learning.training.compare import FIRST_TOUCHES, Evaluation, HeldOutSamples, score_splits
from foretouch_lab.learning.training.learners import Learner, make_learner
from foretouch_lab.learning.training.own import OwnHoldOut, can_refit, plain_model
from foretouch_lab.learning.training.run_config import RunConfig, recipe_of


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
    known = (*SPLITS, FIRST_TOUCHES)
    if isinstance(splits, str) or not isinstance(splits, Sequence) or not splits:
        raise ConfigError(f"splits: {quoted(splits)} is not a list of {', '.join(known)}")
    for split in splits:
        if split not in known:
            raise ConfigError(f"splits: {none_of(split, known)}")
    named = models if isinstance(models, Mapping) else {MODEL: models}
    data = dataset_from(samples)
    held_out = {name: hold_out(model, data, refit) for name, model in named.items()}
    trained_on = np.concatenate([np.empty(0, np.intp), *(one.trained_on for one in held_out.values())])
    asked = held_out_samples(data, seed, trained_on)
    predictors = {name: one.predict for name, one in held_out.items()}
    result = score_splits(predictors, asked, splits, baselines=baselines, workers=workers)
    return replace(result, notes=tuple(f"{name}: {one.note}" for name, one in held_out.items()))


def held_out_samples(data: Dataset, seed: int, trained_on: npt.ArrayLike = ()) -> HeldOutSamples:
    """Return the labelled samples of a dataset, to be scored without those that a model was trained on.

    Args:
        data: The dataset.
        seed: Of random folds and of the baselines.
        trained_on: (T,) indices of labelled samples that are left out.

    Raises:
        DatasetError: If none is left.
    """
    index = data.partition(None).train
    labelled = [data.filled[k] for k in index]
    kept = ~np.isin(np.arange(len(index)), trained_on)
    if not kept.any():
        rule = "were trained on by a model, so that none is held out; pass refit=True, or a recipe such as 'contact-v3'"
        raise DatasetError(f"{data.name}: all {len(index)} samples {rule}")
    ranges = usual_ranges(data.sensor.channels)
    return HeldOutSamples(data.name, labelled, labels_of(labelled), ranges, data.sensor.valid_values, seed, kept)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """How a model predicts samples that it was not fitted to.

    Attributes:
        predict: Predicts the test side of a fold of the labelled samples.
        note: How it is held out.
        trained_on: (T,) indices of labelled samples that a model that is given as it is was trained on.
    """

    predict: HoldOut
    note: str
    trained_on: Index = field(default_factory=lambda: np.empty(0, np.intp))


_REFITTED: Final = "fitted again without the samples of each fold"
_GIVEN: Final = "given as it is"


def hold_out(model: Any, data: Dataset, refit: bool | None = None) -> HeldOut:
    """Return how a recipe, a model or a predictor is held out of the labelled samples of a dataset.

    Args:
        model: The settings of a recipe or its words (`recipe_of`), a touch model, or a predictor as of `find_predictor`, whose name is
            `module:attribute`.
        data: The dataset.
        refit: Whether a model or predictor is fitted again in each fold; by default a predictor that can be.

    Raises:
        ConfigError: If there is no such recipe.
        ModelError: If the predictor cannot be made, or cannot be fitted again.
    """
    if isinstance(model, str) and ":" not in model:
        return HeldOut(_learner(recipe_of(model), data).predict_fold, f"recipe {model}, {_REFITTED}")
    if isinstance(model, RunConfig):
        return HeldOut(_learner(model, data).predict_fold, f"recipe, {_REFITTED}")
    if isinstance(model, TouchModel):
        require_same(data.sensor.channels, model.sensor.channels, data.name)
        if model.card.get("kind") != OWN:
            if not refit:
                return _as_it_is(model, data)
            config = RunConfig.from_card(model.card, model.name).replace(split=None)
            return HeldOut(_learner(config, data).predict_fold, f"{model.name}, {_REFITTED}")
    predictor = model.predictor if isinstance(model, TouchModel) else find_predictor(model)
    plain = plain_model(predictor, data.sensor)
    if can_refit(predictor, refit):
        return HeldOut(OwnHoldOut(plain, held_out_samples(data, 0).samples), f"{plain.name}, {_REFITTED}")
    return _as_it_is(plain, data, model.card if isinstance(model, TouchModel) else plain.card)


def _as_it_is(model: TouchModel, data: Dataset, card: Mapping[str, Any] | None = None) -> HeldOut:
    """Return the samples that a model which is not fitted again was not trained on, by its card or another one."""
    predict = OwnHoldOut(model, held_out_samples(data, 0).samples, refitted=False)
    own = trained_on(model.card if card is None else card, data, data.partition(None).train)
    if own is None:
        return HeldOut(predict, f"{model.name}, {_GIVEN}; whether it was trained on these samples is not known")
    left_out = f"; {int(own.sum())} samples that it was trained on are left out" if own.any() else ""
    return HeldOut(predict, f"{model.name}, {_GIVEN}{left_out}", np.flatnonzero(own))


def _learner(config: RunConfig, data: Dataset) -> Learner:
    """Return the learner of a recipe for all labelled samples; networks fade to the mean on other objects, as in a release.

    The unlabelled clouds of the SR-GAN are those of all samples, so of each fold those of its training side.
    """
    index = data.partition(None).train
    everything = Fold(index, np.empty(0, np.intp), unlabelled=np.arange(len(data.samples)))
    return make_learner(config.replace(calibrate=True, split=None), data, everything)
