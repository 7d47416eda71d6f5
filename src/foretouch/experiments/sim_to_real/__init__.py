# SPDX-License-Identifier: Apache-2.0
"""Transfer from simulation: do simulated grasps improve predictions on real objects that were never touched?

As in `unseen_object`, each real object is left out once and predicted without a touch and after some. Predictors that
are trained on the other real objects alone are compared with those that also use trees trained on simulated grasps. The
real object that is left out is used nowhere before it is touched.

The trees learn the change from the tare, since simulated resting readings are not those of a real finger. For a real
grasp x they predict f(x). With µ the mean of the real labels of the training objects and f̄ that of f over their
grasps:

    offset     µ + f(x) - f̄                                                                   (1)
    scaled     µ + b (f(x) - f̄),  b of each modality by least squares on the training grasps   (2)
    residual   scaled, and trees trained on its real residuals                                 (3)

b is limited to 0...1, so that simulation is at most used in full and never inverted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments import unseen_object
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.shared.predictors import PREDICTORS, Fit, find_predictor, with_offset_correction
from foretouch.experiments.shared.real_grasps import RESUMABLE, labelled
from foretouch.experiments.shared.simulated_data import BothSettings, RealAndSimulated, load_both, prepare_both
from foretouch.learning.evaluation.baselines import TREES, Baseline, geometry_trees
from foretouch.tactile import MODALITIES, columns
from foretouch.types import Float64, GraspSample

__all__ = ["EXPERIMENT", "TRANSFER_METHODS", "SimToRealSettings", "simulated_changes"]

Changes = Mapping[str, Float64]
"""f by the id of the sample."""


def simulated_changes(
    simulated: Sequence[GraspSample], real: Sequence[GraspSample], seed: int, trees: int
) -> dict[str, Float64]:
    """Predict f for every real grasp: (50,) by id [counts].

    Args:
        simulated: Training samples with touch and tare.
        real: Samples to predict; their labels are not used.
        seed: Seed of the trees.
        trees: Number of trees.
    """
    train = [sample for sample in simulated if sample.touch is not None and sample.tare is not None]
    changes = np.array(
        [s.touch.vector() - s.tare.vector() for s in train if s.touch is not None and s.tare is not None]
    )
    predicted = geometry_trees(train, changes, [replace(sample, touch=None) for sample in real], seed, trees=trees)
    return {sample.id: row for sample, row in zip(real, predicted, strict=True)}


def _offset(changes: Changes) -> Baseline:
    """Eq. 1."""
    return _transfer(changes, lambda f, _labels: np.ones(f.shape[1]))


def _scaled(changes: Changes) -> Baseline:
    """Eq. 2."""
    return _transfer(changes, _slopes)


def _residual(changes: Changes, trees: int) -> Baseline:
    """Eq. 3."""

    def predict(train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample], seed: int) -> Float64:
        predicted = _scaled(changes)(train, labels, [*train, *test], seed)
        residuals = labels - predicted[: len(train)]
        return predicted[len(train) :] + geometry_trees(train, residuals, test, seed, trees=trees)

    return predict


TRANSFER_METHODS: Final[dict[str, Callable[[Changes, int], Baseline]]] = {
    "simulated_offset": lambda changes, _: _offset(changes),
    "simulated_scaled": lambda changes, _: _scaled(changes),
    "simulated_and_real": _residual,
}
"""By name of the predictor, from f and the number of real trees."""


def _transfer(changes: Changes, slopes: Callable[[Float64, Float64], Float64]) -> Baseline:
    def predict(train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample], seed: int) -> Float64:
        del seed
        f, f_test = (np.array([changes[sample.id] for sample in side]) for side in (train, test))
        return np.asarray(labels.mean(axis=0) + slopes(f, labels) * (f_test - f.mean(axis=0)), np.float64)

    return predict


def _slopes(f: Float64, labels: Float64) -> Float64:
    """(50,) b of eq. 2: one for all values of a modality."""
    f, labels = f - f.mean(axis=0), labels - labels.mean(axis=0)
    result = np.zeros(f.shape[1])
    for name in MODALITIES:
        index = columns([name])
        squares = float((f[:, index] ** 2).sum())
        if squares > 0.0:
            result[index] = np.clip(float((f[:, index] * labels[:, index]).sum()) / squares, 0.0, 1.0)
    return result


@dataclass(frozen=True, kw_only=True)
class SimToRealSettings(unseen_object.UnseenObjectSettings, BothSettings):
    """Settings of `sim_to_real`."""

    scene: str = setting("config/scenes/rigid.yaml", "Scene of the simulated training grasps")
    samples: int = setting(2000, "Number of simulated grasps", minimum=10, maximum=1_000_000)
    predictors: tuple[str, ...] = setting(
        ("training_mean", "geometry_trees", *TRANSFER_METHODS, "contact"),
        "Predictors to compare",
        choices=(*PREDICTORS, *TRANSFER_METHODS),
    )
    touches: tuple[int, ...] = setting((0, 1, 3, 5), "Numbers of touches of the new object", minimum=0, maximum=1000)


def _run(cell: Cell, settings: SimToRealSettings, data: RealAndSimulated) -> list[Row]:
    fit = _predictor(cell.values["predictor"], settings, data, cell.values["seed"])
    return unseen_object.left_out_rows(fit, cell, settings, data.real)


def _predictor(name: str, settings: SimToRealSettings, data: RealAndSimulated, seed: int) -> Fit:
    if name not in TRANSFER_METHODS:
        return find_predictor(name, settings.effort)
    trees = max(1, round(settings.effort * TREES))
    return with_offset_correction(TRANSFER_METHODS[name](_changes(data, seed, trees), trees))


@lru_cache(maxsize=1)
def _changes(data: RealAndSimulated, seed: int, trees: int) -> dict[str, Float64]:
    return simulated_changes(labelled(data.simulated), labelled(data.real), seed, trees)


EXPERIMENT = Experiment(
    name="sim_to_real",
    question="Does training on simulated grasps improve predictions on real objects that were never touched?",
    module=__name__,
    order=70,
    settings=SimToRealSettings,
    presets={"full": {}, "smoke": {"samples": 100, "effort": 0.1, "draws": 3, "bootstrap.draws": 200}},
    load=load_both,
    cells=lambda settings, data: unseen_object.left_out_cells(settings, data.real),
    run=_run,
    tabulate=unseen_object.tabulate_touches,
    summarise=unseen_object.summarise_touches,
    figure=unseen_object.draw_touches,
    prepare=prepare_both,
    resumable_settings=RESUMABLE,
    data_folder="vision2tactile",
)
