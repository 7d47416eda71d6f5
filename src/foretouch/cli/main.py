# SPDX-License-Identifier: Apache-2.0
"""`foretouch COMMAND`: run the command's module, and report known errors in one line with exit status 1.

`commands.py` lists the commands; installed packages add theirs.
"""

import argparse
import io
import os
import signal
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress

from foretouch import __version__
from foretouch.base.interrupts import end_at_once, raise_interrupts, signal_number
from foretouch.cli.commands import COMMANDS, CommandEntry
from foretouch.cli.parser import CommandParser
from foretouch.doors import needs_extras
from foretouch.errors import ForetouchError, shown


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 success, 1 known failure, 2 wrong usage."""
    try:
        return _reported(argv)
    except KeyboardInterrupt as err:  # at the very end, while signals are given back to the system
        return 128 + signal_number(err)


def _reported(argv: Sequence[str] | None) -> int:
    """Run one command, and print known errors."""
    try:
        if argv is None:
            _prepare_streams()
            raise_interrupts()
        status = _run(list(sys.argv[1:] if argv is None else argv))
        sys.stdout.flush()
    except ForetouchError as err:
        print(f"foretouch: {err}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as err:
        number = signal_number(err)
        print(f"foretouch: ended by {signal.Signals(number).name}", file=sys.stderr)
        return 128 + number
    except BrokenPipeError:  # the reader (`| head`) has exited
        _discard_output()
        return 0
    except OSError as err:  # a full disk, a folder that may not be written
        _discard_output()
        name, cause = shown(str(err.filename or "output")), os.strerror(err.errno) if err.errno else err
        print(f"foretouch: {name}: {cause}", file=sys.stderr)
        return 1
    finally:
        end_at_once()
    return status


def _discard_output() -> None:
    """Keep the interpreter from writing the rest of stdout at its end, which would fail again."""
    with suppress(ValueError):  # of a stream without a descriptor
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _prepare_streams() -> None:
    """Output that works without a terminal, where a stream was closed, and in every locale."""
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper) and name != "stdin":
            stream.reconfigure(errors="replace")


def _run(arguments: list[str]) -> int:
    parser = command_parser(arguments[0] if arguments else None)
    parsed = _parse(parser, arguments)
    if parsed.command is None:
        parser.print_help()
        return 2
    command: CommandEntry = COMMANDS.load(parsed.command)
    if command.uses_ros:
        from foretouch.ros.runtime.environment import check_variables

        check_variables()
    with needs_extras(parsed.command):  # some libraries are imported when they are needed
        return int(command.load(parsed.command).run(parsed) or 0)


def _parse(parser: CommandParser, arguments: list[str]) -> argparse.Namespace:
    """Parse; `key=value` may also follow the options, where argparse alone rejects further positionals."""
    parsed: argparse.Namespace
    parsed, rest = parser.parse_known_args(arguments)
    if any(word.startswith("-") or "=" not in word for word in rest) or (rest and not hasattr(parsed, "overrides")):
        parser.error(f"there is no such argument: {' '.join(rest)}")
    if rest:
        parsed.overrides += rest
    return parsed


def command_parser(chosen: str | None) -> CommandParser:
    """Make the parser of all commands; only the module of the chosen one is imported for its arguments."""
    parser = CommandParser(
        prog="foretouch", description="Plan two-finger grasps, and predict what tactile fingertips will read."
    )
    parser.add_argument("--version", action="version", version=f"foretouch {__version__}", help="print the version")
    # Of a command that exists, neither its errors nor its help list the others, which need not be looked for.
    commands: Iterable[tuple[str, CommandEntry]]
    if chosen is not None and "." not in chosen and chosen in COMMANDS:
        commands = [(chosen, COMMANDS.load(chosen))]
    else:
        commands = COMMANDS.loaded()
    for name, command in commands:
        if "." in name:  # an action of a command
            continue
        of_command = parser.add_command(name, command.summary, command.example)
        if name == chosen:
            command.load(name).add_arguments(of_command)
            if command.has_json:
                of_command.add_json()
    return parser


if __name__ == "__main__":
    sys.exit(main())
