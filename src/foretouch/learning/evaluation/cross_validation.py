# SPDX-License-Identifier: Apache-2.0
"""Cross-validation: a kind of model and the baselines, all trained anew on each fold; `judging` takes a model as it is."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from foretouch.learning.data.folds import Fold
from foretouch.learning.evaluation.baselines import BASELINES, Baseline, training_mean
from foretouch.learning.evaluation.metrics import Score, score
from foretouch.tactile import TactileRanges
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

__all__ = ["MODEL", "Evaluation", "HoldOut", "evaluate"]

MODEL: Final = "model"
"""Beside the names of the baselines: the model itself."""

HoldOut = Callable[[Fold], Float64]
"""Fits to the training side of a fold and gives (T, 50) predictions of its test side [counts]."""

Scores = dict[str, Score]
Mapper = Callable[[HoldOut, Sequence[Fold]], Iterator[Float64]]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Of a model and the baselines on one split.

    Attributes:
        scores: By modality, of `model` and of each baseline.
        predicted: (S, 50) the model's prediction of each sample, by the fold that held it out [counts].
    """

    scores: dict[str, Scores]
    predicted: Float64


def evaluate(
    samples: Sequence[GraspSample],
    labels: Float64,
    model: HoldOut,
    folds: Sequence[Fold],
    ranges: TactileRanges,
    *,
    seed: int = 0,
    workers: int = 1,
    baselines: Mapping[str, Baseline] = BASELINES,
) -> Evaluation:
    """Score a model and the baselines on the same folds.

    Args:
        samples: All samples.
        labels: (S, 50) [counts].
        model: Can be pickled where there are several workers.
        folds: Together they test each sample once.
        ranges: For the normalised error.
        seed: Of the baselines.
        workers: Processes that share the folds out. The scores do not depend on their number.
        baselines: By name; all by default.
    """
    predictors: dict[str, HoldOut] = {MODEL: model}
    for name, baseline in baselines.items():
        predictors[name] = partial(_baseline, samples, labels, baseline, seed)
    with _mapper(workers) as run:
        predicted = {name: _gather(folds, run(predictor, folds)) for name, predictor in predictors.items()}
    means = partial(_baseline, samples, labels, training_mean, seed)
    reference = _gather(folds, map(means, folds))
    scores = {name: score(values, labels, reference, ranges) for name, values in predicted.items()}
    return Evaluation(scores, predicted[MODEL])


def _baseline(samples: Sequence[GraspSample], labels: Float64, baseline: Baseline, seed: int, fold: Fold) -> Float64:
    train = [samples[i] for i in fold.train]
    return baseline(train, labels[fold.train], [samples[i] for i in fold.test], seed)


def _gather(folds: Sequence[Fold], parts: Iterator[Float64]) -> Float64:
    """(S, 50): each sample's prediction by the fold that held it out."""
    count = sum(len(fold.test) for fold in folds)
    result = np.full((count, TOUCH_SIZE), np.nan)
    for fold, part in zip(folds, parts, strict=True):
        result[fold.test] = part
    return result


@contextmanager
def _mapper(workers: int) -> Iterator[Mapper]:
    """Something that maps a predictor over folds, in this process or in several with one thread each."""
    if workers == 1:
        yield map
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_one_thread) as pool:
        yield pool.map


def _one_thread() -> None:
    import torch

    torch.set_num_threads(1)
