# SPDX-License-Identifier: Apache-2.0
"""`foretouch COMMAND`: finds the command's module, and turns known errors into one line and exit status 1.

A command is a module `foretouch.cli.<name>` with `add_arguments(parser)` and `run(arguments) -> int`.
Heavy libraries are imported inside `run`, so that `--help` answers at once.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from foretouch import __version__
from foretouch.errors import ForetouchError

__all__ = ["COMMANDS", "main"]

COMMANDS = {
    "segment": "Find the table and the objects of a cloud",
    "grasp": "Find where a hand can hold an object (GeoGrasp)",
    "predict": "Predict what the fingertips would read",
    "simulate": "Make a data set of simulated grasps from a scene",
    "dataset": "Look into, verify, repair and convert recorded grasps",
    "train": "Train a touch model from a configuration",
    "evaluate": "Score a model and the baselines on a dataset",
    "experiment": "Rebuild an experiment: its table, figures and manifest",
    "run": "Run the whole ROS graph in one terminal",
    "record": "Record grasps with what the hand feels, into a dataset",
    "replay": "Play a recording or a folder of clouds into the ROS graph",
    "models": "List and verify the touch models at hand",
    "doctor": "Tell what this machine lacks, and the line that mends it",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 1 a known failure, 2 wrong usage."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = arguments[0] if arguments and arguments[0] in COMMANDS else None
    parser = _parser(name)
    parsed = _parse(parser, arguments)
    if parsed.command is None:
        parser.print_help()
        return 2
    module = importlib.import_module(f"foretouch.cli.{parsed.command}")
    try:
        status = module.run(parsed)
        sys.stdout.flush()
    except ForetouchError as err:
        print(f"foretouch: {err}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader (`| head`) has gone: leave quietly, and keep the interpreter from flushing again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return int(status)


def _parse(parser: argparse.ArgumentParser, arguments: list[str]) -> argparse.Namespace:
    """Parse; `key=value` may stand behind the options too, where argparse alone refuses further positionals."""
    parsed, late = parser.parse_known_args(arguments)
    if any(word.startswith("-") or "=" not in word for word in late) or (late and not hasattr(parsed, "overrides")):
        parser.error(f"unrecognized arguments: {' '.join(late)}")
    if late:
        parsed.overrides += late
    return parsed


def _parser(chosen: str | None) -> argparse.ArgumentParser:
    """The parser of all commands; only the chosen one's module is imported for its arguments."""
    parser = argparse.ArgumentParser(prog="foretouch", description="Feel before you touch.")
    parser.add_argument("--version", action="version", version=f"foretouch {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, summary in COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=f"{summary}.")
        if name == chosen:
            importlib.import_module(f"foretouch.cli.{name}").add_arguments(command)
    return parser


if __name__ == "__main__":
    sys.exit(main())
