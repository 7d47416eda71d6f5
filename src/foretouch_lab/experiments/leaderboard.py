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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.models.own import PREDICTORS as INSTALLED
from foretouch.models.own import find_predictor
from foretouch.models.registry import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.report.panels import Rows
from foretouch.types.channels import LARGEST, Channel, Channels
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch_lab.experiments.framework.manifest import cell_seconds
from foretouch_lab.experiments.shared.figures import Line, draw_intervals, save_panels
from foretouch_lab.experiments.shared.predictors import PREDICTORS
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.experiments.shared.tables import SIGNS, grouped, pivot, select, short, unique, with_notes
from foretouch_lab.learning.data import Dataset
from foretouch_lab.learning.data.folds import SPLITS
from foretouch_lab.learning.evaluation.metrics import (
    MEAN,
    BootstrapConfig,
    ObjectErrors,
    ScoreEstimate,
    compare,
    skills,
)
from foretouch_lab.learning.training.compare import FIRST_TOUCHES, Evaluation
from foretouch_lab.learning.training.run_config import load_run_config
from foretouch_lab.learning.training.scoring import score_models

_OF_OBJECTS: Final = ("object", FIRST_TOUCHES)  # which are made of the same predictions
_BASELINES: Final = (
    *("training_mean", "object_mean", "object_time_trees", "clock", "geometry_trees", "geometry_trees_pose_free"),
)


@dataclass(frozen=True, kw_only=True)
class LeaderboardSettings(Settings):
    """Settings of the leaderboard."""

    models: tuple[str, ...] = setting(
        ("contact-v3",),
        "Models beside the baselines: recipes of foretouch train, networks of the papers (p1_pointnet, p2_pointnet), "
        "module:attribute of your own predictor, or model folders, which are used as they are",
    )
    baselines: tuple[str, ...] = setting(_BASELINES, "Baselines", choices=_BASELINES)
    splits: tuple[str, ...] = setting((*SPLITS, FIRST_TOUCHES), "What is left out", choices=(*SPLITS, FIRST_TOUCHES))
    seeds: tuple[int, ...] = setting((0,), "Seeds of random parts and of predictors; errors are pooled", minimum=0)
    training_fraction: float = setting(
        1.0,
        "Fraction of trees and epochs of baselines and networks; below 1 only for quick trials",
        bounds=(0.001, 1.0),
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

    def finish(self, _settings: Any, data: Any, rows: list[Row], out: Path, _progress: Any, /) -> list[Row]:
        """Add the hash of the data, and the processor time of the cells of each row [s]: to fit and to predict all folds."""
        seconds, known = cell_seconds(out), {"data": data.sha256[:16]}
        return [{**row, **known, "cpu_s": sum(seconds.get(key, 0.0) for key in row["cells"].split())} for row in rows]


def _cells(settings: LeaderboardSettings, _data: Dataset) -> list[Cell]:
    """Return a cell for each seed, predictor and split; objects left out and first touches are of one."""
    parts: list[tuple[str, ...]] = [(split,) for split in settings.splits if split not in _OF_OBJECTS]
    if joined := tuple(split for split in settings.splits if split in _OF_OBJECTS):
        parts.append(joined)
    return [
        Cell(
            re.sub(r"[^\w.+-]", "_", f"{name}+{'-'.join(splits)}+seed{seed}"),
            {"predictor": name, "splits": list(splits), "seed": seed},
        )
        for seed in settings.seeds
        for name in (*settings.baselines, *settings.models)
        for splits in parts
    ]


def _run(cell: Cell, settings: LeaderboardSettings, data: Dataset) -> list[Row]:
    """Return the errors of each object, and the scores of each modality, of one predictor on some splits."""
    name, splits = cell.values["predictor"], cell.values["splits"]
    models, baselines, origin = {}, {}, {"hash": "", "note": "baseline"}
    if name in PREDICTORS:
        baselines = {name: PREDICTORS[name](settings.training_fraction)}
        origin["note"] = "baseline" if name in _BASELINES else "trained again for each fold and modality"
    else:
        models = {name: _model(name)}
        origin["hash"] = _hash_of(models[name])
    result = score_models(data, models, splits, seed=cell.values["seed"], baselines=baselines)
    origin["note"] = result.notes[0].partition(": ")[2] if result.notes else origin["note"]
    sensor = {"sensor": result.channels.sensor, "fingers": list(result.channels.fingers)}
    sizes = {channel.name: channel.size for channel in result.channels.channels}
    return [
        {"split": split, **origin, "key": cell.key, **sensor, "sizes": sizes, "samples": result.samples[split], **part}
        for split in splits
        for part in _parts(result, split, name)
    ]


def _parts(result: Evaluation, split: str, name: str) -> list[Row]:
    errors = result.errors[split][name]
    own = [
        {"object": object_, "count": int(errors.counts[k]), "squared": errors.squared[k].tolist()}
        | {"reference": errors.reference[k].tolist()}
        for k, object_ in enumerate(errors.objects)
    ]
    keys = ("coverage90", "interval_score")
    scores = [
        {"modality": modality, **{key: row[key] for key in keys}}
        for modality, row in result.scores[split][name].items()
    ]
    return [*own, *scores]


def _model(name: str) -> Any:
    """Return what a name stands for: a recipe, the model of a folder or card, or a predictor (`find_predictor`)."""
    if ":" in name:
        return find_predictor(name)
    try:
        load_run_config(name)
    except ConfigError as err:
        if Path(name).exists():
            return load_model(name)
        if name in INSTALLED:
            return find_predictor(name)
        rule = f"nor one of {', '.join(PREDICTORS)}, nor a model folder or module:attribute"
        raise ConfigError(f"models: {err}, {rule}") from err
    return name


def _hash_of(model: Any) -> str:
    """Return 16 digits of a hash: of the settings of a recipe, or of the weights of a model that is used as it is."""
    if isinstance(model, str):
        settings = json.dumps(load_run_config(model).to_mapping(), sort_keys=True)
        return hashlib.sha256(settings.encode()).hexdigest()[:16]
    return model.sha256[:16] if isinstance(model, TouchModel) else ""


def _tabulate(settings: LeaderboardSettings, rows: Sequence[Row]) -> list[Row]:
    """Return a row for each split, predictor and modality; a predictor that lacks a seed, because a cell failed, is left out."""
    result: list[Row] = []
    for split in settings.splits:
        own = dict(grouped(select(rows, split=split), "predictor"))
        whole = {
            name: own[name]
            for name in (*settings.baselines, *settings.models)
            if name in own and len(unique(own[name], "seed")) == len(settings.seeds)
        }
        errors = {name: _errors(of_one) for name, of_one in whole.items()}
        estimates = {name: skills(one, settings.bootstrap) for name, one in errors.items()}
        known = [name for name in settings.baselines if name in errors]
        best = max(known, key=lambda name: estimates[name][MEAN].value) if known else None
        for name, of_one in whole.items():
            versus = None if best in {None, name} else _versus(errors[name], errors[str(best)], settings.bootstrap)
            first = of_one[0]
            head = {"split": split, "predictor": name, "note": first["note"], "hash": first["hash"]}
            head |= {
                "seeds": " ".join(map(str, settings.seeds)),
                "samples": first["samples"],
                "objects": len(errors[name].objects),
            }
            head |= {"best_baseline": best, "cells": " ".join(unique(of_one, "key"))}
            rmse = errors[name].rmse()
            for modality, estimate in estimates[name].items():
                scored = [row for row in of_one if row.get("modality") == modality]
                difference = None if versus is None else versus[modality]
                result.append({
                    **head, "modality": modality, "rmse": rmse.get(modality), **interval_columns("skill", estimate),
                    **interval_columns("vs_best", difference),
                    "vs_best_verdict": None if difference is None else difference.verdict,
                    **{key: _mean(scored, key) for key in ("coverage90", "interval_score")},
                })  # fmt: skip
    return result


def _versus(errors: ObjectErrors, other: ObjectErrors, bootstrap: BootstrapConfig) -> dict[str, ScoreEstimate] | None:
    """Compare with another predictor; None if grasps that a model was trained on were left out for one of them."""
    return compare(errors, other, bootstrap) if np.array_equal(errors.counts, other.counts) else None


def _mean(rows: Sequence[Row], key: str) -> float | None:
    return sum(row[key] for row in rows) / len(rows) if rows else None


def _errors(rows: Sequence[Row]) -> ObjectErrors:
    """Return the errors of one predictor, pooled over its seeds."""
    first = rows[0]
    kinds = (Channel(name, size, "", -LARGEST, LARGEST, 0, False, 0.0, 0.0) for name, size in first["sizes"].items())
    channels = Channels(first["sensor"], "", tuple(first["fingers"]), tuple(kinds))
    return ObjectErrors.of_rows([row for row in rows if "object" in row], channels)


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
    tables = []
    for split, own in grouped(rows, "split"):
        modalities = [name for name in unique(own, "modality") if name != MEAN]
        totals = sorted(select(own, modality=MEAN), key=lambda row: -row["skill"])
        body = []
        for total in totals:
            mine = select(own, predictor=total["predictor"])
            (cells,) = pivot(mine, "predictor", _cell, [MEAN, *modalities])
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


def _cell(row: Row) -> str:
    sign = SIGNS.get(row["vs_best_verdict"] or "", "")
    text = f"{short(row['skill'])} {sign}".rstrip()
    if row["skill_low"] is None:
        return text
    return f"{text}\n[{short(row['skill_low'])}, {short(row['skill_high'])}]"


def _draw(rows: Rows, folder: Path) -> list[Path]:
    """Draw `leaderboard.png`: skill and interval of each predictor, by split and modality."""
    modalities = unique(rows, "modality")
    lines = []
    for split, own in grouped(rows, "split"):
        order = sorted(select(own, modality=MEAN), key=lambda row: -row["skill"])
        names = [row["predictor"] for row in order]
        draw = partial(draw_intervals, column="predictor", names=names, lowest=-1.0, colour=_colour)
        lines.append(Line(0.9 + 0.22 * len(names), own, draw, split, "skill"))
    width = 3.0 * len(modalities)
    return save_panels(folder / "leaderboard.png", width, lines, modalities=modalities, sharex=True, sharey="row")


def _colour(row: Mapping[str, Any]) -> str:
    return "C0" if row["predictor"] in _BASELINES else "C1"


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
    tabulate=_tabulate,
    summarise=_summarise,
    figure=_draw,
    resumable_settings=("models", "baselines", "bootstrap"),
    data_folder="vision2tactile",
)
