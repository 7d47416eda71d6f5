# SPDX-License-Identifier: Apache-2.0
"""Train a model that is shipped: `python -m foretouch.learning.training.release CONFIG --data FOLDER -o DIR`.

Evaluates the model and the baselines on three splits, calibrates it on what was held out, trains once more on all samples,
and writes the weights, the calibration and the card, which tells all of that. One JSON object a line on standard output; exit status 1
and one line on standard error at a known failure.

The training data are recordings of others (P1's collection), read where they lie and not redistributed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foretouch import __version__
from foretouch.config import Settings, load_yaml, parse_overrides, setting
from foretouch.dataset.vision2tactile import folder_sha256, read_folder
from foretouch.errors import ForetouchError
from foretouch.learning.data.folds import SPLITS, make_folds
from foretouch.learning.data.training_set import duplicate_labels, labels_of
from foretouch.learning.evaluation.cross_validation import MODEL, Evaluation, evaluate
from foretouch.learning.evaluation.metrics import Score, mean_skill
from foretouch.learning.training.calibration import HeldOutPredictions, make_calibration, promise
from foretouch.learning.training.contact import ContactConfig, rest_level
from foretouch.learning.training.learners import ContactLearner, Learner, NetworkLearner
from foretouch.learning.training.supervised import TrainConfig
from foretouch.models.calibration import add_calibration
from foretouch.models.network.config import ModelConfig
from foretouch.tactile import MODALITIES
from foretouch.types import Float64, GraspSample

__all__ = ["ShipConfig", "main", "ship"]

Say = Callable[[Mapping[str, Any]], None]

_SPLIT_WORDS = {
    "random": "5 random folds: other grasps of the same sessions",
    "time": "5 consecutive blocks of time within each object, each left out once",
    "object": "one object left out: objects never touched, and other days",
}


@dataclass(frozen=True, kw_only=True)
class ShipConfig(Settings):
    """A model to train and to ship."""

    name: str = setting("touchnet", "Name of the model and of its files")
    method: str = setting("supervised", "A network, or a contact model", choices=("supervised", "contact"))
    contact: ContactConfig = ContactConfig()
    model: ModelConfig = ModelConfig()
    train: TrainConfig = TrainConfig()


def ship(config: ShipConfig, data_folder: Path, out: Path, say: Say, *, workers: int = 1) -> Path:
    """Evaluate, calibrate, train on everything, write weights, calibration and card.

    Args:
        config: Model and training.
        data_folder: The recordings.
        out: Where the files go.
        say: Called with each result.
        workers: Processes for the cross-validation.

    Returns:
        Path of the card.

    Raises:
        ForetouchError: If the data or the configuration cannot be used.
    """
    samples = read_folder(data_folder)
    labels = labels_of(samples)
    learner = _learner(config, samples, labels)
    skill: dict[str, Any] = {}
    baselines: dict[str, Any] = {}
    predicted: dict[str, Float64] = {}
    for split in SPLITS:
        found = _evaluate(samples, labels, learner, config, split, say, workers)
        predicted[split] = found.predicted
        for who, scores in found.scores.items():
            place = skill if who == MODEL else baselines.setdefault(who, {})
            place[split] = {name: _rounded(one) for name, one in scores.items()}
    rest, recorded = rest_level(samples)
    trust, calibration = make_calibration(rest, _held_out(samples, labels, predicted))
    facts = {
        "summary": f"{', '.join(MODALITIES)} from {len(samples)} real grasps; read skill and limits first",
        "data": _describe_data(samples, data_folder),
        "split": {split: _SPLIT_WORDS[split] for split in SPLITS} | {"shipped": "trained on all samples"},
        "skill": skill,
        "baselines": baselines,
        "limits": _limits(skill, baselines, calibration, rest_recorded=recorded),
        "version": __version__,
    }
    card, fallback = learner.finish(out, config.name, facts, say)
    add_calibration(
        card, trust, {**calibration, "rest": "recorded tares" if recorded else "guessed from the labels"}, fallback
    )
    return card


def _learner(config: ShipConfig, samples: Sequence[GraspSample], labels: Float64) -> Learner:
    if config.method == "supervised":
        return NetworkLearner.build(samples, config.model, config.train)
    return ContactLearner.build(samples, labels, config.contact)


def _held_out(
    samples: Sequence[GraspSample], labels: Float64, predicted: Mapping[str, Float64]
) -> dict[str, HeldOutPredictions]:
    """What the calibration is made of: later stretches of known objects, and objects left out."""
    objects = np.array([sample.object for sample in samples])
    stretches = objects.astype(object)
    for fold in make_folds(samples, "time", 0):
        stretches[fold.test] = [f"{name}/{fold.name}" for name in objects[fold.test]]
    return {
        "known": HeldOutPredictions(predicted["time"], labels, objects, stretches.astype(np.str_)),
        "new": HeldOutPredictions(predicted["object"], labels, objects, objects),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m foretouch.learning.training.release", description="Train the shipped model."
    )
    parser.add_argument("config", type=Path, help="YAML, such as config/train/contact-v1.yaml")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="settings that differ from the file")
    parser.add_argument("--data", type=Path, required=True, help="folder of the vision2tactile recordings")
    parser.add_argument("-o", "--out", type=Path, help="folder for weights and card")
    parser.add_argument("--workers", type=int, default=1, help="processes for the cross-validation")
    parser.add_argument(
        "--compare", nargs="+", choices=SPLITS, metavar="SPLIT", help="evaluate on these splits, ship nothing"
    )
    given = parser.parse_intermixed_args(arguments)
    if given.out is None and not given.compare:
        parser.error("-o is needed, unless --compare")
    try:
        _run(given)
    except ForetouchError as err:
        sys.stderr.write(f"{err}\n")
        return 1
    return 0


def _run(given: argparse.Namespace) -> None:
    mapping = load_yaml(given.config) | parse_overrides(given.overrides)
    config = ShipConfig.from_mapping(mapping, str(given.config))
    if not given.compare:
        card = ship(config, given.data, given.out, _say, workers=given.workers)
        _say({"card": str(card)})
        return
    samples = read_folder(given.data)
    labels = labels_of(samples)
    learner = _learner(config, samples, labels)
    for split in given.compare:
        _evaluate(samples, labels, learner, config, split, _say, given.workers)


def _evaluate(
    samples: Sequence[GraspSample],
    labels: Float64,
    learner: Learner,
    config: ShipConfig,
    split: str,
    say: Say,
    workers: int,
) -> Evaluation:
    start = time.monotonic()
    seed = config.train.seed if config.method == "supervised" else config.contact.seed
    folds = make_folds(samples, split, seed)
    result = evaluate(samples, labels, learner, folds, learner.ranges, seed=seed, workers=workers)
    for who, scores in result.scores.items():
        say(
            {
                "split": split,
                "who": who,
                "mean_skill": round(mean_skill(scores), 3),
                "skill": {name: round(one.skill, 3) for name, one in scores.items()},
            }
        )
    say({"split": split, "seconds": round(time.monotonic() - start, 1)})
    return result


def _describe_data(samples: Sequence[GraspSample], folder: Path) -> dict[str, Any]:
    names = sorted({sample.object for sample in samples})
    return {
        "name": "vision2tactile",
        "source": "github.com/yayaneath/vision2tactile, recorded for P1",
        "licence": "none stated, so the data are not redistributed",
        "sha256": folder_sha256(folder),
        "samples": len(samples),
        "objects": {name: sum(sample.object == name for sample in samples) for name in names},
        "duplicate_labels": [list(pair) for pair in duplicate_labels(samples)],
    }


def _limits(
    skill: Mapping[str, Any], baselines: Mapping[str, Any], calibration: Mapping[str, Any], *, rest_recorded: bool
) -> list[str]:
    """What to know before relying on it; comparisons and coverage are read off the results."""
    limits = [
        "One pair of fingers, one hand, one camera at 1.1 to 1.3 m seen from above: other fingers have other ranges.",
        "Recorded without a tare, each object on days of its own: object, day and drift cannot be told apart.",
    ]
    if not rest_recorded:
        limits.append("The rest level that a tare is compared with is guessed from the labels: no tare was recorded.")
    limits.append(promise(calibration))
    limits.append("Skills are averages; whether one is above another by more than chance is told in docs/results.")
    for split in SPLITS:
        ours = _mean(skill[split])
        best, value = max(((name, _mean(table[split])) for name, table in baselines.items()), key=lambda pair: pair[1])
        limits.append(f"Split {split}: mean skill {ours:.2f}; that of the best baseline, {best}, is {value:.2f}.")
        if ours <= 0.0:
            limits.append(f"Split {split}: no better than the training mean; do not trust it there.")
    return limits


def _mean(table: Mapping[str, Mapping[str, float]]) -> float:
    return float(np.mean([row["skill"] for row in table.values()]))


def _rounded(one: Score) -> dict[str, float]:
    return {"rmse": round(one.rmse, 2), "nrmse": round(one.nrmse, 4), "skill": round(one.skill, 4)}


def _say(record: Mapping[str, Any]) -> None:
    sys.stdout.write(json.dumps(record) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
