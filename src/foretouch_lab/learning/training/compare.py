# SPDX-License-Identifier: Apache-2.0
"""Scores of models and every baseline on the same held-out samples, by split.

The intervals of each fold are calibrated on the held-out predictions of the other folds, in the same way for models and
baselines. So is the adaptation to touches of the split `touches`: it takes the predictions of objects left out, and scores the
first three grasps on each object in order of time, each adapted to the readings of those before.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import numpy as np

from foretouch.errors import shown
from foretouch.models.calibration import Calibration
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import Ranges
from foretouch.types import Bool, Float64, Index, Sample
from foretouch.types.channels import Channels
from foretouch.types.summary import Summarised
from foretouch_lab.learning.data import make_folds
from foretouch_lab.learning.data.folds import Fold, HoldOut, predict_folds
from foretouch_lab.learning.evaluation.baselines import BASELINES, Baseline, predict_part, training_mean
from foretouch_lab.learning.evaluation.evaluate import MODEL
from foretouch_lab.learning.evaluation.metrics import ObjectErrors, mean_skill, score
from foretouch_lab.learning.prequential import TimedReadings, replay
from foretouch_lab.learning.training.calibration import (
    COVERAGE,
    HeldOutPredictions,
    calibration_folds,
    fit_group,
    half_widths,
)
from foretouch_lab.learning.training.learners import Learner

Report = Callable[[Mapping[str, Any]], None]

FIRST_TOUCHES: Final = "touches"
"""The split of the first grasps on objects left out, in order of time, each adapted to the readings of those before."""

_FIRST: Final = 3  # grasps on an object


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Summarised):
    """Scores of models and baselines on the same held-out samples.

    Attributes:
        data: Name of the dataset.
        channels: Of the readings.
        scores: By split, predictor and modality: `rmse` and `interval_score` in the unit of the sensor, `nrmse`, `skill`,
            `coverage90`.
        errors: By split and predictor, for `compare` of `foretouch_lab.learning.evaluation.metrics`.
        samples: By split, how many samples were scored.
        notes: How each model was held out, a line each.
    """

    data: str
    channels: Channels
    scores: dict[str, dict[str, dict[str, dict[str, float]]]] = field(default_factory=dict)
    errors: dict[str, dict[str, ObjectErrors]] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each split and predictor as plain data: skills by modality, and means over the modalities."""
        return [_record(split, who, scores) for split, table in self.scores.items() for who, scores in table.items()]

    def __str__(self) -> str:
        """Return a table of skills and coverages, and the notes."""
        rows = [["split", "predictor", "mean", *self.channels.modalities, "inside"]]
        for row in self.records():
            skills = (row["mean_skill"], *(row["skill"][name] for name in self.channels.modalities))
            rows.append([row["split"], row["who"], *(f"{skill:+.3f}" for skill in skills), f"{row['coverage90']:.3f}"])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        title = (
            f"skill on {self.data}: 0 is the training mean, 1 is perfect; inside: share of readings in 90 % intervals"
        )
        return "\n".join([title, *lines, *self.notes])

    def _summary(self) -> tuple[str, dict[str, str]]:
        """Return for each split the predictor with the highest mean skill; `print` shows all of them."""
        best = {}
        for split, table in self.scores.items():
            skills = {who: mean_skill(scores) for who, scores in table.items()}
            who = max(skills, key=lambda name: skills[name])
            best[split] = f"best of {len(skills)}: {who} {skills[who]:+.3f}, {self.samples[split]} samples"
        return f"mean skill on {shown(self.data, 40)}", best


def _record(split: str, who: str, scores: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    skills = {modality: round(row["skill"], 3) for modality, row in scores.items()}
    inside = round(float(np.mean([row["coverage90"] for row in scores.values()])), 3)
    return {
        "split": split,
        "who": who,
        "mean_skill": round(mean_skill(scores), 3),
        "skill": skills,
        "coverage90": inside,
    }


@dataclass(frozen=True, eq=False)
class HeldOutSamples:
    """What predictors are scored on.

    Attributes:
        name: Of the dataset.
        samples: S labelled samples.
        labels: (S, D) their labels [counts].
        ranges: Of `nrmse`, with the channels.
        valid: (D,) values that are scored.
        seed: Of random folds and of the baselines.
        kept: (S,) samples that are scored; all if None.
    """

    name: str
    samples: Sequence[Sample]
    labels: Float64
    ranges: Ranges
    valid: Bool
    seed: int = 0
    kept: Bool | None = None

    def folds(self, split: str) -> list[Fold]:
        """Return the folds of a split; of time and of objects those of a calibration."""
        condition = {"time": "known", "object": "new"}.get(predicted_once(split))
        if condition is None:
            return make_folds(self.samples, split, self.seed)
        return calibration_folds(self.samples, self.seed)[condition][0]


def predicted_once(split: str) -> str:
    """Return the split whose predictions a split is scored on: first touches are of objects left out."""
    return "object" if split == FIRST_TOUCHES else split


def score_splits(
    predictors: Mapping[str, HoldOut],
    asked: HeldOutSamples,
    splits: Sequence[str],
    *,
    baselines: Mapping[str, Baseline] = BASELINES,
    report: Report = lambda _: None,
    workers: int = 1,
) -> Evaluation:
    """Score predictors and baselines by cross-validation.

    Args:
        predictors: By name, what predicts the test side of a fold.
        asked: The samples.
        splits: Names from `SPLITS`, and `FIRST_TOUCHES`.
        baselines: By name.
        report: Called with each record of `Evaluation.records` as soon as it is known.
        workers: Number of processes.
    """
    beside = {name: partial(predict_part, one, asked.samples, asked.seed) for name, one in baselines.items()}
    every: dict[str, HoldOut] = {**predictors, **beside}
    result = Evaluation(asked.name, asked.ranges.channels)
    every_one = np.full(len(asked.samples), True) if asked.kept is None else asked.kept
    names = np.array([sample.object for sample in asked.samples])
    by_folds: dict[str, dict[str, Float64]] = {}  # objects left out are predicted once
    for split in splits:
        folds, made_of = asked.folds(split), predicted_once(split)
        if made_of not in by_folds:
            by_folds[made_of] = predict_folds({name: (predict, folds) for name, predict in every.items()}, workers)
        kept = every_one
        if split == FIRST_TOUCHES:
            kept = kept & np.isin(np.arange(len(names)), np.concatenate(list(_first_grasps(asked).values())))
        labels = asked.labels[kept]
        mean = partial(predict_part, training_mean, asked.samples, asked.seed)
        reference = predict_folds({"": (mean, folds)})[""][kept]
        result.scores[split], result.errors[split], result.samples[split] = {}, {}, int(kept.sum())
        for name, vision in by_folds[made_of].items():
            held_out = HeldOutPredictions(vision, asked.labels, names, names, result.channels)
            if split == FIRST_TOUCHES:
                counts, half = _after_touches(held_out, asked, folds)
            else:
                counts, half = vision, _held_out_half_widths(held_out, folds)
            scores: dict[str, dict[str, float]] = score(
                counts[kept], labels, reference, asked.ranges, valid=asked.valid
            )
            for modality, row in _interval_scores(labels - counts[kept], half[kept], asked).items():
                scores[modality] |= row
            result.scores[split][name] = scores
            errors = ObjectErrors.of_predictions(list(names[kept]), counts[kept], labels, reference, result.channels)
            result.errors[split][name] = errors
            report(_record(split, name, scores))
    return result


def _held_out_half_widths(held_out: HeldOutPredictions, folds: Sequence[Fold]) -> Float64:
    """Return (S, D) half widths of each fold's samples, calibrated on the held-out predictions of the other folds."""
    half = np.empty_like(held_out.predicted)
    for fold in folds:
        others = np.full(len(half), True)
        others[fold.test] = False
        half[fold.test] = half_widths(held_out.take(others))
    return half


def _first_grasps(asked: HeldOutSamples) -> dict[str, Index]:
    """Return the first samples of each object, in order of time."""
    stamps = np.array([sample.stamp_ns for sample in asked.samples])
    names = np.array([sample.object for sample in asked.samples])
    own = {str(name): np.flatnonzero(names == name) for name in np.unique(names)}
    return {name: rows[np.argsort(stamps[rows], kind="stable")][:_FIRST] for name, rows in own.items()}


def _after_touches(
    held_out: HeldOutPredictions, asked: HeldOutSamples, folds: Sequence[Fold]
) -> tuple[Float64, Float64]:
    """Return (S, D) predictions of the first grasps on each object after the touches before, and half widths; NaN of others.

    The tracker knows the readings of this object alone, and its parameters are fitted to the objects of the other folds.
    """
    counts, half = np.full((2, *held_out.predicted.shape), np.nan)
    first, channels, rest = _first_grasps(asked), held_out.channels, np.zeros(held_out.channels.size)
    for fold in folds:
        tested = np.isin(np.arange(len(asked.samples)), fold.test)
        group = fit_group(held_out.take(~tested), new=True)
        calibration = Calibration(channels, rest, {"known": group, "new": group})
        for own in (first[name] for name in np.unique(held_out.objects[tested]).tolist()):
            touched = [asked.samples[k] for k in own.tolist()]
            readings = TimedReadings.of_samples(touched, held_out.labels[own], held_out.predicted[own], rest)
            alone = replace(readings.ordered(), tares=None, tdc=None, tare_tdc=None)
            played = replay(SensorTracker(calibration.tracker_parameters), alone)
            counts[own], half[own] = played.counts, played.half
    return counts, half


def _interval_scores(residuals: Float64, half: Float64, asked: HeldOutSamples) -> dict[str, dict[str, float]]:
    """Return by modality the coverage, and the interval score [Gneiting and Raftery 2007, eq. 43] in the sensor's unit."""
    beyond = np.maximum(np.abs(residuals) - half, 0.0)
    interval = 2.0 * half + 2.0 / (1.0 - COVERAGE) * beyond
    columns = {name: own[asked.valid[own]] for name, own in asked.ranges.channels.modality_columns.items()}
    return {
        name: {"coverage90": float((beyond[:, own] == 0.0).mean()), "interval_score": float(interval[:, own].mean())}
        for name, own in columns.items()
    }


def compare_splits(learner: Learner, splits: Sequence[str], report: Report, workers: int = 1) -> Evaluation:
    """Score a training method, which is fitted to each fold, and every baseline on its training samples; see `score_splits`."""
    channels, config = learner.sensor.channels, learner.config
    valid, name = learner.sensor.valid_values, learner.data_name
    asked = HeldOutSamples(name, learner.samples, learner.labels, config.ranges(channels), valid, config.seed)
    return score_splits({MODEL: learner.predict_fold}, asked, splits, report=report, workers=workers)
