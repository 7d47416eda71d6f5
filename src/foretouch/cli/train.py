# SPDX-License-Identifier: Apache-2.0
"""`foretouch train`: a model from a configuration, resumable at every epoch.

Several processes share each batch out, with the gradients of one, when `torchrun` starts the command::

    torchrun --nproc-per-node 2 -m foretouch.cli.main train CONFIG -o RUN
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.cli.evaluate import show_scores
from foretouch.cli.output import print_json
from foretouch.config import load_yaml, parse_overrides
from foretouch.errors import ConfigError

if TYPE_CHECKING:
    from foretouch.learning.training.run_config import RunConfig

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The configuration, what differs from it, and where to."""
    parser.add_argument("config", metavar="CONFIG", help="YAML, such as config/train/p2_srgan.yaml")
    parser.add_argument(
        "overrides", metavar="key=value", nargs="*", help="settings that differ, such as data=PATH or train.epochs=5"
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="RUN", help="folder of the run")
    parser.add_argument("--resume", action="store_true", help="go on with the run that stands there, if any")
    parser.add_argument("--json", action="store_true", help="one JSON object an epoch, and the result")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 with a model on disk; what stops a training is an error, and the last good state stays."""
    config = _config(arguments)  # before the samples are read, for it is faster to be found wrong
    if config.data is None:
        raise ConfigError(f"{arguments.config}: data: is empty; give data=PATH")
    from foretouch.learning.training.device import process_group

    with process_group(config.device) as ranks:
        return _train(arguments, config, config.data, quiet=ranks.own > 0)


def _train(arguments: argparse.Namespace, config: RunConfig, source: str, *, quiet: bool) -> int:
    from foretouch.learning.data.collection import load_collection
    from foretouch.learning.training.run import train_run

    data = load_collection(source)
    if arguments.json or quiet:
        train_run(config, data, arguments.out, print_now, resume=arguments.resume)
        return 0
    with _progress() as (say, last):
        card = train_run(config, data, arguments.out, say, resume=arguments.resume)
    epochs = f"{last['epochs']} epochs" if last["epochs"] else "fitted"
    print(f"{card}: {epochs} on {data.name}, sha256 {data.sha256[:12]}")
    if "scores" in last:
        show_scores(last, str(config.split))
    return 0


def print_now(record: Mapping[str, Any]) -> None:
    """One line, at once, for whoever follows a training through a pipe."""
    print_json(record)
    print(end="", flush=True)


def _config(arguments: argparse.Namespace) -> RunConfig:
    mapping = load_yaml(arguments.config) | parse_overrides(arguments.overrides)
    from foretouch.learning.training.run_config import RunConfig

    return RunConfig.from_mapping(mapping, arguments.config)


@contextmanager
def _progress() -> Iterator[tuple[Callable[[Mapping[str, Any]], None], dict[str, Any]]]:
    """A bar with losses and the time left, on stderr; beside it what was said last."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    last: dict[str, Any] = {}
    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    bar = Progress(*columns, console=Console(stderr=True))
    task = bar.add_task("epoch", total=None)

    def say(record: Mapping[str, Any]) -> None:
        last.clear()
        last.update(record)
        if "losses" in record:
            bar.start()  # not before: a contact model has no epochs, and an error stands alone
            bar.update(task, total=record["epochs"], completed=record["epoch"] + 1, description=_words(record))

    try:
        yield say, last
    finally:
        if bar.live.is_started:
            bar.stop()


def _words(record: Mapping[str, Any]) -> str:
    numbers = dict(record["losses"]) | ({"validation": record["validation"]} if "validation" in record else {})
    return json.dumps({name: float(f"{value:.4g}") for name, value in numbers.items()})[1:-1].replace('"', "")
