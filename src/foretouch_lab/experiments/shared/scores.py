# SPDX-License-Identifier: Apache-2.0
"""Squared errors of predictors by object, and the table of their skills with comparisons."""

from collections.abc import Iterable, Mapping, Sequence

from foretouch.tactile import BIOTAC
from foretouch.types import Sample
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.shared.tables import ALL_OBJECTS, grouped
from foretouch_lab.learning.data import Dataset
from foretouch_lab.learning.evaluation.metrics import (
    MEAN,
    BootstrapConfig,
    ObjectErrors,
    ScoreEstimate,
    compare,
    skills,
)


def labelled(data: Dataset) -> list[Sample]:
    """Return samples that have a touch, in order."""
    return [sample for sample in data.samples if sample.touch is not None]


def score_table(
    rows: Sequence[Row],
    predictors: Sequence[str],
    references: Sequence[str],
    config: BootstrapConfig,
    columns: Sequence[str] = (),
) -> list[Row]:
    """Return rows of `results.csv`: one for each table, predictor, object and modality.

    Args:
        rows: Rows of `error_rows`, with `table`, `part`, `predictor` and `seed`. A predictor that lacks a part of a
            table, because a cell failed, is left out of that table.
        predictors: Predictors in the order of the table.
        references: Predictors that the others are compared with.
        config: Configuration of the bootstrap.
        columns: Further columns, in which the rows of a table do not differ.
    """
    result: list[Row] = []
    for table, own in grouped(rows, "table"):
        head = {name: own[0][name] for name in columns} | {"table": table}
        complete = _complete(own)
        for name in predictors:
            if name in complete:
                result += _predictor_rows({**head, "predictor": name}, complete, references, config)
    return result


def _complete(rows: Sequence[Row]) -> dict[str, dict[int, list[Row]]]:
    """Return rows by predictor and seed, of the predictors that have every part of the table."""
    parts = {seed: {row["part"] for row in own} for seed, own in grouped(rows, "seed")}
    by_predictor = {name: dict(grouped(own, "seed")) for name, own in grouped(rows, "predictor")}
    return {
        name: seeds
        for name, seeds in by_predictor.items()
        if all({row["part"] for row in own} == parts[seed] for seed, own in seeds.items())
    }


def _predictor_rows(
    head: Row, complete: dict[str, dict[int, list[Row]]], references: Sequence[str], config: BootstrapConfig
) -> list[Row]:
    seeds = complete[head["predictor"]]
    errors, versus = _errors(seeds, seeds), {}
    for other in references:
        common = [seed for seed in seeds if seed in complete.get(other, {})]
        if other != head["predictor"] and common:
            versus[other] = compare(_errors(seeds, common), _errors(complete[other], common), config)
    compared = {name: versus.get(name) for name in references}
    parts = [(ALL_OBJECTS, errors, compared)]
    if len(errors.objects) > 1:
        parts += [(name, errors.only(name), dict.fromkeys(references)) for name in errors.objects]
    result = []
    for object_, part, differences in parts:
        size = {"objects": len(part.objects), "samples": round(float(part.counts.sum()) / len(seeds))}
        own = {**head, "seeds": len(seeds), "object": object_, **size}
        result += skill_table(own, part, config, differences)
    return result


def _errors(rows: dict[int, list[Row]], seeds: Iterable[int]) -> ObjectErrors:
    return ObjectErrors.of_rows([row for seed in seeds for row in rows[seed]], BIOTAC)


def skill_table(
    head: Row, errors: ObjectErrors, config: BootstrapConfig, versus: Mapping[str, dict[str, ScoreEstimate] | None]
) -> list[Row]:
    """Return a row for each modality, and one for their mean: error, skill, and differences of skills from other predictors.

    Args:
        head: Columns in which the rows do not differ.
        errors: Of one predictor.
        config: Of the bootstrap.
        versus: By name of the other predictor, the differences; None where they were not compared.
    """
    own, rmse = skills(errors, config), errors.rmse()
    result = []
    for modality in (*errors.channels.modalities, MEAN):  # a mean of errors of different sensors has no meaning
        row = {**head, "modality": modality, "rmse": rmse.get(modality), **interval_columns("skill", own[modality])}
        for name, differences in versus.items():
            difference = differences[modality] if differences else None
            row |= {
                **interval_columns(f"vs_{name}", difference),
                f"vs_{name}_verdict": difference.verdict if difference else None,
            }
        result.append(row)
    return result


def interval_columns(name: str, estimate: ScoreEstimate | None) -> Row:
    """Return three columns of an estimate: its value and the ends of its interval."""
    values = (None, None, None) if estimate is None else (estimate.value, estimate.low, estimate.high)
    return dict(zip((name, f"{name}_low", f"{name}_high"), values, strict=True))


def skill_rows(name: str, rows: Mapping[str, Sequence[Row]], bootstrap: BootstrapConfig) -> dict[str, Row]:
    """Return columns of a skill, by variant: its mean over the modalities with its interval, and the errors by modality.

    `<name>_equals` is the most skilful variant, where this one does not differ significantly from it, in pairs on the same
    grasps.

    Args:
        name: Column of the mean skill, and beginning of the names of the others.
        rows: By variant, of `error_rows` on the same grasps.
        bootstrap: Of the intervals.
    """
    errors = {variant: ObjectErrors.of_rows(own, BIOTAC) for variant, own in rows.items()}
    skill_of = {variant: skills(own, bootstrap)[MEAN] for variant, own in errors.items()}
    best = max(skill_of, key=lambda variant: skill_of[variant].value)
    result = {}
    for variant, own in errors.items():
        equal = variant == best or compare(own, errors[best], bootstrap)[MEAN].verdict == "tie"
        rmse = {f"{name}_rmse_{modality}": value for modality, value in own.rmse().items()}
        result[variant] = interval_columns(name, skill_of[variant]) | rmse | {f"{name}_equals": best if equal else None}
    return result
