# SPDX-License-Identifier: Apache-2.0
"""`foretouch train`: a model from a configuration and a dataset, resumable at every epoch."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.cli.inputs import positive_number
from foretouch.cli.output import print_json, print_table, progress_bar, warn
from foretouch.cli.parser import CommandParser
from foretouch.errors import ConfigError
from foretouch.tactile.description import named_taxels
from foretouch_lab.cli.evaluate import show_scores

if TYPE_CHECKING:
    from foretouch_lab.learning.data import Dataset
    from foretouch_lab.learning.training.run_config import RunConfig


def add_arguments(parser: CommandParser) -> None:
    """Declare configuration, overrides, and where the run is written."""
    parser.add_argument(
        "config",
        metavar="CONFIG",
        help="YAML file, such as config/train/p2_srgan.yaml, or the name of a recipe of the package, such as contact-v3",
    )
    parser.add_argument(
        "overrides",
        metavar="key=value",
        nargs="*",
        default=[],
        help="settings that differ from CONFIG: data=DATASET, train.epochs=5, calibrate=true (intervals for a network), "
        "release=true (scores on three splits in the card)",
    )
    target = parser.headings["what is written"].add_mutually_exclusive_group(required=True)
    parser.add_argument("-o", "--out", group=target, type=Path, metavar="MODEL", help="model folder to create")
    parser.add_argument(
        "--compare",
        group=target,
        metavar="SPLITS",
        help="write no model: score the method and the baselines on splits such as random,time,object",
    )
    parser.add_argument("--resume", action="store_true", help="continue the training in MODEL, if there is one")
    parser.add_argument(
        "--workers", type=positive_number, default=1, metavar="N", help="processes for cross-validation and intervals"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 0 with a model on disk. An error stops the training, and the last good state stays."""
    from foretouch_lab.learning.training.run_config import load_run_config

    config = load_run_config(arguments.config, arguments.overrides)  # before the samples: errors appear at once
    if config.data is None:
        raise ConfigError(f"{arguments.config}: data: is empty; give data=PATH")
    from foretouch_lab.learning.data import load_dataset

    if arguments.compare:
        return _compare(arguments, config.replace(release=True), load_dataset(config.data))
    return _train(arguments, config, load_dataset(config.data))


def _train(arguments: argparse.Namespace, config: RunConfig, data: Dataset) -> int:
    from foretouch_lab.learning.training.run import train_run

    options = {"resume": arguments.resume, "workers": arguments.workers}
    if arguments.json:
        train_run(config, data, arguments.out, print_json, **options)
        return 0
    records: list[Mapping[str, Any]] = []
    with progress_bar("training") as update:
        card = train_run(config, data, arguments.out, partial(_report, update, records), **options)
    last = records[-1]
    epochs = f"{last['epochs']} epochs" if last["epochs"] else "fitted"
    print(f"{card}: {epochs} on {data.name}, sha256 {data.sha256[:12]}")
    if last["dead_taxels"]:
        warn(f"dead, so that their predictions are not valid: taxels {named_taxels(last['dead_taxels'])}")
    if not last["calibrated"]:
        warn(f"the model gives no intervals and does not adapt to readings: {last['limits'][0]}")
    if "scores" in last:
        show_scores(last)
    return 0


def _compare(arguments: argparse.Namespace, config: RunConfig, data: Dataset) -> int:
    from foretouch_lab.learning.training.compare import compare_splits
    from foretouch_lab.learning.training.learners import make_learner

    records: list[Mapping[str, Any]] = []
    report = print_json if arguments.json else records.append
    compare_splits(make_learner(config, data), arguments.compare.split(","), report, arguments.workers)
    if records:
        modalities = list(records[0]["skill"])
        rows = [
            [
                record["split"],
                record["who"],
                *(f"{skill:+.3f}" for skill in (record["mean_skill"], *map(record["skill"].get, modalities))),
            ]
            for record in records
        ]
        title = f"skill on {data.name} by cross-validation: 0 is the training mean, 1 is perfect"
        print_table(title, ["split", "predictor", "mean", *modalities], rows)
    return 0


def _report(update: Callable[..., None], records: list[Mapping[str, Any]], record: Mapping[str, Any]) -> None:
    """Keep the last record, and show the losses of an epoch; a contact model has none."""
    records[:] = [record]
    if "losses" in record:
        text = ", ".join(f"{name}: {value:.4g}" for name, value in record["losses"].items())
        update(record["epoch"] + 1, record["epochs"], text)
