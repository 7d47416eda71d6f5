# SPDX-License-Identifier: Apache-2.0
"""`foretouch record`: the recorder with a live panel; Ctrl-C ends the recording cleanly."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Callable
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.cli.output import print_json, warn
from foretouch.errors import ForetouchError
from foretouch.tactile.messages import TACTILE_TYPES, TactileConfig
from foretouch.topics import TACTILE_TOPIC

if TYPE_CHECKING:
    from foretouch.ros.nodes.recorder import RecorderNode
    from foretouch_msgs.msg import RecorderStatus


_REFRESH_S = 0.25


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="dataset; an existing one is extended")
    parser.add_argument(
        "--object", default="", metavar="LABEL", help="label of the object on the table (default: unknown)"
    )
    parser.add_argument("--note", default="", help="note for every sample")
    parser.add_argument(
        "--tactile-topic", metavar="TOPIC", help=f"topic of the tactile messages (default: {TACTILE_TOPIC})"
    )
    default_type = TactileConfig().type
    parser.add_argument("--tactile-type", choices=list(TACTILE_TYPES), help=f"their type (default: {default_type})")
    parser.add_argument("--thumb", metavar="NAME", help="name of the thumb in the tactile messages")
    parser.add_argument("--middle", metavar="NAME", help="name of the middle finger")
    parser.add_argument("--hand", metavar="MODEL[:SERIAL]", help="identity of the hand (default: shadow_hand)")
    parser.add_argument("--camera", metavar="MODEL[:SERIAL]", help="identity of the camera (default: realsense)")
    parser.add_argument("--points", action="store_true", help="record the camera's whole clouds too")
    parser.add_argument(
        "--assume-grasps",
        action="store_true",
        help="assign contacts without a report to the best grasp of the last cloud before them",
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="end after this time")
    parser.add_argument("--samples", type=int, metavar="N", help="end after this number of labelled samples")
    parser.add_argument("--params", metavar="YAML", help="ROS parameter file")
    parser.add_argument("--namespace", help="namespace of the graph (default: /foretouch)")
    parser.add_argument("--json", action="store_true", help="one JSON object a second, the last with the final counts")


def run(arguments: argparse.Namespace) -> int:
    """Record; exit status 1 if the recording did not start, or ended by itself."""
    from foretouch.ros.graph import Graph
    from foretouch.ros.nodes.recorder import RecorderNode

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: the file is closed cleanly
    graph = Graph({"recorder": _parameters(arguments)}, namespace=arguments.namespace, params_file=arguments.params)
    with graph:
        node = graph.nodes["recorder"]
        if not isinstance(node, RecorderNode) or node.state_name != "active":
            raise ForetouchError("the recorder did not start; see its log")
        node.begin(str(Path(arguments.output).resolve()), arguments.object, arguments.note)
        _watch(node, arguments)
        node.end()
        return _finish(node.status(), arguments)


def _parameters(arguments: argparse.Namespace) -> dict[str, Any]:
    given = {
        "tactile_topic": arguments.tactile_topic,
        "tactile.type": arguments.tactile_type,
        "tactile.thumb": arguments.thumb,
        "tactile.middle": arguments.middle,
        "points": arguments.points or None,
        "assume_grasps": arguments.assume_grasps or None,
        **_identity("hand", arguments.hand),
        **_identity("camera", arguments.camera),
    }
    return {name: value for name, value in given.items() if value is not None}


def _identity(what: str, given: str | None) -> dict[str, str | None]:
    model, _, serial = (given or "").partition(":")
    return {f"identity.{what}": model or None, f"identity.{what}_serial": serial or None}


def _watch(node: RecorderNode, arguments: argparse.Namespace) -> None:
    """Show the state until enough is recorded, the recording has ended by itself, or Ctrl-C."""
    end = None if arguments.seconds is None else time.monotonic() + arguments.seconds

    def ended() -> bool:
        enough = arguments.samples is not None and node.samples >= arguments.samples
        return enough or not node.recording or (end is not None and time.monotonic() >= end)

    try:
        if arguments.json:
            _report_until(ended, node)
        elif sys.stdout.isatty():
            _draw_until(ended, node)
        else:
            while not ended():
                time.sleep(_REFRESH_S)
    except KeyboardInterrupt:
        pass


def _report_until(ended: Callable[[], bool], node: RecorderNode) -> None:
    printed = 0.0
    while not ended():
        if time.monotonic() - printed >= 1.0:
            printed = time.monotonic()
            print_json(status_record(node.status()))
            sys.stdout.flush()
        time.sleep(_REFRESH_S)


def _draw_until(ended: Callable[[], bool], node: RecorderNode) -> None:
    from rich.live import Live

    from foretouch.cli.record_panel import record_panel

    with Live(refresh_per_second=1 / _REFRESH_S, transient=True) as live:
        while not ended():
            live.update(record_panel(node.status(), "foretouch record (Ctrl-C ends it)"))
            time.sleep(_REFRESH_S)


def _finish(status: RecorderStatus, arguments: argparse.Namespace) -> int:
    if arguments.json:
        print_json(status_record(status))
    else:
        from rich.console import Console

        from foretouch.cli.record_panel import record_panel

        Console().print(record_panel(status, f"foretouch record: {status.path}"))
    if status.reason:
        warn(status.reason)
    return 1 if status.reason else 0


def status_record(status: RecorderStatus) -> dict[str, Any]:
    """The status as `--json` prints it."""
    from foretouch.tactile.messages.table import stamp_ns

    errors = {"last": status.pairing_error, "max": status.pairing_error_max}
    return {
        "recording": status.recording,
        "path": status.path,
        "seconds": stamp_ns(status.duration) * 1e-9,
        "bytes": status.bytes_written,
        "samples": status.samples,
        "unlabelled": status.unlabelled,
        "outcomes": dict(zip(status.outcomes, status.outcome_counts, strict=True)),
        "pairing_error_s": {name: None if isnan(error) else error for name, error in errors.items()},
        "received": status.received,
        "written": status.used,
        "dropped": dict(zip(status.drop_reasons, status.drop_counts, strict=True)),
        "lost": status.lost,
        "topics": {
            topic.topic: {
                "received": topic.received,
                "written": topic.written,
                "waiting": topic.waiting,
                "dropped": dict(zip(topic.drop_reasons, topic.drop_counts, strict=True)),
                "lost": topic.lost,
                "reliable": topic.reliable,
            }
            for topic in status.topics
        },
        "sensors": dict(zip(status.sensors, status.sensor_states, strict=True)),
        "disk_left_min": None if status.disk_left == float("inf") else status.disk_left / 60.0,
        "reason": status.reason,
    }
