# SPDX-License-Identifier: Apache-2.0
"""Fit each predictor to some grasps and test it on others: one experiment, and a preset of it for each way to split.

    cross_validation   P1's five random folds over all objects: neighbours in time are in training and in test
    time_blocked       five consecutive blocks of time within each object
    cross_type         folds within cylinders and within boxes, and one type against the other
    unseen_object      each object left out once, without a touch and after some touches of it
    lookalikes         simulated objects of one shape that differ in stiffness
    sim_to_real        as unseen_object, with predictors that use simulated grasps too
    learning_curve     some grasps of each object, or some objects, for training

`splits` defines them, `results` their tables and figures. A fit is tested on all grasps that are held out; after k
touches on all that were not touched, in random draws of the touched ones. The reference of the skill is the mean of
the training labels also after touches, so that the skill shows their effect.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from foretouch.types import Float64, GraspSample
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.experiments.hold_out import results, splits
from foretouch_lab.experiments.hold_out.splits import HoldOutSettings, Splitter, TouchSettings
from foretouch_lab.experiments.hold_out.transfer import TRANSFER_METHODS, fit_transfer
from foretouch_lab.experiments.shared.folds import touch_draws
from foretouch_lab.experiments.shared.predictors import NETWORKS, PREDICTORS, Fitted, find_predictor
from foretouch_lab.experiments.shared.scores import error_rows, load, score_table
from foretouch_lab.experiments.shared.simulated_data import load_both, load_simulated, prepare_both, prepare_simulated
from foretouch_lab.experiments.shared.tables import skill_tables
from foretouch_lab.learning.data import labels_of

# Settings that no cell depends on; its predictor and seed are among its values.
RESUMABLE: Final = ("predictors", "seeds", "network_seeds", "references", "bootstrap")


def _cells(split: Splitter, settings: HoldOutSettings, data: Any) -> list[Cell]:
    """A cell for each seed, predictor and part; the slow networks run with the first seeds only."""
    return [
        Cell(
            "+".join(filter(None, (name, chosen.table, chosen.part, f"seed{seed}"))).replace(" ", "_").replace(",", ""),
            {"table": chosen.table, "part": chosen.part, "predictor": name, "seed": seed, **chosen.columns},
        )
        for number, seed in enumerate(settings.seeds)
        for name in settings.predictors
        if name not in NETWORKS or number < settings.network_seeds
        for chosen in split(settings, data, seed)
    ]


def _run(split: Splitter, cell: Cell, settings: HoldOutSettings, data: Any) -> list[Row]:
    """Fit and test once."""
    name, seed = cell.values["predictor"], cell.values["seed"]
    place = cell.values["table"], cell.values["part"]
    chosen = next(one for one in split(settings, data, seed) if (one.table, one.part) == place)
    scale = settings.training_fraction
    fit = fit_transfer(name, data, scale) if name in TRANSFER_METHODS else find_predictor(name, scale)
    fitted = fit(chosen.train, labels_of(chosen.train), seed)
    mean = labels_of(chosen.train).mean(axis=0) if chosen.mean is None else chosen.mean
    rows = []
    for samples in chosen.tested:
        everything = fitted.predict(samples)  # all at once: some baselines are fitted in each call
        if not isinstance(settings, TouchSettings) or chosen.table:
            rows += error_rows(samples, everything, labels_of(samples), mean)
            continue
        for count in settings.touches:
            parts = list(_predict_draws(fitted, samples, count, settings)) if count else [(samples, everything)]
            scored = [sample for part, _ in parts for sample in part]
            errors = error_rows(scored, np.concatenate([found for _, found in parts]), labels_of(scored), mean)
            rows += [{"table": _table(count), "touches": count, **row} for row in errors]
    return rows


def _predict_draws(
    fitted: Fitted, samples: Sequence[GraspSample], count: int, settings: TouchSettings
) -> Iterator[tuple[list[GraspSample], Float64]]:
    """For each draw, the scored grasps and their predictions after touches of the others."""
    for order in touch_draws(samples[0].object, len(samples), max(settings.touches), settings.draws):
        touched, rest = ([samples[k] for k in side] for side in (order[:count], np.sort(order[count:])))
        yield rest, fitted.predict_after(touched, rest)


def _table(count: int) -> str:
    """Name of the table after a number of touches."""
    return "no touch" if count == 0 else f"after {count} touch" + ("es" if count > 1 else "")


def _tabulate(columns: Sequence[str], settings: HoldOutSettings, rows: Sequence[Row]) -> list[Row]:
    return score_table(rows, settings.predictors, settings.references, settings.bootstrap, columns)


def _experiment(
    name: str,
    question: str,
    order: int,
    split: Splitter,
    presets: Mapping[str, Mapping[str, Any]],
    *,
    settings: type[HoldOutSettings] = HoldOutSettings,
    base: Mapping[str, Any] | None = None,
    columns: Sequence[str] = (),
    resumable: Sequence[str] = (),
    data_folder: str | None = "vision2tactile",
    **others: Any,
) -> Experiment:
    """One way to split; `base` are settings of every preset, `resumable` further settings that no cell depends on."""
    how = {"load": load, "summarise": skill_tables}
    return Experiment(
        name=name,
        question=question,
        module=__name__,
        order=order,
        settings=settings,
        presets={preset: {**(base or {}), **changes} for preset, changes in presets.items()},
        cells=partial(_cells, split),
        run=partial(_run, split),
        resumable_settings=(*RESUMABLE, *resumable),
        data_folder=data_folder,
        **{**how, "tabulate": partial(_tabulate, columns), **others},
    )


_PRESETS: Final[dict[str, dict[str, Any]]] = {
    "full": {"predictors": list(PREDICTORS)},  # hours
    "quick": {},  # all but the networks: minutes
    "smoke": {"seeds": [0], "training_fraction": 0.1},
}
_KNOWN_OBJECTS_ONLY: Final = ("object_mean", "object_time_trees")  # predictors that cannot predict a new object

_NEW_OBJECT: Final = [name for name in PREDICTORS if name not in _KNOWN_OBJECTS_ONLY]
_TOUCHED: Final = {"seeds": [0], "references": ["training_mean", "geometry_trees"]}
_FEW: Final = {"training_fraction": 0.1, "draws": 3, "bootstrap.draws": 200}

EXPERIMENTS: Final = (
    _experiment(
        "cross_validation",
        "How accurate are predictions for other grasps of the same sessions?",
        10,
        splits.folds("random"),
        _PRESETS,
    ),
    _experiment(
        "time_blocked",
        "How accurate are predictions for earlier or later grasps of the same objects?",
        20,
        splits.folds("time"),
        _PRESETS,
    ),
    _experiment(
        "cross_type",
        "How do the errors within one object type and across types compare with those published in P1?",
        30,
        splits.types,
        _PRESETS,
        settings=splits.CrossTypeSettings,
        tabulate=results.tabulate_types,
        summarise=results.summarise_types,
    ),
    _experiment(
        "unseen_object",
        "How accurate are predictions on an object that was never touched, and after a few touches of it?",
        40,
        splits.objects,
        {"full": {"predictors": _NEW_OBJECT}, "quick": {}, "smoke": {"training_fraction": 0.1, "draws": 5}},
        settings=splits.TouchSettings,
        base={
            **_TOUCHED,
            "touches": [0, 1, 3, 5, 10],
            "predictors": [one for one in _NEW_OBJECT if one not in NETWORKS],
        },
        columns=("touches",),
        summarise=results.summarise_touches,
        figure=results.draw_touches,
    ),
    _experiment(
        "lookalikes",
        "What can be predicted of objects that differ only in stiffness, and how much do touches add?",
        60,
        splits.sessions,
        {"full": {}, "smoke": {**_FEW, "samples": 80, "grasps_per_session": 10}},
        settings=splits.LookalikesSettings,
        base={**_TOUCHED, "samples": 1200, "predictors": ["training_mean", "geometry_trees", "contact"]},
        tabulate=results.tabulate_lookalikes,
        summarise=results.summarise_lookalikes,
        load=load_simulated,
        prepare=prepare_simulated,
        data_folder=None,
    ),
    _experiment(
        "sim_to_real",
        "Does training on simulated grasps improve predictions on real objects that were never touched?",
        70,
        splits.objects,
        {"full": {}, "smoke": {**_FEW, "samples": 100}},
        settings=splits.SimToRealSettings,
        base={**_TOUCHED, "scene": "config/scenes/rigid.yaml", "samples": 2000},
        columns=("touches",),
        summarise=results.summarise_touches,
        figure=results.draw_touches,
        load=load_both,
        prepare=prepare_both,
    ),
    _experiment(
        "learning_curve",
        "Do more grasps per object, or more objects, improve predictions?",
        100,
        splits.sizes,
        {
            "full": {},
            "quick": {"training_fraction": 0.34},
            "smoke": {
                "samples": 300,
                "seeds": [0],
                "grasps": [10],
                "objects": [7],
                "simulated_objects": [20],
                "training_fraction": 0.05,
                "bootstrap.draws": 200,
            },
        },
        settings=splits.LearningCurveSettings,
        base={"seeds": [0, 1, 2], "predictors": ["object_mean", "geometry_trees", "contact"]},
        columns=("condition", "size"),
        resumable=("test_conditions", "grasps", "objects"),
        summarise=results.summarise_sizes,
        load=load_both,
        prepare=prepare_both,
    ),
)
