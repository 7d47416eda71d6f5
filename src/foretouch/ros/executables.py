# SPDX-License-Identifier: Apache-2.0
"""An entry point for each node: `ros2 run` and the launch files start these.

Threads: one takes messages and serves requests and timers (rclpy's `SingleThreadedExecutor`), and one works on clouds (see
`runtime.workers`), so that a cloud in work delays no service, parameter or lifecycle request, nor the next message.
"""

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from foretouch.base.interrupts import end_at_once, raise_interrupts
from foretouch.errors import ForetouchError
from foretouch.ros.graph import Graph
from foretouch.ros.nodes import node_class
from foretouch.ros.runtime.environment import check_variables, prepare_environment


def run(*names: str, args: Sequence[str] | None = None) -> int:
    """Start nodes in this process and serve until Ctrl-C, shutdown, or until each has ended by itself.

    Args:
        names: Of the nodes.
        args: The command line with ROS arguments; by default `sys.argv`.

    Returns:
        Exit status 0, or 1 after a known error, which is printed in one line on stderr, or if a node has failed.
    """
    arguments = list(sys.argv if args is None else args)
    _parser(names).parse_args(arguments[1:])
    end_at_once()  # the imports below may take seconds on a busy computer, and leave nothing to clean up
    try:
        check_variables()
        prepare_environment()
        for name in names:
            node_class(name)
        raise_interrupts()
        graph = Graph({name: {} for name in names}, arguments=arguments, monitor=None)
        with suppress(KeyboardInterrupt), graph:
            graph.wait_until_ended()
        return int(any(node.failure for node in graph.nodes.values()))
    except ForetouchError as err:
        sys.stderr.write(f"foretouch: {err}\n")
        return 1
    except KeyboardInterrupt:
        return 0
    finally:
        end_at_once()


def _parser(names: Sequence[str]) -> argparse.ArgumentParser:
    """Refuses what is not for ROS, with exit status 2, and answers `--help`."""
    program = names[0] if len(names) == 1 else "nodes"
    parser = argparse.ArgumentParser(
        f"foretouch_{program}",
        description=f"Run {', '.join(names)} until Ctrl-C. Parameters: docs/reference/parameters.md, or `ros2 param list`.",
        epilog=f"example: foretouch_{program} --ros-args -r __ns:=/left --params-file left.yaml",
        allow_abbrev=False,
    )
    options = "-p NAME:=VALUE, --params-file FILE, -r __ns:=/NAMESPACE, -r TOPIC:=OTHER, --log-level LEVEL"
    parser.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], metavar="…", help=options)
    return parser


camera = partial(run, "camera")
perception = partial(run, "perception")
segmentation = partial(run, "segmentation")
grasp = partial(run, "grasp")
touch_predictor = partial(run, "touch_predictor")
replay = partial(run, "replay")
hand = partial(run, "hand")
recorder = partial(run, "recorder")
bridge = partial(run, "bridge")
