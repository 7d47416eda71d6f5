# SPDX-License-Identifier: Apache-2.0
"""P1's network, trained and tested as its public code does it; with and without `eval()`, by its scoring and by ours.

The public code (https://github.com/yayaneath/vision2tactile) never calls `eval()`: in testing, batch norm standardises
each batch of five test clouds by their own statistics. It also has no ReLU before the maximum over the points, trains
on the partial batch at the end of an epoch, adds 1e-6 under the root of the loss, and draws new points of a test cloud
each time. Its "5-fold cross-validation" is `ShuffleSplit`: five independent random splits whose test share is n / 500
of n samples. A score is the mean over the batches of their RMSE, then over the splits.

P1 recorded a crisps can and a coffee can, a snacks box (cheezit) and a sugar box. What still departs from its code: clouds are mapped to the unit sphere before their points are drawn and not after, all
24 electrodes of the thumb are learned and not 23, and the sugar box is not in the public data, so `boxes` are all boxes
of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import DatasetError
from foretouch.tactile import BIOTAC, MODALITIES, P1_RANGES
from foretouch.types import Float64, Sample
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch_lab.experiments.shared.scores import labelled
from foretouch_lab.experiments.shared.tables import grouped, pivot, select, unique
from foretouch_lab.learning.data import Dataset
from foretouch_lab.learning.data.folds import Fold, Indices
from foretouch_lab.learning.data.training_set import TrainingSet

if TYPE_CHECKING:
    from foretouch_lab.learning.network.networks import TouchNet

ACROSS: Final = "across types"
# P1, sections III and IV: RMSE [counts] and over its divisors, by the closest of our tables.
PUBLISHED: Final[dict[str, dict[str, tuple[float, float | None]]]] = {
    "within p1_cylinders": {
        "PDC_TH": (208.0, 0.067),
        "PDC_MF": (153.0, 0.076),
        "E_TH": (216.0, 0.061),
        "E_MF": (231.0, 0.060),
    },
    "within boxes": {
        "PDC_TH": (278.0, 0.089),
        "PDC_MF": (164.0, 0.081),
        "E_TH": (232.0, 0.066),
        "E_MF": (212.0, 0.055),
    },
    ACROSS: {"PDC_TH": (236.0, None), "PDC_MF": (165.0, None), "E_TH": (317.0, None), "E_MF": (310.0, None)},
}

P1: Final = "P1 (published)"  # its name among the predictors

_TYPES: Final = {"p1_cylinders": ("coffee", "pringles"), "boxes": ("cheezit", "spam", "wood")}
_RECIPE: Final = "p1_as_published"
_SPLITS: Final = 5
_SAMPLES_PER_SHARE: Final = 500  # test_size = samples / (folds * 100) in the public code
# Predictors by name; the network by the statistics of its batch norm in testing.
_WAYS: Final = {
    "batch": "network, no eval(), as in the public code",
    "running": "network, eval()",
    "mean": "mean of the training labels",
}


@dataclass(frozen=True, kw_only=True)
class P1Settings(Settings):
    """Settings of `p1_as_published`."""

    modalities: tuple[str, ...] = setting(MODALITIES, "Modalities; one network each", choices=MODALITIES)
    epochs: int | None = setting(None, "Number of epochs; by default the recipe's, 50", bounds=(1, 100_000))


def _tables(samples: Sequence[Sample]) -> dict[str, list[Fold]]:
    """Train and test samples by table: five random splits within each type, and one type against the other."""
    from sklearn.model_selection import ShuffleSplit

    indices = {
        name: np.array([k for k, s in enumerate(samples) if s.object in own], np.intp) for name, own in _TYPES.items()
    }
    tables = {}
    for name, index in indices.items():
        if len(index) < _SPLITS:
            raise DatasetError(f"p1_as_published: {name}: {len(index)} samples are fewer than {_SPLITS}")
        splitter = ShuffleSplit(_SPLITS, test_size=min(len(index) / _SAMPLES_PER_SHARE, 0.8), random_state=0)
        splits = enumerate(splitter.split(index))
        tables[f"within {name}"] = [Fold(index[train], index[test], f"split {k}") for k, (train, test) in splits]
    cylinders, boxes = indices.values()
    both = [Fold(cylinders, boxes, "cylinders to boxes"), Fold(boxes, cylinders, "boxes to cylinders")]
    return {**tables, ACROSS: both}


def _cells(settings: P1Settings, data: Dataset) -> list[Cell]:
    names = ("table", "part", "modality")
    return [
        Cell("+".join(values).replace(" ", "_"), dict(zip(names, values, strict=True)))
        for table, folds in _tables(labelled(data)).items()
        for values in product([table], [fold.name for fold in folds], settings.modalities)
    ]


def _run(cell: Cell, settings: P1Settings, data: Dataset) -> list[Row]:
    """Train one network and test it in both modes, beside the mean of the training labels."""
    from foretouch_lab.learning.training.run_config import load_run_config
    from foretouch_lab.learning.training.supervised import SupervisedTrainer

    samples = labelled(data)
    (fold,) = (fold for fold in _tables(samples)[cell.values["table"]] if fold.name == cell.values["part"])
    modality: str = cell.values["modality"]
    recipe: Any = load_run_config(_RECIPE, [f"model.outputs=[{modality}]"])
    how = recipe.train if settings.epochs is None else recipe.train.replace(epochs=settings.epochs)
    used = np.concatenate([fold.train, fold.test])
    inputs = TrainingSet.build([samples[k] for k in used], recipe.model)
    train, test = np.arange(len(fold.train)), np.arange(len(fold.train), len(used))
    net = SupervisedTrainer(inputs, train, how).train()
    mean = inputs.labels[np.ix_(train, BIOTAC.columns([modality]))].mean(axis=0)
    rows = []
    for way in _WAYS:
        errors = [
            predicted - inputs.labels[np.ix_(batch, BIOTAC.columns([modality]))]
            for batch, predicted in _tested(net, inputs, test, how.batch_size, way, mean)
        ]
        every, score = np.concatenate(errors), np.mean([_rmse(error, modality, how.root_epsilon) for error in errors])
        sums = {"squared": float((every**2).sum()), "values": every.size, "samples": len(test)}
        rows.append({"predictor": way, "batch_rmse": float(score), **sums})
    return rows


def _tested(
    net: TouchNet, inputs: TrainingSet, test: Indices, size: int, way: str, mean: Float64
) -> Iterator[tuple[Indices, Any]]:
    """Iterate over shuffled batches of test samples and their predictions [counts]; all ways see the same batches and points."""
    import torch

    rng = np.random.default_rng(0)
    order = rng.permutation(test)
    net.train(way == "batch")
    for start in range(0, len(order), size):
        batch = order[start : start + size]
        if len(batch) == 1:  # batch norm of a single cloud has no statistics
            return
        points = inputs.points(batch, rng)
        if way == "mean":
            yield batch, np.tile(mean, (len(batch), 1))
        else:
            with torch.no_grad():
                yield batch, net.counts(torch.from_numpy(points)).numpy().astype(np.float64)


def _rmse(error: Any, modality: str, epsilon: float) -> float:
    """Return the RMSE of one batch over P1's divisor, with the ε of its code."""
    scale = P1_RANGES.ranges.of(modality)[1]
    return float(np.sqrt(((error / scale) ** 2).mean() + epsilon))


def _tabulate(settings: P1Settings, rows: Sequence[Row]) -> list[Row]:
    """Return both scores by table, predictor and modality, over all parts of the table that are finished."""
    result: list[Row] = []
    for (table, modality), own in grouped(rows, "table", "modality"):
        scale = P1_RANGES.ranges.of(modality)[1]
        head: Row = {"table": table, "modality": modality, "parts": len(unique(own, "part"))}
        for way, mine in grouped(own, "predictor"):
            batch = [row["batch_rmse"] for row in mine]
            mean, sd = float(np.mean(batch)), float(np.std(batch))
            scores = {"as_published": mean, "as_published_sd": sd, "as_published_counts": mean * scale}
            pooled = np.sqrt(sum(row["squared"] for row in mine) / sum(row["values"] for row in mine))
            result.append({**head, "predictor": _WAYS[way], **scores, "rmse_counts": float(pooled)})
        counts, scaled = PUBLISHED[table][modality]
        published = {"as_published": scaled, "as_published_sd": None, "as_published_counts": counts}
        result.append({**head, "predictor": P1, **published, "rmse_counts": None})
    order = [name for name in MODALITIES if name in settings.modalities]
    return [row for _, own in grouped(result, "table") for name in order for row in select(own, modality=name)]


def _summarise(rows: Sequence[Row]) -> list[Table]:
    scored = "P1's scoring: mean of the batches' RMSE over its divisor; (in counts)"
    ours = "our scoring: RMSE of all test samples in counts"
    tables = []
    for table, own in grouped(rows, "table"):
        tables.append(Table(f"{table}: {scored}", ["rmse", *MODALITIES], pivot(own, "predictor", _published_text)))
        pooled = pivot(
            [row for row in own if row["predictor"] != P1], "predictor", lambda row: f"{row['rmse_counts']:.0f}"
        )
        tables.append(Table(f"{table}: {ours}", ["rmse", *MODALITIES], pooled))
    return tables


def _published_text(row: Row) -> str:
    scaled = "" if row["as_published"] is None else f"{row['as_published']:.3f} "
    return f"{scaled}({row['as_published_counts']:.0f})"


EXPERIMENT = Experiment(
    name="p1_as_published",
    question="What does P1's network reach when it is trained, split, tested and scored as its public code does it?",
    module=__name__,
    settings=P1Settings,
    presets={"full": {}, "smoke": {"epochs": 1}},
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    resumable_settings=("modalities",),
    data_folder="vision2tactile",
)
