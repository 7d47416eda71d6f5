# SPDX-License-Identifier: Apache-2.0
"""Rows of skills with intervals and comparisons."""

from collections.abc import Mapping, Sequence

from foretouch.tactile import BIOTAC
from foretouch.types import Sample
from foretouch_lab.experiments.framework.experiment import Row
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
