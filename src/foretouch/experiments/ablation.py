# SPDX-License-Identifier: Apache-2.0
"""How much do the components of the contact model contribute, and how much a tare and touches?

On simulated objects that were never touched, with tares: predictions without adaptation, with a tare, after touches,
and with both, all scored on the same grasps. And the model without one of its components, compared with the full one:
on those objects, and on the real grasps in random folds, in blocks of time, on objects left out, and after touches of
these.

Variants of the estimator are tested before touches only, and those of the tracker after them. The released model has no
switches for this: its components are taken from its estimator, and combined here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.shared.figures import Line, draw_intervals, save_panels
from foretouch.experiments.shared.folds import split_by_fold, split_objects, touch_draws
from foretouch.experiments.shared.scores import error_rows, labelled, score_table
from foretouch.experiments.shared.simulated_data import BothSettings, RealAndSimulated, load_both, prepare_both
from foretouch.experiments.shared.tables import (
    ALL_OBJECTS,
    SIGNS,
    SKILL_COLUMNS,
    findings,
    grouped,
    pivot,
    select,
    short,
    unique,
    with_notes,
)
from foretouch.learning.data import Fold, Indices, labels_of, make_folds
from foretouch.learning.evaluation.baselines import geometry_features
from foretouch.learning.evaluation.metrics import MEAN, BootstrapConfig
from foretouch.learning.evaluation.prequential import Recording, predict_after
from foretouch.learning.training.calibration import calibrate_on_folds, resting_labels
from foretouch.learning.training.contact import (
    ContactConfig,
    ContactPredictor,
    describe_samples,
    fit_contact,
    thinned_samples,
)
from foretouch.models.calibration import Calibration
from foretouch.models.contact.estimator import TOGETHER, ContactEstimator, by_modality
from foretouch.models.contact.features import CHECKED, CONDITIONS, FEATURES, SLOPE_FEATURES
from foretouch.models.novelty import IN_DISTRIBUTION
from foretouch.models.state_space import NEW, TrackerParameters
from foretouch.report.panels import Rows
from foretouch.tactile import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

_NOTHING: Final = "nothing"
_SIMULATED: Final = "simulated"
_TITLES: Final = {
    _SIMULATED: "simulated new objects",
    "random": "real, random folds",
    "time": "real, blocks of time",
    "object": "real, new objects",
}
_COMPARED: Final = 3  # touches after which the variants are compared

FULL: Final = "full"  # the complete model, as released
BLIND: Final = "without vision"  # the mean of the training labels, with a tracker of its own


@dataclass(frozen=True, eq=False)
class _Components:
    """Predictions of the components of a contact model for S grasps."""

    joint_forest: Float64  # (S, 50) of the forest of all values [counts]
    separate_forests: Float64  # (S, 50) of the forests of the modalities [counts]
    kernel: Float64  # (S, 50) of the kernel [counts]
    in_distribution: Float64  # (S,) degree to which the objects are in the training distribution, 0...1


def _predict(estimator: ContactEstimator, rows: Float64) -> _Components:
    """Predictions for (S, F) feature rows, whose first columns are those of `CHECKED`."""
    inputs = rows[:, len(CONDITIONS) :]
    separate = np.empty((len(rows), TOUCH_SIZE))
    for name in MODALITIES:
        separate[:, columns([name])] = estimator.forests[name].predict(inputs)
    joint = estimator.forests[TOGETHER].predict(inputs)
    kernel = estimator.kernel.predict(inputs) * by_modality(estimator.generalisation_gain)
    counts = [part * estimator.deviation + estimator.mean for part in (joint, separate, kernel)]
    return _Components(counts[0], counts[1], counts[2], estimator.novelty.scores(rows))


def _gated(forests: Float64, parts: _Components) -> Float64:
    weight = parts.in_distribution[:, None]
    return weight * forests + (1.0 - weight) * parts.kernel


# By name of the variant, (S, 50) predictions before any touch [counts].
COMBINATIONS: Final[dict[str, Callable[[_Components], Float64]]] = {
    FULL: lambda p: _gated((p.joint_forest + p.separate_forests) / 2.0, p),
    "forests alone": lambda p: (p.joint_forest + p.separate_forests) / 2.0,
    "kernel alone": lambda p: p.kernel,
    "no gate, half of each": lambda p: (p.joint_forest + p.separate_forests) / 4.0 + p.kernel / 2.0,
    "joint forest only": lambda p: _gated(p.joint_forest, p),
}


def _diagonal(parameters: TrackerParameters) -> TrackerParameters:
    """The same variance of each value, without covariances."""
    squared = parameters.basis**2
    scale = squared @ parameters.noise[NEW]
    per_value = {
        name: (getattr(parameters, name) @ squared.T) / scale
        for name in ("slow", "fast", "object", "noise", "tare_noise")
    }
    share = squared / squared.sum(axis=1, keepdims=True)
    times = {name: share @ getattr(parameters, name) for name in ("slow_time_s", "fast_time_s")}
    return replace(parameters, basis=np.diag(np.sqrt(scale)), **per_value, **times)


# By name of the variant, changes of the full model's tracker, which only matter after touches.
TRACKER_EDITS: Final[dict[str, Callable[[TrackerParameters], TrackerParameters]]] = {
    "no shrinkage": lambda parameters: replace(parameters, difference_shrinkage=np.ones((2, TOUCH_SIZE))),
    "diagonal B": _diagonal,
}


def _without_slopes(samples: Sequence[GraspSample]) -> Float64:
    return describe_samples(samples)[:, [name not in SLOPE_FEATURES for name in FEATURES]]


def _geometry_only(samples: Sequence[GraspSample]) -> Float64:
    checked = describe_samples(samples)[:, : len(CHECKED)]
    return np.column_stack([checked, [geometry_features(sample) for sample in samples]])


# By name of the variant, (S, F) feature rows. The first columns are those by which novelty is detected;
# `geometry_features` are those of the baseline's trees.
FEATURE_SETS: Final[dict[str, Callable[[Sequence[GraspSample]], Float64]]] = {
    "without slopes": _without_slopes,
    "geometry_features only": _geometry_only,
}


@dataclass(frozen=True, eq=False)
class _ModelVariant:
    """A variant of the contact model with its predictions for the test samples."""

    recording: Recording  # of the test samples, with its predictions by vision
    calibration: Calibration | None  # of the full model and of edits of its tracker, if one was made

    def predict(self, index: Indices, touched: Indices, *, tare: bool) -> Float64:
        """(K, 50) predictions [counts], after touches or with tares only if it is calibrated."""
        if self.calibration is None:
            return self.recording.expected[index]
        used = self.recording if tare else replace(self.recording, tares=None)
        earlier = touched[np.argsort(used.stamps_ns[touched], kind="stable")]
        return predict_after(self.calibration, used.take(earlier), used.take(index))[0]


def fit_variants(
    train: Sequence[GraspSample], test: Sequence[GraspSample], config: ContactConfig, *, calibrated: bool
) -> dict[str, _ModelVariant]:
    """Fit all variants to labelled samples and predict others; those of `TRACKER_EDITS` only if calibrated.

    Raises:
        DatasetError: If a label is missing, or there are too few training samples.
    """
    full = ContactPredictor(train, labels_of(train), config)

    def _variant(parts: _Components, combine: Callable[[_Components], Float64]) -> _ModelVariant:
        familiar = parts.in_distribution >= IN_DISTRIBUTION
        return _ModelVariant(Recording.of_samples(test, labels_of(test), combine(parts), full.rest, familiar), None)

    parts = _predict(full.estimator, describe_samples(test))
    result = {name: _variant(parts, combine) for name, combine in COMBINATIONS.items()}
    copies, resting = thinned_samples(train, config), resting_labels(train, labels_of(train), full.rest)
    for name, describe in FEATURE_SETS.items():
        thinned = None if copies is None else describe(copies)
        estimator = fit_contact(describe(train), resting, [sample.object for sample in train], config, thinned)
        result[name] = _variant(_predict(estimator, describe(test)), COMBINATIONS[FULL])
    if calibrated:
        calibration = full.calibration[0]
        for name, edit in {FULL: lambda parameters: parameters, **TRACKER_EDITS}.items():
            tracker = edit(calibration.tracker_parameters)
            result[name] = replace(result[FULL], calibration=replace(calibration, tracker=tracker))

    def _mean(fold: Fold) -> Float64:
        return np.tile(resting[fold.train].mean(axis=0), (len(fold.test), 1))

    calibrations = calibrate_on_folds(train, labels_of(train), _mean, config.seed)[:1] if calibrated else [None]
    mean = np.tile(resting.mean(axis=0), (len(test), 1))
    result[BLIND] = _ModelVariant(Recording.of_samples(test, labels_of(test), mean, full.rest), *calibrations)
    return result


@dataclass(frozen=True, kw_only=True)
class AblationSettings(BothSettings):
    """Settings of `ablation`."""

    test_conditions: tuple[str, ...] = setting(tuple(_TITLES), "Data and splits to test on", choices=tuple(_TITLES))
    seeds: tuple[int, ...] = setting(
        (0, 1, 2), "Seeds of the random folds, of the blocks of time and of their trees", minimum=0
    )
    touches: tuple[int, ...] = setting((1, 3, 5), "Numbers of touches of a test object", minimum=1, maximum=1000)
    split_seeds: tuple[int, ...] = setting((0, 1, 2), "Seeds of the splits of the simulated objects", minimum=0)
    train_objects: int = setting(65, "Number of simulated training objects; the others are tested", minimum=2)
    draws: int = setting(10, "Number of random draws of the touched grasps", minimum=1, maximum=1000)
    contact: ContactConfig = ContactConfig()
    bootstrap: BootstrapConfig = BootstrapConfig()


def _cells(settings: AblationSettings, data: RealAndSimulated) -> list[Cell]:
    real = labelled(data.real)
    return [
        Cell(f"{one}+{part}+seed{seed}".replace(" ", "_"), {"condition": one, "part": part, "seed": seed})
        for one in settings.test_conditions
        for part, seed in _parts(one, real, settings)
    ]


def _parts(condition: str, real: Sequence[GraspSample], settings: AblationSettings) -> list[tuple[str, int]]:
    """Names of splits or folds, and seeds. Since calibration is slow, objects are left out with one seed only."""
    if condition == _SIMULATED:
        return [(str(split), settings.seeds[0]) for split in settings.split_seeds]
    seeds = settings.seeds if condition != "object" else settings.seeds[:1]
    return [(fold.name, seed) for seed in seeds for fold in make_folds(real, condition, seed)]


def _run(cell: Cell, settings: AblationSettings, data: RealAndSimulated) -> list[Row]:
    condition, part, seed = (cell.values[key] for key in ("condition", "part", "seed"))
    simulated, title = condition == _SIMULATED, _TITLES[condition]
    calibrated = simulated or condition == "object"
    if simulated:
        train, test = split_objects(labelled(data.simulated), settings.train_objects, int(part))
    else:
        real = labelled(data.real)
        train, test = split_by_fold(real, make_folds(real, condition, seed), part)
    models = fit_variants(train, test, settings.contact.replace(seed=seed), calibrated=calibrated)
    score = partial(_rows, test, labels_of(train).mean(axis=0))
    rows: list[Row] = []
    every = np.arange(len(test))
    for name, model in models.items():
        if name not in TRACKER_EDITS:  # these only matter after touches
            rows += score(f"{title}, no touch", name, model, [(every[:0], every)])
    draws = _touch_draws(test, settings) if calibrated else []
    table = f"{title}, {'tare and ' if simulated else ''}{_COMPARED} touches"
    for name, model in models.items():
        if model.calibration is not None:
            rows += score(table, name, model, draws, _COMPARED, tare=simulated)
    for tare, count in product((False, True), (0, *settings.touches)) if simulated else ():
        touches = "" if not count else f"{count} touch{'es' if count > 1 else ''}"
        name = " + ".join(filter(None, ("tare" if tare else "", touches))) or _NOTHING
        rows += score(f"{title}, with tare and touches", name, models[FULL], draws, count, tare=tare)
    return rows


def _touch_draws(test: Sequence[GraspSample], settings: AblationSettings) -> list[tuple[Indices, Indices]]:
    """For each object and draw, grasps in the order in which they are touched, and those that are scored."""
    most = max(*settings.touches, _COMPARED)
    names = np.array([sample.object for sample in test])
    members = {str(name): np.flatnonzero(names == name) for name in np.unique(names)}
    return [
        (own[order[:most]], own[order[most:]])
        for name, own in members.items()
        for order in touch_draws(name, len(own), most, settings.draws)
    ]


def _rows(
    test: Sequence[GraspSample],
    mean: Float64,
    table: str,
    name: str,
    model: _ModelVariant,
    draws: Sequence[tuple[Indices, Indices]],
    count: int = 0,
    *,
    tare: bool = False,
) -> list[Row]:
    """`error_rows` of a variant after the first `count` touches of each draw."""
    predicted = np.concatenate([model.predict(index, touched[:count], tare=tare) for touched, index in draws])
    scored = [test[k] for _, index in draws for k in index]
    errors = error_rows(scored, predicted, labels_of(scored), mean)
    return [{"table": table, "predictor": name, **row} for row in errors]


def _tabulate(settings: AblationSettings, rows: Sequence[Row]) -> list[Row]:
    """Rows without those of single objects; errors on an object that several splits tested are added up."""
    result = []
    for _, own in grouped(rows, "table"):
        variants = unique(own, "predictor")
        reference = FULL if FULL in variants else _NOTHING
        for row in select(score_table(own, variants, [reference], settings.bootstrap), object=ALL_OBJECTS):
            versus = {name: row.pop(name) for name in list(row) if name.startswith("vs_")}
            renamed = {name.replace(f"vs_{reference}", "difference"): value for name, value in versus.items()}
            result.append({**row, "reference": reference, **renamed})
    return result


def _summarise(rows: Sequence[Row]) -> list[Table]:
    """A table for each condition: skill, and its difference from the full model or from no adaptation."""
    tables, sentences = [], []
    for name, own in grouped(rows, "table"):
        title = f"{name}: {own[0]['objects']} objects, compared with `{own[0]['reference']}`"
        tables.append(Table(title, SKILL_COLUMNS, pivot(own, "predictor", _cell, names=SKILL_COLUMNS[1:])))
        means = select(own, modality=MEAN)
        texts = [f"{r['predictor']} {short(r['skill'])}{SIGNS.get(r['difference_verdict'], '')}" for r in means]
        sentences.append(f"{name}: mean skill of {', '.join(texts)}")
    notes = [
        "skill: 0 is the mean of the training labels, 1 is perfect",
        "(difference from the reference [95 % interval by bootstrap over objects])",
        "▲ significantly better, ▼ significantly worse, = no significant difference",
    ]
    return [findings(sentences), *with_notes(tables, notes)]


def _cell(row: Row) -> str:
    if row["difference"] is None:
        return f"{row['skill']:.3f}"
    sign = SIGNS.get(row["difference_verdict"], "")
    low, high = row["difference_low"], row["difference_high"]
    interval = "" if low is None else f"\n[{low:+.3f}, {high:+.3f}]"
    return f"{row['skill']:.3f} ({row['difference']:+.3f} {sign}".rstrip() + f"{interval})"


def _draw(rows: Rows, folder: Path) -> list[Path]:
    """Draw `ablation.png`: differences from the reference, tables below each other, modalities side by side."""
    lines = []
    for name, own in grouped([row for row in rows if row["predictor"] != row["reference"]], "table"):
        variants = unique(own, "predictor")
        draw = partial(
            draw_intervals, column="predictor", names=variants, values="difference", lowest=-0.3, colour=_colour
        )
        label = f"skill difference from `{own[0]['reference']}`: green better, red worse (95 % interval)"
        lines.append(Line(0.9 + 0.22 * len(variants), own, draw, name, label))
    return save_panels(folder / "ablation.png", 15.0, lines, sharex="row", sharey="row")


def _colour(row: Mapping[str, Any]) -> str:
    return {"better": "C2", "worse": "C3"}.get(row["difference_verdict"], "grey")


EXPERIMENT = Experiment(
    name="ablation",
    question="How much do the components of the contact model contribute, and how much a tare and touches?",
    module=__name__,
    order=90,
    settings=AblationSettings,
    presets={
        "full": {"split_seeds": [0, 1]},
        "quick": {"split_seeds": [0, 1], "contact.trees": 50},
        "smoke": {
            "samples": 100,
            "train_objects": 50,
            "test_conditions": ["time"],
            "seeds": [0],
            "draws": 2,
            "contact.trees": 5,
            "bootstrap.draws": 200,
        },
    },
    load=load_both,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    figure=_draw,
    prepare=prepare_both,
    resumable_settings=("test_conditions", "seeds", "split_seeds", "bootstrap"),
    data_folder="vision2tactile",
)
