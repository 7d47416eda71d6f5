# SPDX-License-Identifier: Apache-2.0
"""`foretouch evaluate`: score a model and the baselines on a dataset."""

import argparse
from collections.abc import Mapping
from typing import Any

from foretouch.cli.inputs import seed_number
from foretouch.cli.output import announce, print_json, print_table, warn
from foretouch.errors import ConfigError
from foretouch.learning.data import Dataset, load_dataset
from foretouch.learning.evaluation.evaluate import evaluate_model
from foretouch.learning.evaluation.prequential import evaluate_prequential
from foretouch.models.registry import load_model
from foretouch.tactile import MODALITIES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Model, dataset, and the split for the baselines."""
    parser.add_argument("model", metavar="MODEL", help="name of a model, or path of its card, weights or run folder")
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
    parser.add_argument("--seed", type=seed_number, default=0, help="seed of the baselines")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 whatever the scores."""
    if arguments.prequential:
        return _run_prequential(arguments)
    if arguments.history:
        raise ConfigError("--history: requires --prequential")
    announce(f"reading {arguments.dataset}, fitting the baselines, predicting")
    data = load_dataset(arguments.dataset)
    result = evaluate_model(arguments.model, data, data.parts(arguments.split), seed=arguments.seed)
    scores = dict(result["scores"])
    record = {"split": arguments.split, "samples": result["samples"], "unfamiliar": result["unfamiliar"]}
    record |= {**scores.pop("model"), "baselines": scores}
    if not _printed(arguments, data, result["same_data"], record):
        show_scores(result, arguments.split)
    return 0


def _printed(arguments: argparse.Namespace, data: Dataset, same_data: bool, record: Mapping[str, Any]) -> bool:
    """Print the record with --json; else warn of scores on training data, and return False."""
    if arguments.json:
        named = {"model": arguments.model, "dataset": arguments.dataset, "data_sha256": data.sha256}
        print_json({**named, "same_data": same_data, **record})
    elif same_data:
        warn("the model was trained on this dataset: its scores are training scores, not test scores")
    return bool(arguments.json)


def _run_prequential(arguments: argparse.Namespace) -> int:
    data, *earlier = (load_dataset(path) for path in (arguments.dataset, *arguments.history))
    samples, history = (
        [sample for one in datasets for sample in one.samples if sample.touch is not None]
        for datasets in ([data], earlier)
    )
    model = load_model(arguments.model)
    result = evaluate_prequential(model, samples, history)
    same = model.card["data"].get("sha256") in (data.sha256, *data.aliases)
    if _printed(arguments, data, same, result):
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
    print_table(title, ["touches", "predictor", *MODALITIES], rows)
    return 0


def _cell(score: Mapping[str, Any]) -> str:
    inside = "" if score["coverage90"] is None else f" ({score['coverage90']:.2f})"
    return f"{score['skill']:+.2f}{inside}"


def show_scores(result: Mapping[str, Any], split: str) -> None:
    """Print a table with a row for the model and each baseline, one modality after the other.

    Args:
        result: Result of `evaluate_model`.
        split: Split for the title.
    """
    rows = []
    for key in result["scores"]["model"]:
        for name, by_modality in result["scores"].items():
            one = by_modality[key]
            inside = "" if one["coverage90"] is None else f"{one['coverage90']:.3f}"
            numbers = (f"{one['rmse']:.1f}", f"{one['nrmse']:.4f}", f"{one['skill']:+.3f}", inside)
            rows.append([key if name == "model" else "", name, *numbers])
    title = (
        f"{result['samples']} samples ({result['unfamiliar']} flagged unfamiliar), split {split}; "
        "rmse in counts; skill: 0 is the training mean, 1 is perfect; inside: share of readings in the 90 % interval"
    )
    # Short heads: on 80 columns, as in a pipe, longer ones would cut the names of the baselines.
    print_table(title, ["", "predictor", "rmse", "rmse / range", "skill", "inside"], rows)
