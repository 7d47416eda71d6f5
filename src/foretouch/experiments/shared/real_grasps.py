# SPDX-License-Identifier: Apache-2.0
"""Settings, squared errors and score table of the experiments on real grasps."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.experiments.framework.experiment import Row
from foretouch.experiments.shared.predictors import EARLIER, NETWORKS, PREDICTORS
from foretouch.learning.data import Dataset, load_dataset
from foretouch.learning.evaluation.metrics import MEAN, BootstrapConfig, Estimate, ObjectErrors, compare, skills
from foretouch.tactile import MODALITIES, P1_RANGES, P2_RANGES
from foretouch.types import Float64, GraspSample

ALL_OBJECTS: Final = "all"
"""Value of the column `object` for all objects together."""

_DECIMALS: Final = 6


@dataclass(frozen=True, kw_only=True)
class RealGraspSettings(Settings):
    """Settings that all experiments on real grasps share."""

    predictors: tuple[str, ...] = setting(
        tuple(name for name in PREDICTORS if name not in (*NETWORKS, *EARLIER)),
        "Predictors to compare",
        choices=tuple(PREDICTORS),
    )
    seeds: tuple[int, ...] = setting(
        (0, 1, 2, 3, 4), "Seeds of folds and predictors; errors are pooled over them", minimum=0
    )
    network_seeds: int = setting(1, "Number of seeds for the slow networks", minimum=1)
    effort: float = setting(1.0, "Share of trees and epochs; below 1 only for quick trials", minimum=0.001, maximum=1.0)
    references: tuple[str, ...] = setting(
        ("geometry_trees",), "Predictors that the others are compared with", choices=tuple(PREDICTORS)
    )
    bootstrap: BootstrapConfig = BootstrapConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("predictors", "seeds"):
            values = getattr(self, name)
            if not values or len(set(values)) != len(values):
                raise ConfigError(
                    f"{type(self).__name__}.{name}: {list(values)} must contain at least one value and no duplicates"
                )


PRESETS: Final[dict[str, dict[str, Any]]] = {
    "full": {"predictors": list(PREDICTORS)},  # hours
    "quick": {},  # all but the networks of the papers: minutes
    "smoke": {"seeds": [0], "effort": 0.1},
}

RESUMABLE: Final = ("predictors", "seeds", "network_seeds", "references", "bootstrap")
"""Settings that no cell depends on; its predictor and seed are among its values."""


def load(settings: Settings, path: Path) -> Dataset:
    """Load the samples at a path (see `load_dataset`)."""
    del settings
    return load_dataset(path)


def labelled(data: Dataset) -> list[GraspSample]:
    """Samples that have a touch, in order."""
    return [sample for sample in data.samples if sample.touch is not None]


def seeded_predictors(settings: RealGraspSettings) -> list[tuple[int, str]]:
    """All (seed, predictor) to run; networks run with the first `network_seeds` seeds only."""
    return [
        (seed, name)
        for number, seed in enumerate(settings.seeds)
        for name in settings.predictors
        if name not in NETWORKS or number < settings.network_seeds
    ]


def error_rows(tested: Sequence[GraspSample], predicted: Float64, labels: Float64, mean: Float64) -> list[Row]:
    """Sums of squared errors, one row per object, as `ObjectErrors` adds them up.

    Args:
        tested: (S,) test samples.
        predicted: (S, 50) predictions [counts].
        labels: (S, 50) labels [counts].
        mean: (50,) mean of the training labels, the reference of the skill [counts].

    Raises:
        DatasetError: If a prediction is not finite or missing.
    """
    if predicted.shape != labels.shape or not np.isfinite(predicted).all():
        raise DatasetError(f"predictions: shape {predicted.shape} or a value that is not finite")
    names = np.array([sample.object for sample in tested])
    squared, reference = (predicted - labels) ** 2, (mean - labels) ** 2
    return [
        {
            "object": str(name),
            "count": int((names == name).sum()),
            "squared": squared[names == name].sum(axis=0).tolist(),
            "reference": reference[names == name].sum(axis=0).tolist(),
        }
        for name in np.unique(names)
    ]


def score_table(settings: RealGraspSettings, rows: Sequence[Row]) -> list[Row]:
    """Rows of `results.csv`: one for each table, predictor, object and modality.

    Args:
        settings: Configuration of the bootstrap, and the references.
        rows: Rows of `error_rows`, with `table`, `part`, `predictor` and `seed`. A predictor that lacks a part of a
            table, because a cell failed, is left out of that table.
    """
    result: list[Row] = []
    for table in dict.fromkeys(row["table"] for row in rows):
        complete = _complete([row for row in rows if row["table"] == table])
        for name in (name for name in settings.predictors if name in complete):
            result += _predictor_rows(settings, table, name, complete)
    return result


def _complete(rows: Sequence[Row]) -> dict[str, dict[int, list[Row]]]:
    """Rows by predictor and seed, of the predictors that have every part of the table."""
    parts: dict[int, set[str]] = {}
    grouped: dict[str, dict[int, list[Row]]] = {}
    for row in rows:
        parts.setdefault(row["seed"], set()).add(row["part"])
        grouped.setdefault(row["predictor"], {}).setdefault(row["seed"], []).append(row)
    return {
        name: seeds
        for name, seeds in grouped.items()
        if all({row["part"] for row in own} == parts[seed] for seed, own in seeds.items())
    }


def _predictor_rows(
    settings: RealGraspSettings, table: str, name: str, all_rows: dict[str, dict[int, list[Row]]]
) -> list[Row]:
    seeds = list(all_rows[name])
    errors = _errors(all_rows[name], seeds)
    versus = {}
    for other in settings.references:
        common = [seed for seed in seeds if seed in all_rows.get(other, {})]
        if other != name and common:
            pair = (_errors(all_rows[name], common), _errors(all_rows[other], common))
            versus[other] = compare(*pair, settings.bootstrap)
    head = {"table": table, "predictor": name, "seeds": len(seeds)}
    result = _rows({**head, "object": ALL_OBJECTS}, errors, settings, versus)
    for one in errors.objects if len(errors.objects) > 1 else ():
        result += _rows({**head, "object": one}, errors.only(one), settings, {})
    return result


def _errors(rows: dict[int, list[Row]], seeds: Iterable[int]) -> ObjectErrors:
    return ObjectErrors.total(
        [
            (row["object"], row["count"], np.array(row["squared"]), np.array(row["reference"]))
            for seed in seeds
            for row in rows[seed]
        ]
    )


def _rows(
    head: Row, errors: ObjectErrors, settings: RealGraspSettings, versus: dict[str, dict[str, Estimate]]
) -> list[Row]:
    own, rmse, mean_rmse = skills(errors, settings.bootstrap), errors.rmse(), errors.reference_rmse()
    head = {**head, "objects": len(errors.objects), "samples": round(float(errors.counts.sum()) / head["seeds"])}
    result = []
    for modality in (*MODALITIES, MEAN):
        row = {**head, "modality": modality} | _rmse_columns(modality, rmse, mean_rmse)
        row |= {f"skill{end}": _rounded(value) for end, value in _ends(own[modality])}
        for other in settings.references:
            difference = versus[other][modality] if other in versus else None
            row |= {f"vs_{other}{end}": _rounded(value) for end, value in _ends(difference)}
            row[f"vs_{other}_verdict"] = difference.verdict if difference else None
        result.append(row)
    return result


def _rmse_columns(modality: str, rmse: dict[str, float], mean_rmse: dict[str, float]) -> dict[str, Any]:
    if modality == MEAN:  # a mean over counts of different sensors has no meaning
        return dict.fromkeys(("rmse", "rmse_of_mean", "nrmse_p1", "nrmse_p2"))
    value = rmse[modality]
    result: dict[str, Any] = {"rmse": round(value, 3), "rmse_of_mean": round(mean_rmse[modality], 3)}
    for name, ranges in (("nrmse_p1", P1_RANGES), ("nrmse_p2", P2_RANGES)):
        low, high = ranges.of(modality)
        result[name] = _rounded(value / (high - low))
    return result


def _ends(estimate: Estimate | None) -> list[tuple[str, float | None]]:
    if estimate is None:
        return [("", None), ("_low", None), ("_high", None)]
    return [("", estimate.value), ("_low", estimate.low), ("_high", estimate.high)]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, _DECIMALS)
