# SPDX-License-Identifier: Apache-2.0
"""The leaderboard of touch models: anybody's predictor and every baseline on the same held-out grasps (`foretouch benchmark touch`).

    random    five random parts: neighbours in time are in training and in test
    time      five blocks of each object's grasps, in order of time
    object    each object left out
    touches   as `object`; the first three grasps on it in order of time, each adapted to the readings of those before

A row is one predictor on one split. Each is fitted again without the grasps that it is tested on, and its intervals are
calibrated on the held-out errors of the other folds, in the same way for all (`foretouch.evaluate`).
"""

import hashlib
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.base.files import file_sha256
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.models.own import PREDICTORS as INSTALLED
from foretouch.models.own import find_predictor
from foretouch.models.registry import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.report.panels import INK, PAGE_INCH, SMALL_PT, TEXT_PT, Rows, new_figure, save_small
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch_lab.experiments.framework.manifest import cell_seconds
from foretouch_lab.experiments.shared.figures import draw_intervals
from foretouch_lab.experiments.shared.predictors import PREDICTORS
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.experiments.shared.tables import grouped, interval_text, pivot, select, unique, with_notes
from foretouch_lab.learning.data import Dataset
from foretouch_lab.learning.data.folds import SPLITS
from foretouch_lab.learning.evaluation.baselines import predict_part
from foretouch_lab.learning.evaluation.metrics import (
    MEAN,
    BootstrapConfig,
    ObjectErrors,
    ScoreEstimate,
    compare,
    skills,
)
from foretouch_lab.learning.training.compare import FIRST_TOUCHES, Evaluation, predicted_once, score_splits
from foretouch_lab.learning.training.run_config import RunConfig, recipe_of
from foretouch_lab.learning.training.scoring import HeldOut, held_out_samples, hold_out

_BASELINES: Final = tuple(name for name in PREDICTORS if name != "contact")


@dataclass(frozen=True, kw_only=True)
class LeaderboardSettings(Settings):
    """Settings of the leaderboard."""

    models: tuple[str, ...] = setting(
        ("contact-v3",),
        "Models beside the baselines: recipes of foretouch train, with settings such as 'p2 model.outputs=each'; "
        "module:attribute of your own predictor; or model folders, which are used as they are",
    )
    baselines: tuple[str, ...] = setting(_BASELINES, "Baselines", choices=_BASELINES)
    splits: tuple[str, ...] = setting((*SPLITS, FIRST_TOUCHES), "What is left out", choices=(*SPLITS, FIRST_TOUCHES))
    seeds: tuple[int, ...] = setting((0,), "Seeds of random parts and of predictors; errors are pooled", minimum=0)
    training_fraction: float = setting(
        1.0, "Fraction of the trees of baselines; below 1 only for quick trials", bounds=(0.001, 1.0)
    )
    bootstrap: BootstrapConfig = BootstrapConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if both := sorted(set(self.models) & set(_BASELINES)):
            raise ConfigError(f"models: {both[0]} is a baseline, which is scored anyway")
        if twice := [name for name in self.models if self.models.count(name) > 1]:
            raise ConfigError(f"models: {twice[0]} is given twice")


@dataclass(frozen=True, kw_only=True)
class Leaderboard(Experiment):
    """The experiment behind `foretouch benchmark touch`."""

    @property
    def command(self) -> str:
        """Words that run it."""
        return "foretouch benchmark touch"

    def finish(self, settings: Any, data: Any, rows: list[Row], out: Path, _progress: Any, /) -> list[Row]:
        """Score the predictions of all folds, and add the hash of the data and the processor time of each row [s]."""
        cell_times, seconds = cell_seconds(out), dict[tuple[str, str], float]()
        for cell in _cells(settings, data):
            own = cell.values["predictor"], cell.values["split"]
            seconds[own] = seconds.get(own, 0.0) + cell_times.get(cell.key, 0.0)
        return [{**row, "data": data.sha256[:16]} for row in _table(settings, _scored(settings, data, rows), seconds)]


def _cells(settings: LeaderboardSettings, data: Dataset) -> list[Cell]:
    """Return a cell for each seed, predictor, split and fold; objects left out and first touches are of one."""
    samples = held_out_samples(data, settings.seeds[0]).samples
    if FIRST_TOUCHES in settings.splits and any(sample.stamp_ns <= 0 for sample in samples):
        others = ",".join(split for split in settings.splits if split != FIRST_TOUCHES)
        rule = f"needs the time of every grasp, and {data.name} holds grasps without one; leave it out: 'splits=[{others}]'"
        raise ConfigError(f"splits: {FIRST_TOUCHES}: {rule}")
    parts = dict.fromkeys(predicted_once(split) for split in settings.splits)
    versions = {name: _version(name) for name in settings.models}
    return [
        Cell(
            re.sub(r"[^\w.+-]", "_", f"{name}{versions.get(name, '')}+{split}{number}+seed{seed}"),
            {"predictor": name, "split": split, "fold": fold.name, "seed": seed},
        )
        for seed in settings.seeds
        for name in (*settings.baselines, *settings.models)
        for split in parts
        for number, fold in enumerate(held_out_samples(data, seed).folds(split))
    ]


def _run(cell: Cell, settings: LeaderboardSettings, data: Dataset) -> list[Row]:
    """Return the predictions of the test side of one fold, and how the predictor was held out."""
    name, split, seed = (cell.values[key] for key in ("predictor", "split", "seed"))
    (fold,) = [one for one in held_out_samples(data, seed).folds(split) if one.name == cell.values["fold"]]
    held_out, sha256 = _held_out(name, data, seed, settings.training_fraction)
    origin = {"note": held_out.note, "hash": sha256, "trained_on": held_out.trained_on.tolist()}
    return [{"key": cell.key, **origin, "predicted": held_out.predict(fold).tolist()}]


@lru_cache(maxsize=1)
def _held_out(name: str, data: Dataset, seed: int, training_fraction: float) -> tuple[HeldOut, str]:
    """Return what predicts folds, and its hash (`_hash_of`); kept for the next fold of the same predictor."""
    if name in _BASELINES:
        samples = held_out_samples(data, seed).samples
        predict = partial(predict_part, PREDICTORS[name](training_fraction), samples, seed)
        return HeldOut(predict, "baseline"), ""
    model = _model(name, seed)
    return hold_out(model, data), _hash_of(name, model)


def _model(name: str, seed: int) -> Any:
    """Return what a name stands for: a recipe, the model of a folder or card, or a predictor (`find_predictor`)."""
    if re.match(r"[^\s=]+:", name):
        return find_predictor(name)
    try:
        return recipe_of(name).with_seed(seed)
    except ConfigError as err:
        if Path(name).exists():
            return load_model(name)
        if name in INSTALLED:
            return find_predictor(name)
        raise ConfigError(f"models: {err}; nor is it a model folder or module:attribute") from err


def _version(name: str) -> str:
    """Return what keeps cells of a changed model apart: the hash of its weights or its code; "" for a recipe, whose name says all."""
    model = _model(name, 0)
    return "" if isinstance(model, RunConfig) else f"+{_hash_of(name, model)}"


def _hash_of(name: str, model: Any) -> str:
    """Return 16 digits of a hash: of a recipe's settings, a model's weights, or the file that the predictor of a name is in."""
    if isinstance(model, TouchModel):
        return model.sha256[:16]
    if isinstance(model, RunConfig):
        return hashlib.sha256(json.dumps(model.to_mapping(), sort_keys=True).encode()).hexdigest()[:16]
    module = sys.modules.get(name.partition(":")[0]) or sys.modules[type(model).__module__]
    return file_sha256(str(module.__file__))[:16]


_Scored = dict[str, dict[str, list[Evaluation]]]  # by split and predictor, one of each seed


def _scored(settings: LeaderboardSettings, data: Dataset, rows: Sequence[Row]) -> _Scored:
    """Return the scores of the predictors of which all folds of all seeds are known; one that lacks a cell is left out."""
    result: _Scored = {split: {} for split in settings.splits}
    for (split, name), own in grouped(rows, "split", "predictor"):
        tried = [_evaluated(name, seed, part, data, settings) for seed, part in grouped(own, "seed")]
        of_seeds = [one for one in tried if one is not None]
        for asked in settings.splits:
            if predicted_once(asked) == split and len(of_seeds) == len(settings.seeds):
                result[asked][name] = of_seeds
    return result


def _evaluated(
    name: str, seed: int, rows: Sequence[Row], data: Dataset, settings: LeaderboardSettings
) -> Evaluation | None:
    """Return the scores of one predictor on the splits that are made of the same predictions; None if a fold is missing."""
    first, stored = rows[0], {row["fold"]: np.array(row["predicted"]) for row in rows}
    asked = held_out_samples(data, seed, first["trained_on"])
    if {fold.name for fold in asked.folds(first["split"])} != set(stored):
        return None
    splits = [split for split in settings.splits if predicted_once(split) == first["split"]]
    result = score_splits({name: lambda fold: stored[fold.name]}, asked, splits, baselines={})
    return replace(result, notes=(first["note"], first["hash"]))


def _table(settings: LeaderboardSettings, scored: _Scored, seconds: Mapping[tuple[str, str], float]) -> list[Row]:
    """Return a row for each split, predictor and modality, with the processor time of its folds [s]."""
    result: list[Row] = []
    for split, by_name in scored.items():
        order = [name for name in (*settings.baselines, *settings.models) if name in by_name]
        errors = {name: ObjectErrors.pooled([one.errors[split][name] for one in by_name[name]]) for name in order}
        known = {name: skills(errors[name], settings.bootstrap)[MEAN].value for name in order if name in _BASELINES}
        best = max(known, key=lambda name: known[name]) if known else None
        for name in order:
            versus = None if best in {None, name} else _versus(errors[name], errors[str(best)], settings.bootstrap)
            note, sha256 = by_name[name][0].notes
            head: Row = {"split": split, "predictor": name, "note": note, "hash": sha256}
            head |= {"seeds": " ".join(map(str, settings.seeds)), "samples": by_name[name][0].samples[split]}
            head |= {"objects": len(errors[name].objects), "best_baseline": best}
            skill_of, rmse = skills(errors[name], settings.bootstrap), errors[name].rmse()
            for modality, skill in skill_of.items():  # the mean has a skill, and no error: units differ
                row = {**head, "modality": modality, "rmse": rmse.get(modality), **interval_columns("skill", skill)}
                difference = versus[modality] if versus else None
                row |= interval_columns("vs_best", difference)
                row["vs_best_verdict"] = difference.verdict if difference else None
                parts = [one.scores[split][name].get(modality, {}) for one in by_name[name]]
                row |= {key: _mean(parts, key) for key in ("coverage90", "interval_score")}
                result.append({**row, "cpu_s": seconds.get((name, predicted_once(split)))})
    return result


def _versus(errors: ObjectErrors, other: ObjectErrors, bootstrap: BootstrapConfig) -> dict[str, ScoreEstimate] | None:
    """Compare with another predictor; None if grasps that a model was trained on were left out for one of them."""
    return compare(errors, other, bootstrap) if np.array_equal(errors.counts, other.counts) else None


def _mean(rows: Sequence[Row], key: str) -> float | None:
    """Return the mean of a column; None for the mean of the modalities, whose units differ."""
    return sum(row[key] for row in rows) / len(rows) if all(key in row for row in rows) else None


_NOTES: Final = (
    "skill: 0 is the mean of the training labels, 1 is perfect; [95 % interval by bootstrap over objects]; mean: over the modalities",
    (
        "▲ ▼ =: significantly better than, worse than or not different from the best baseline of the split. The comparison is paired, by "
        "object: the 95 % interval of the difference of skills, in the same draws of objects, does not hold 0. It is not corrected for "
        "the number of rows"
    ),
    "inside: share of readings in the 90 % intervals, which are calibrated on the held-out errors of the other folds",
    "interval score: in the unit of the sensor, by modality [Gneiting and Raftery 2007, eq. 43]; the lower the better",
    "CPU: processor time to fit and predict all folds; the splits object and touches share one fit",
    (
        "touches: the first three grasps on each object left out, in order of time, each adapted to the readings of those before; skill 0 "
        "is the mean of the training labels without a touch"
    ),
)


def _summarise(rows: Sequence[Row]) -> list[Table]:
    """Return a table for each split, the most skilful predictor first."""
    tables, text = [], partial(interval_text, column="skill", verdict="vs_best_verdict", between="\n")
    for split, own in grouped(rows, "split"):
        modalities = [name for name in unique(own, "modality") if name != MEAN]
        totals = sorted(select(own, modality=MEAN), key=lambda row: -row["skill"])
        body = []
        for total in totals:
            mine = select(own, predictor=total["predictor"])
            (cells,) = pivot(mine, "predictor", text, [MEAN, *modalities])
            scored = [row for row in mine if row["modality"] != MEAN]
            inside = f"{_mean(scored, 'coverage90'):.2f}"
            widths = " / ".join(f"{row['interval_score']:.3g}" for row in scored)
            body.append([*cells, inside, widths, f"{total['cpu_s']:.0f} s"])
        columns = ["predictor", "mean", *modalities, "inside", "interval score", "CPU"]
        first = totals[0]
        title = (
            f"{split}: {first['samples']} grasps of {first['objects']} objects; best baseline {first['best_baseline']}"
        )
        tables.append(Table(title, columns, body))
    held_out = [f"{name}: {of_one[0]['note']}{_hashed(of_one[0])}" for name, of_one in grouped(rows, "predictor")]
    models = [line for line in held_out if not line.endswith(": baseline")]
    return with_notes(tables, [*_NOTES, *models])


def _hashed(row: Row) -> str:
    return f" (`{row['hash']}`)" if row["hash"] else ""


def _draw(rows: Rows, folder: Path) -> list[Path]:
    """Draw `leaderboard.png`: mean skill and interval of each predictor, a panel for each split."""
    totals = select(rows, modality=MEAN)
    splits, names = unique(totals, "split"), unique(totals, "predictor")
    names.sort(key=lambda name: (name in _BASELINES, _BASELINES.index(name) if name in _BASELINES else 0))
    figure = new_figure(PAGE_INCH, 1.5 + 0.24 * len(names))
    panels = figure.subplots(1, len(splits), sharex=True, sharey=True, squeeze=False)[0]
    for axes, split in zip(panels, splits, strict=True):
        own = select(totals, split=split)
        draw_intervals(axes, own, "predictor", names, -0.5, _colour)
        axes.set_title(_PANELS[split], fontsize=TEXT_PT)
        axes.tick_params(labelsize=SMALL_PT)
    panels[0].set_yticks(range(len(names)), [_label(name, names) for name in names])
    for name, text in zip(names, panels[0].get_yticklabels(), strict=True):
        text.set(color=_colour({"predictor": name}), fontweight="normal" if name in _BASELINES else "bold")
    better = {
        row["split"] for row in totals if row["vs_best_verdict"] == "better" and row["predictor"] not in _BASELINES
    }
    figure.suptitle(
        f"On {len(better) or 'none'} of {len(splits)} splits is a model (bold) certainly better than the best baseline",
        fontsize=TEXT_PT,
    )
    figure.supxlabel("mean skill (1: perfect, 0: the mean of the training); bars: 95 % intervals", fontsize=TEXT_PT)
    return [save_small(figure, folder / "leaderboard.png")]


def _label(name: str, names: Sequence[str]) -> str:
    """Return a short name of a predictor: without the settings of a recipe, which are numbered if there are several."""
    recipe, _, settings = name.partition(" ")
    if not settings:
        return _PLAIN.get(name, name)
    alike = [other for other in names if other.startswith(f"{recipe} ")]
    return f"{recipe} with settings" + (f" {1 + alike.index(name)}" if len(alike) > 1 else "")


def _colour(row: Mapping[str, Any]) -> str:
    return INK if row["predictor"] in _BASELINES else "#c8501e"


_PANELS: Final = {
    "random": "random:\nknown objects", "time": "time:\nanother time", "object": "object:\nnew objects",
    FIRST_TOUCHES: "touches: new objects,\nafter 0 to 2 touches",
}  # fmt: skip
_PLAIN: Final = {
    "training_mean": "mean of the training", "object_mean": "mean of the object", "object_time_trees": "object and time",
    "clock": "time alone", "geometry_trees": "geometry, with place", "geometry_trees_pose_free": "geometry alone",
}  # fmt: skip


EXPERIMENT = Leaderboard(
    name="leaderboard",
    question="How well does each touch model predict what fingertips will read, beside every baseline?",
    module=__name__,
    settings=LeaderboardSettings,
    presets={
        "full": {},
        "smoke": {"models": [], "training_fraction": 0.02, "splits": ["object", FIRST_TOUCHES], "bootstrap.draws": 200},
    },
    cells=_cells,
    run=_run,
    tabulate=lambda _settings, rows: list(rows),  # the folds, which `finish` scores
    summarise=_summarise,
    figure=_draw,
    resumable_settings=("models", "baselines", "splits", "bootstrap"),
    data_folder="vision2tactile",
)
