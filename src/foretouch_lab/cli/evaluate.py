# SPDX-License-Identifier: Apache-2.0
"""`foretouch evaluate`: score a model and the baselines on a dataset."""

import argparse
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from foretouch.cli.inputs import seed_number
from foretouch.cli.output import announce, print_json, print_table, warn
from foretouch.errors import ConfigError, DatasetError
from foretouch.models.registry import load_model
from foretouch.tactile.description import named_taxels, require_same
from foretouch_lab.learning.data import Dataset, load_dataset
from foretouch_lab.learning.evaluation.evaluate import evaluate_model, own_samples
from foretouch_lab.learning.evaluation.prequential import evaluate_prequential

_SCORED: Final = {
    "held_out": "held-out samples",
    "training_samples": "samples, of which the model was trained on some: these are training scores",
    "cross_validation": "samples by cross-validation when the model was trained",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Model, dataset, and the split for the baselines."""
    parser.add_argument("model", metavar="MODEL", help="name of a model, or path of its card, weights or model folder")
    parser.add_argument("dataset", metavar="DATASET", help="recorded dataset, training store or vision2tactile folders")
    parser.add_argument(
        "--split",
        metavar="NAME",
        default="random",
        help="KIND or KIND/PART: samples to test, and samples to fit the baselines to (random, object, time, labels/T50)",
    )
    parser.add_argument(
        "--prequential",
        action="store_true",
        help="predict the grasps in order of time, each from the cloud and all earlier readings of any object, as a robot at work does",
    )
    parser.add_argument(
        "--history",
        action="append",
        default=[],
        metavar="DATASET",
        help="with --prequential: further readings of the same sensors, which are not scored",
    )
    parser.add_argument(
        "--training-scores",
        action="store_true",
        help="score samples that the model was trained on, too; otherwise they are left out and counted",
    )
    parser.add_argument("--seed", type=seed_number, default=0, help="seed of the baselines")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 whatever the scores."""
    if arguments.prequential:
        return _run_prequential(arguments)
    if arguments.history:
        raise ConfigError("--history: requires --prequential")
    announce(f"reading {arguments.dataset}, fitting the baselines, predicting")
    data = load_dataset(arguments.dataset)
    options = {"seed": arguments.seed, "training_scores": arguments.training_scores}
    result = evaluate_model(arguments.model, data, arguments.split, **options)
    scores = dict(result["scores"])
    facts = {name: value for name, value in result.items() if name != "scores"}
    if not _printed(arguments, data, {**facts, **scores.pop("model"), "baselines": scores}):
        show_scores(result)
    return 0


def _printed(arguments: argparse.Namespace, data: Dataset, record: Mapping[str, Any]) -> bool:
    """Print the record with --json; else warn of samples that the model was trained on, and return False."""
    if arguments.json:
        named = {"model": arguments.model, "dataset": arguments.dataset, "data_sha256": data.sha256}
        print_json({**named, **record})
    elif record["same_data"] is None:
        warn(f"{arguments.model}: its card does not list its training samples: whether these are among them is unknown")
    elif record["excluded"]:
        warn(f"left out: {record['excluded']} samples that the model was trained on")
    if not arguments.json and record.get("not_scored"):
        warn(f"not scored, since dead in the training data or not read: taxels {named_taxels(record['not_scored'])}")
    return bool(arguments.json)


def _run_prequential(arguments: argparse.Namespace) -> int:
    data, *earlier = (load_dataset(path) for path in (arguments.dataset, *arguments.history))
    model = load_model(arguments.model)
    index = np.array([k for k, sample in enumerate(data.samples) if sample.touch is not None], np.intp)
    channels = model.sensor.channels
    for one in (data, *earlier):
        require_same(one.sensor.channels, channels, one.name)
    own = own_samples(model.card, data, index)
    excluded = np.full(len(index), False) if own is None or arguments.training_scores else own
    if excluded.all():
        raise DatasetError(
            f"{arguments.model}: was trained on all samples of {data.name}, so that none is held out; --training-scores scores them"
        )
    samples = [data.masked[k] for k in index[~excluded]]
    history = [sample for one in earlier for sample in one.masked if sample.touch is not None]
    history += [data.masked[k] for k in index[excluded]]
    facts = {"same_data": None if own is None else bool(own.any()), "excluded": int(excluded.sum())}
    result = facts | evaluate_prequential(model, samples, history)
    if _printed(arguments, data, result):
        return 0
    for name, fingers in result["restarted"].items():
        warn(f"{name}: readings jumped, the memory of {' and '.join(fingers)} was started again")
    rows = [
        [f"{label} ({part['grasps']})" if method == "tracker" else "", method, *map(_cell, scores.values())]
        for label, part in result["touches"].items()
        for method, scores in part["scores"].items()
    ]
    title = (
        f"{result['samples']} grasps in order of time after {result['history']} of the history; by touches of the object before "
        "(grasps); skill: 0 is the mean of the other objects, 1 is perfect; in brackets: share of readings in the 90 % interval"
    )
    print_table(title, ["touches", "predictor", *channels.modalities], rows)
    return 0


def _cell(score: Mapping[str, Any]) -> str:
    inside = "" if score["coverage90"] is None else f" ({score['coverage90']:.2f})"
    return f"{score['skill']:+.2f}{inside}"


def show_scores(result: Mapping[str, Any]) -> None:
    """Print a result of `evaluate_model` as a table: a row for the model and each baseline, by modality."""
    own = result["fitted_to_training"]
    mean = "training mean" if own else "mean of this dataset without the fold, which the model does not know"
    rows = []
    for key in result["scores"]["model"]:
        for name, by_modality in result["scores"].items():
            one = by_modality[key]
            inside = "" if one["coverage90"] is None else f"{one['coverage90']:.3f}"
            numbers = (
                f"{one['rmse']:{'.1f' if one['rmse'] >= 1.0 else '.2g'}}",
                f"{one['nrmse']:.4f}",
                f"{one['skill']:+.3f}",
                inside,
            )
            shown = name if own or name != "training_mean" else "dataset_mean"
            rows.append([key if name == "model" else "", shown, *numbers])
    unfamiliar = "" if result["unfamiliar"] is None else f"{result['unfamiliar']} flagged unfamiliar, "
    title = (
        f"{result['samples']} {_SCORED[result['scored']]}, {unfamiliar}split {result['split']}; "
        f"rmse in the unit of the sensor; skill: 0 is the {mean}, 1 is perfect; inside: share of readings in the 90 % interval"
    )
    # Short heads: on 80 columns, as in a pipe, longer ones would cut the names of the baselines.
    print_table(title, ["", "predictor", "rmse", "rmse / range", "skill", "inside"], rows)
