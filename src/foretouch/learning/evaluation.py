# SPDX-License-Identifier: Apache-2.0
"""Cross-validation of a network and of the baselines on the same folds."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial

import numpy as np

from foretouch.errors import DatasetError
from foretouch.learning.baselines import BASELINES, Baseline, training_mean
from foretouch.learning.metrics import Score, score
from foretouch.learning.splits import Fold, make_folds
from foretouch.learning.train import TrainConfig, predict_set, train_network
from foretouch.learning.training_set import TrainingSet
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import Float64, GraspSample

__all__ = ["NETWORK", "evaluate"]

NETWORK = "network"
Scores = dict[str, Score]
Predictor = Callable[[Fold], Float64]
Mapper = Callable[[Predictor, Sequence[Fold]], Iterator[Float64]]


def evaluate(
    samples: Sequence[GraspSample],
    data: TrainingSet,
    config: TrainConfig,
    split: str,
    *,
    workers: int = 1,
    baselines: Mapping[str, Baseline] = BASELINES,
) -> dict[str, Scores]:
    """Score a network and the baselines on the folds of one split.

    Args:
        samples: All samples.
        data: The same, prepared for the network; it must predict all modalities, in their usual order.
        config: How the network of each fold is trained.
        split: Out of `SPLITS`.
        workers: Processes that share the folds out. The scores do not depend on their number.
        baselines: By name; all by default.

    Returns:
        Scores by modality, of `network` and of each baseline.

    Raises:
        DatasetError: As of `make_folds` and `train_network`, or if the network predicts other modalities.
    """
    if data.config.outputs != MODALITIES:
        raise DatasetError(f"outputs: {list(data.config.outputs)} are not all modalities, {', '.join(MODALITIES)}")
    folds = make_folds(samples, split, config.seed)
    predictors: dict[str, Predictor] = {NETWORK: partial(_network, data, config)}
    for name, baseline in baselines.items():
        predictors[name] = partial(_baseline, samples, data.labels, baseline, config.seed)
    with _mapper(workers) as run:
        predicted = {name: _gather(folds, run(predictor, folds)) for name, predictor in predictors.items()}
    means = partial(_baseline, samples, data.labels, training_mean, config.seed)
    reference = _gather(folds, map(means, folds))
    ranges = data.config.ranges
    return {name: score(values, data.labels, reference, ranges) for name, values in predicted.items()}


def _network(data: TrainingSet, config: TrainConfig, fold: Fold) -> Float64:
    return predict_set(train_network(data, fold.train, config), data, fold.test)


def _baseline(samples: Sequence[GraspSample], labels: Float64, baseline: Baseline, seed: int, fold: Fold) -> Float64:
    train = [samples[i] for i in fold.train]
    return baseline(train, labels[fold.train], [samples[i] for i in fold.test], seed)


def _gather(folds: Sequence[Fold], parts: Iterator[Float64]) -> Float64:
    """(S, 50): each sample's prediction by the fold that held it out."""
    count = sum(len(fold.test) for fold in folds)
    result = np.full((count, columns(MODALITIES).size), np.nan)
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
