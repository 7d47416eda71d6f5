# SPDX-License-Identifier: Apache-2.0
"""`foretouch benchmark touch`: the leaderboard of touch models, your own among them."""

import argparse
import json

from foretouch.cli.parser import CommandParser
from foretouch.errors import ConfigError, none_of
from foretouch_lab.cli.experiment import add_sweep_arguments, run_experiment
from foretouch_lab.experiments.framework.manifest import MANIFEST_FILE, read_settings
from foretouch_lab.experiments.leaderboard import EXPERIMENT

_SUBJECTS = ("touch",)


def add_arguments(parser: CommandParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("subject", metavar="SUBJECT", help="what is scored: touch, the models that predict it")
    parser.add_argument(
        "--model",
        action="append",
        metavar="NAME",
        help="a recipe of `train`, also with settings such as 'p2 model.outputs=each'; module:attribute of your own predictor; or a "
        "model folder, which is used as it is; repeated for several (default: contact-v3); with --resume, added to those in DIR. "
        "Baselines are always scored",
    )
    add_sweep_arguments(parser, "full", "full (default): all splits; smoke: the baselines, a quick trial")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a row could not be scored."""
    if arguments.subject not in _SUBJECTS:
        raise ConfigError(f"benchmark: {none_of(arguments.subject, _SUBJECTS)}")
    before: list[str] = []
    if arguments.resume and arguments.out is not None and (arguments.out / MANIFEST_FILE).exists():
        before = read_settings(arguments.out).get("models", [])
    if models := list(dict.fromkeys([*before, *(arguments.model or [])])):
        arguments.overrides = [f"models={json.dumps(models)}", *arguments.overrides]
    return run_experiment(EXPERIMENT, arguments)
