# SPDX-License-Identifier: Apache-2.0
"""`foretouch record`: the recorder with a live panel; Ctrl-C ends the recording cleanly."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from functools import partial
from os.path import commonpath
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from rich.console import RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from foretouch.cli.inputs import add_options, positive_number, positive_value
from foretouch.cli.live import executed_table, titled
from foretouch.cli.output import announce, print_json, warn
from foretouch.cli.run import report_conflicts
from foretouch.cli.screen import make_table, terminal, watch
from foretouch.dataset.topics import TACTILE_TOPIC
from foretouch.interrupts import uninterrupted
from foretouch.ros.graph import Graph
from foretouch.tactile.messages.table import TACTILE_TYPES, TactileConfig, stamp_ns

if TYPE_CHECKING:
    from foretouch.cli.keys import RecordingKeys
    from foretouch.ros.nodes.recorder import RecorderNode
    from foretouch.ros.recorder.operator import OperatorState
    from foretouch.ros.recorder.session import SessionStatus
    from foretouch.tactile.description import Sensor
    from foretouch_msgs.msg import RecorderStatus, TopicAccount

_SERVICES = "edit_grasp, next_object, pause_recording, undo_edit and stop_recording"


def record_panel(
    status: RecorderStatus,
    title: str,
    session: SessionStatus | None = None,
    keys: Sequence[Text] = (),
    sensor: Sensor | None = None,
) -> Panel:
    """Samples, rejected grasps, sensors, message counts and the time left on the disk, at a glance.

    With `session`, also objects with their outcomes and the last grasp. `keys` are the answer to the last key and the list of keys; `sensor` is that which is described.
    """
    parts: list[RenderableType] = [_samples(status), *[Text(status.reason, "red")] * bool(status.reason), *keys]
    if session is not None:
        parts.append(_objects(session.operator))
    if session is not None and session.last is not None:
        parts.append(executed_table(*session.last, sensor))
    dropped = ", ".join(f"{n} {why}" for why, n in zip(status.drop_reasons, status.drop_counts, strict=True))
    parts += [_grasps(status), _sensors(status), *_invalid(session), *[Text(f"dropped: {dropped}")] * bool(dropped)]
    return titled(title, [*parts, _topics(status.topics)])


def _samples(status: RecorderStatus) -> Text:
    (minutes, seconds), left_s = divmod(status.duration.sec, 60), status.disk_left
    left = f"full in {left_s / 60.0:.0f} min" if left_s < 1e6 else "-" if math.isinf(left_s) else "weeks"
    return Text.assemble(
        (f"{minutes}:{seconds:02d}  ", "bold" if status.recording else "dim"),
        (f"{status.samples} samples", "bold green" if status.samples else "bold"),
        f" + {status.unlabelled} without touch",
        f", {60.0 * status.samples / status.duration.sec:.1f} a minute"
        if status.samples and status.duration.sec
        else "",
        f"; last {status.last_sample}" if status.last_sample else "",
        f"  {status.bytes_written / 1e9:.3f} GB, disk{':' * (left_s >= 1e6)} {left}",
    )


def _grasps(status: RecorderStatus) -> Text:
    counts = [
        (f"{count} {name.replace('_', ' ')}  ", "green" if name == "recorded" else "yellow")
        for name, count in zip(status.outcomes, status.outcome_counts, strict=True)
    ]
    error, most = 1e3 * status.pairing_error, 1e3 * status.pairing_error_max
    error_text = "" if math.isnan(error) else f"pairing error {error:.0f} ms, at most {most:.0f}"
    return Text.assemble("grasps executed: ", *(counts or [("none yet  ", "dim")]), error_text)


def _sensors(status: RecorderStatus) -> Text:
    return Text.assemble(
        "sensors: ",
        *(
            (f"{name} {state}  ", "green" if state == "alive" else "red")
            for name, state in zip(status.sensors, status.sensor_states, strict=True)
        ),
    )


def _invalid(session: SessionStatus | None) -> list[Text]:
    """What could not be used of tactile messages, if anything."""
    counts = {} if session is None else session.anomalies
    shown = {name: n for name, n in counts.items() if name.startswith(("taxels_", "not_read_", "unreadable "))}
    text = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in sorted(shown.items()))
    return [Text(f"not usable: {text}", "yellow")] * bool(text)


def _objects(state: OperatorState) -> Text:
    """Grasps by object and outcome, that on the table first."""
    text = Text("PAUSED  ", "bold yellow") if state.paused else Text()
    grasps = state.grasps or {}
    for name in sorted({state.object, *grasps}, key=lambda name: name != state.object):
        text.append(name, "bold" if name == state.object else "")
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in grasps.get(name, {}).items())
        text.append(f" {outcomes or 0}  ")
    return text


def _topics(topics: Sequence[TopicAccount]) -> Table:
    own = [
        topic.topic for topic in topics[1:] if topic.topic.count("/") > 1
    ]  # the first is the hand's, /tf the robot's
    common = commonpath(own or ["/"]).rstrip("/") + "/"
    rows: list[list[str | Text]] = []
    for topic in topics:
        dropped = sum(topic.drop_counts)
        rows.append([
            Text(topic.topic.removeprefix(common), "" if topic.reliable else "yellow"),
            f"{topic.rate:.1f}",
            str(topic.received),
            str(topic.written),
            str(topic.waiting),
            Text(str(topic.lost), "red" if topic.lost else ""),
            Text(str(dropped), "red" if dropped else ""),
        ])  # fmt: skip
    return make_table(("topic", "Hz", "received", "written", "queue", "lost", "dropped"), rows, live=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="dataset; an existing one is extended")
    parser.add_argument(
        "--object", default="", metavar="NAME", help="name of the object on the table (default: unknown)"
    )
    parser.add_argument(
        "--objects",
        nargs="+",
        metavar="NAME",
        help="names of the objects to record, in order: the key `o` takes the next",
    )
    parser.add_argument("--note", default="", help="note for every sample")
    parser.add_argument(
        "--tactile-topic", metavar="TOPIC", help=f"topic of the tactile messages (default: {TACTILE_TOPIC})"
    )
    parser.add_argument(
        "--tactile-type",
        choices=list(TACTILE_TYPES),
        metavar="TYPE",
        help=f"{', '.join(TACTILE_TYPES)} (default: {TactileConfig().type})",
    )
    add_options(parser, "--sensor", "--thumb", "--middle")
    parser.add_argument("--hand", metavar="MODEL[:SERIAL]", help="identity of the hand (default: shadow_hand)")
    parser.add_argument("--camera", metavar="MODEL[:SERIAL]", help="identity of the camera (default: realsense)")
    parser.add_argument(
        "--check",
        action="store_true",
        help="check hand, camera and table before a session, press each finger in turn, store the report with the"
        " dataset, and record nothing",
    )
    parser.add_argument("--points", action="store_true", help="record the camera's whole clouds too")
    parser.add_argument(
        "--assume-grasps",
        action="store_true",
        help="assign contacts without a report to the best grasp of the last cloud before them",
    )
    parser.add_argument(
        "--seconds", type=positive_value, metavar="S", help="end after this time [s] (default: at Ctrl-C)"
    )
    parser.add_argument(
        "--samples",
        type=positive_number,
        metavar="N",
        help="end after this number of samples with readings (default: at Ctrl-C)",
    )
    add_options(parser, "--params", "--namespace")


def run(arguments: argparse.Namespace) -> int:
    """Record; exit status 1 if the recording did not start or ended by itself, or the check found a fault."""
    graph = Graph({"recorder": _parameters(arguments)}, namespace=arguments.namespace, params_file=arguments.params)
    announce("starting the recorder")
    with graph:
        graph.require_active()
        node = cast("RecorderNode", graph.nodes["recorder"])
        if arguments.check:
            from foretouch.cli.check import run_check

            return run_check(node, arguments)
        with uninterrupted():  # or a file would be open that no session closes
            node.begin(str(Path(arguments.output).resolve()), arguments.object, arguments.note)
        _watch(node, arguments)
        state = node.session_status()
        announce("writing what is left")
        with uninterrupted():
            node.end()
        report_conflicts(graph)
        status = node.status()
        if arguments.json:
            print_json(_status_record(status, node.session_status()))
        else:
            terminal().print(record_panel(status, f"foretouch record: {status.path}", state, sensor=_described(node)))
        if status.reason:
            warn(status.reason)
        return int(bool(status.reason))


def _parameters(arguments: argparse.Namespace) -> dict[str, Any]:
    given = {
        "tactile_topic": arguments.tactile_topic,
        "tactile.type": arguments.tactile_type,
        "tactile.sensor": arguments.sensor,
        "tactile.thumb": arguments.thumb,
        "tactile.middle": arguments.middle,
        "points": arguments.points or arguments.check or None,
        "objects": arguments.objects,
        "assume_grasps": arguments.assume_grasps or None,
        **_identity("hand", arguments.hand),
        **_identity("camera", arguments.camera),
    }
    return {"autostart": True} | {name: value for name, value in given.items() if value is not None}


def _identity(what: str, given: str | None) -> dict[str, str | None]:
    model, _, serial = (given or "").partition(":")
    return {f"identity.{what}": None if given is None else model, f"identity.{what}_serial": serial or None}


def _watch(node: RecorderNode, arguments: argparse.Namespace) -> None:
    """Show the state until enough is recorded, the recording has ended by itself, Ctrl-C, or the key `q`."""
    from foretouch.cli.keys import Keyboard, RecordingKeys, has_keyboard

    end = math.inf if arguments.seconds is None else time.monotonic() + arguments.seconds
    samples = math.inf if arguments.samples is None else arguments.samples
    keys = RecordingKeys(node.act)

    def ended() -> bool:
        return not node.recording or time.monotonic() >= end or node.session_status().message.samples >= samples

    def report() -> None:
        if arguments.json:
            print_json(_status_record(node.status(), node.session_status()))

    has_keys = has_keyboard() and not terminal().is_dumb_terminal and not arguments.json
    with suppress(KeyboardInterrupt), ExitStack() as stack:
        if not has_keys:
            warn(f"keys are off without a terminal; the services {_SERVICES} of the recorder do the same")
        report()
        if not has_keys:
            watch(ended, None if arguments.json else partial(_panel, node, None), report, every_s=1.0)
            return
        keyboard = stack.enter_context(Keyboard())

        def wait(timeout_s: float) -> None:
            keys.press(keyboard.read(timeout_s))

        watch(lambda: keys.quitted or ended(), partial(_panel, node, keys), report, every_s=1.0, wait=wait)


def _panel(node: RecorderNode, keys: RecordingKeys | None) -> Panel:
    session = node.session_status()
    lines = [] if keys is None else keys.lines(next(reversed(session.operator.replies), None))
    title = "foretouch record (Ctrl-C ends it)"
    return record_panel(node.status(), title, session, lines, _described(node))


def _described(node: RecorderNode) -> Sensor | None:
    """The sensor by its description; None for a BioTac SP by the type of its messages."""
    return node.reader.sensor if node.config.tactile.sensor else None


def _status_record(status: RecorderStatus, session: SessionStatus) -> dict[str, Any]:
    """The status as `--json` prints it, which has null for what is not finite."""
    return {
        "recording": status.recording,
        "path": status.path,
        "seconds": stamp_ns(status.duration) * 1e-9,
        "bytes": status.bytes_written,
        "samples": status.samples,
        "unlabelled": status.unlabelled,
        "outcomes": dict(zip(status.outcomes, status.outcome_counts, strict=True)),
        "pairing_error_s": {"last": status.pairing_error, "max": status.pairing_error_max},
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
        "tactile": dict(session.anomalies),
        "sensors": dict(zip(status.sensors, status.sensor_states, strict=True)),
        "disk_left_min": status.disk_left / 60.0,
        "reason": status.reason,
    }
