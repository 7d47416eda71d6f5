# SPDX-License-Identifier: Apache-2.0
"""`foretouch evaluate`: score a model and the baselines on a dataset."""

import argparse
from collections.abc import Mapping
from typing import Any, Final

from foretouch.cli.inputs import add_options, seed_number
from foretouch.cli.output import announce, print_json, print_table, warn
from foretouch.cli.parser import CommandParser
from foretouch.tactile.description import named_taxels
from foretouch_lab.learning.data import load_dataset
from foretouch_lab.learning.evaluation.evaluate import evaluate_model

_SCORED: Final = {
    "held_out": "held-out samples",
    "training_samples": "samples, of which the model was trained on some: these are training scores",
    "cross_validation": "samples by cross-validation when the model was trained",
}


def add_arguments(parser: CommandParser) -> None:
    """Declare model, dataset, and the split for the baselines."""
    parser.add_argument(
        "model",
        metavar="MODEL",
        help="name of a model, or path of its card, weights or model folder; networks are joined by commas",
    )
    add_options(parser, "--predictor")
    parser.add_argument("dataset", metavar="DATASET", help="recorded dataset, training store or vision2tactile folders")
    parser.add_argument(
        "--split",
        metavar="NAME",
        default="random",
        help="KIND or KIND/PART: samples to test, and samples to fit the baselines to (random, object, time, labels/T50)",
    )
    parser.add_argument(
        "--training-scores",
        action="store_true",
        help="score samples that the model was trained on, too; otherwise they are left out and counted",
    )
    parser.add_argument("--seed", type=seed_number, default=0, help="seed of the baselines")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 0 whatever the scores."""
    announce(f"reading {arguments.dataset}, fitting the baselines, predicting")
    data = load_dataset(arguments.dataset)
    options = {"seed": arguments.seed, "training_scores": arguments.training_scores, "predictor": arguments.predictor}
    result = evaluate_model(arguments.model, data, arguments.split, **options)
    scores = dict(result["scores"])
    facts = {name: value for name, value in result.items() if name != "scores"}
    if arguments.json:
        named = {"model": arguments.model, "dataset": arguments.dataset, "data_sha256": data.sha256}
        print_json({**named, **facts, **scores.pop("model"), "baselines": scores})
        return 0
    if result["same_data"] is None:
        warn(f"{arguments.model}: its card does not list its training samples: whether these are among them is unknown")
    elif result["excluded"]:
        warn(f"left out: {result['excluded']} samples that the model was trained on")
    if result.get("not_scored"):
        warn(f"not scored, since dead in the training data or not read: taxels {named_taxels(result['not_scored'])}")
    show_scores(result)
    return 0


def show_scores(result: Mapping[str, Any]) -> None:
    """Print a result of `evaluate_model` as a table: a row for the model and each baseline, by modality."""
    rows, columns = [], ["", "predictor", "rmse", "rmse / range", "skill", "inside"]
    for key in result["scores"]["model"]:
        for name, by_modality in result["scores"].items():
            score = by_modality[key]
            inside = "" if score["coverage90"] is None else f"{score['coverage90']:.3f}"
            numbers = (
                f"{score['rmse']:{'.1f' if score['rmse'] >= 1.0 else '.2g'}}",
                f"{score['nrmse']:.4f}",
                f"{score['skill']:+.3f}",
                inside,
            )
            rows.append([key if name == "model" else "", name, *numbers])
    unfamiliar = "" if result["unfamiliar"] is None else f"{result['unfamiliar']} flagged unfamiliar, "
    title = (
        f"{result['samples']} {_SCORED[result['scored']]}, {unfamiliar}split {result['split']}; "
        f"rmse in the unit of the sensor; skill: 0 is the mean of the split's training side, 1 is perfect, averaged over "
        "the taxels of a modality, so that a lower rmse may have a lower skill"
    )
    if any(row[-1] for row in rows):
        title += "; inside: share of readings in the 90 % interval"
    else:
        rows, columns = [row[:-1] for row in rows], columns[:-1]
    # Short heads: on 80 columns, as in a pipe, longer ones would cut the names of the baselines.
    print_table(title, columns, rows)
