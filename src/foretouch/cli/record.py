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

from foretouch.base.interrupts import uninterrupted
from foretouch.cli.inputs import add_options, positive_number, positive_value
from foretouch.cli.live import executed_table, titled
from foretouch.cli.output import announce, print_json, print_text, warn
from foretouch.cli.parser import CommandParser
from foretouch.cli.screen import make_table, terminal, watch
from foretouch.config import flattened, parse_overrides
from foretouch.dataset.recordings.folder import opened_to_write
from foretouch.ros.graph import Graph
from foretouch.tactile.channels import finger_label
from foretouch.types import stamp_ns

if TYPE_CHECKING:
    from foretouch.cli.keys import RecordingKeys
    from foretouch.ros.nodes.recorder import RecorderNode
    from foretouch.ros.sessions.check import CheckFinding
    from foretouch.ros.sessions.operator import OperatorState
    from foretouch.ros.sessions.session import SessionStatus
    from foretouch.tactile.description import Sensor
    from foretouch_msgs.msg import RecorderStatus, TopicAccount

_SERVICES = "edit_grasp, next_object, pause_recording, undo_edit and stop_recording"
_NO_GRAPH = "nothing comes from the graph: start `foretouch run` or perception.launch.py, or look at its namespace"
_GRAPH_S = 5  # until somebody must publish the topics of the graph
_REST_S = 5.0
_PRESS_S = 15.0  # longest wait for an answer
_OFFERED_S = 0.5  # how long a service is looked for
_SETTLE_S = 1.5  # until a finger that was released is at rest, and the detector has a reference again
_COPIED = ("recording", "path", "samples", "unlabelled", "received", "lost", "reason")  # of the status, for `--json`


def record_panel(
    status: RecorderStatus, title: str, session: SessionStatus, keys: Sequence[Text] = (), sensor: Sensor | None = None
) -> Panel:
    """Samples, objects with their outcomes, the last grasp, sensors, and message counts of each topic, at a glance.

    `keys` are the answer to the last key and the list of keys; `sensor` is the described sensor, None for a BioTac SP.
    """
    parts: list[RenderableType] = [_samples(status)]
    if status.reason:
        parts.append(Text(status.reason, "red"))
    if without_graph(status):
        parts.append(Text(_NO_GRAPH, "yellow"))
    parts += [*keys, _objects(session.operator)]
    if session.last is not None:
        parts.append(executed_table(*session.last, sensor))
    outcomes = _counted(status.outcomes, status.outcome_counts) or "none yet"
    known = not math.isnan(status.pairing_error)
    latest, largest = (f"{1e3 * error:.0f}" for error in (status.pairing_error, status.pairing_error_max))
    error = f"; pairing error {latest} ms, at most {largest}" if known else ""
    states = zip(status.sensors, status.sensor_states, strict=True)
    colours = [(f"{name} {state}  ", "green" if state == "alive" else "red") for name, state in states]
    parts += [Text(f"grasps executed: {outcomes}{error}"), Text.assemble("sensors: ", *colours)]
    odd = [name for name in sorted(session.anomalies) if name.startswith(("taxels_", "not_read_", "unreadable "))]
    for what, text, style in (
        ("not usable", _counted(odd, [session.anomalies[name] for name in odd]), "yellow"),
        ("dropped", _counted(status.drop_reasons, status.drop_counts), ""),
    ):
        if text:
            parts.append(Text(f"{what}: {text}", style))
    return titled(title, [*parts, _topics(status.topics)])


def without_graph(status: RecorderStatus) -> bool:
    """Return whether a recording waits for a graph that does not run: no message of its topics came within 5 s."""
    own = [topic.received for topic in status.topics if topic.topic.endswith(("/object_cloud", "/table", "/grasps"))]
    return bool(own) and not any(own) and status.duration.sec >= _GRAPH_S


def _counted(names: Sequence[str], counts: Sequence[int]) -> str:
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in zip(names, counts, strict=True))


def _samples(status: RecorderStatus) -> Text:
    (minutes, seconds), left_s = divmod(status.duration.sec, 60), status.disk_left
    left = "weeks" if left_s >= 1e6 else f"{left_s / 60.0:.0f} min"
    if 7200.0 <= left_s < 1e6:
        left = f"{left_s / 86_400.0:.0f} days" if left_s >= 172_800.0 else f"{left_s / 3600.0:.0f} h"
    return Text.assemble(
        (f"{minutes}:{seconds:02d}  ", "bold" if status.recording else "dim"),
        (f"{status.samples} samples", "bold green" if status.samples else "bold"),
        f" + {status.unlabelled} without touch{f'; last {status.last_sample}' if status.last_sample else ''}",
        f"  {status.bytes_written / 1e9:.3f} GB, disk full in {left}",
    )


def _objects(state: OperatorState) -> Text:
    """Return grasps by object and outcome, that on the table first."""
    text = Text("PAUSED  ", "bold yellow") if state.paused else Text()
    grasps = state.grasps or {}
    for name in sorted({state.object, *grasps}, key=lambda name: name != state.object):
        text.append(name, "bold" if name == state.object else "")
        text.append(f" {_counted(*zip(*grasps.get(name, {}).items(), strict=True)) if grasps.get(name) else 0}  ")
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


def add_arguments(parser: CommandParser) -> None:
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
    add_options(parser, "--sensor")
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="change one parameter of the recorder, such as tactile_topic=/taxels or identity.hand=shadow_hand",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="check hand, camera and table before a session, press each finger in turn, store the report with the"
        " dataset, and record nothing",
    )
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
            return run_check(node, arguments)
        with uninterrupted():  # or a file would be open that no session closes
            node.begin(str(Path(arguments.output).resolve()), arguments.object)
        _watch(node, arguments)
        state = node.session_status()
        announce("writing what is left")
        with uninterrupted():
            node.end()
        status = node.status()
        if arguments.json:
            print_json(_status_record(status, node.session_status()))
        else:
            title = f"foretouch record: {status.path}"
            terminal().print(record_panel(status, title, state, sensor=_described(node)))
        if status.reason:
            warn(status.reason)
        return int(bool(status.reason))


def press_simulated(node: RecorderNode, finger: str) -> bool:
    """Ask the hand to press a finger, such as `TH`; returns whether it is a simulated one, which can."""
    from std_srvs.srv import Trigger

    client = node.create_client(Trigger, f"press_{finger.lower()}")
    if client.wait_for_service(_OFFERED_S):
        client.call_async(Trigger.Request())
        return True
    node.destroy_client(client)
    return False


def run_check(node: RecorderNode, arguments: argparse.Namespace) -> int:
    """Check with an active recorder that records nothing; 1 if there is a fault."""
    from foretouch.ros.sessions.check import CHECKS, store_check

    path = Path(arguments.output).resolve()
    with opened_to_write(path, node.identity, node.reader.sensor):
        findings = _check(node, as_json=arguments.json)
        store_check(path, findings, time.time_ns())
    faults = sum(bool(finding.fix) for finding in findings)
    warn(f"{len(findings)} checks, {faults} faults; stored in {path / CHECKS}")
    return int(bool(faults))


def _check(node: RecorderNode, *, as_json: bool) -> list[CheckFinding]:
    """Print and return what is found."""
    from foretouch.ros.sessions.check import CheckFeed, CheckFinding, SessionCheck

    assert node.inputs is not None  # noqa: S101  an active node has them
    config = node.config
    findings: list[CheckFinding] = []
    check = SessionCheck(config.tactile.fingers, node.reader)
    feed = CheckFeed(check, node.inputs, node.reader)

    def report(new: list[CheckFinding]) -> None:
        findings.extend(new)
        for finding in new:
            if as_json:
                print_json(finding.record())
            elif finding.fix:
                print_text(f"FAULT {finding.name}: {finding.found}; fix: {finding.fix}", "red")
            else:
                print_text(f"ok    {finding.name}: {finding.found}")

    models = f"hand {config.identity.hand}, camera {config.identity.camera}"
    report([CheckFinding("recorded as", f"{models} (--set identity.hand=NAME, --set identity.camera=NAME)")])
    try:
        warn(f"keep the fingers open and still for {_REST_S:g} s")
        feed.receive(_REST_S)
        report(check.at_rest())
        for finger, name in zip(node.reader.channels.fingers, config.tactile.fingers, strict=True):
            check.pressed.clear()
            if press_simulated(node, finger):
                warn(f"the simulated hand presses its {finger_label(finger)} ({name})")
            else:
                warn(f"press the {finger_label(finger)} ({name}) on its pad, and let it go")
            feed.receive(_PRESS_S, lambda: bool(check.pressed))
            feed.receive(_SETTLE_S)
            check.end_press(finger)
        report(check.presses())
    finally:
        feed.close()
    return findings


def _parameters(arguments: argparse.Namespace) -> dict[str, Any]:
    from foretouch.ros.nodes.recorder import RecorderConfig

    changes = parse_overrides(arguments.set)
    given: dict[str, Any] = {
        "tactile.sensor": arguments.sensor,
        "points": (arguments.check and not changes.get("depth")) or None,
        "objects": arguments.objects,
        "assume_grasps": arguments.assume_grasps or None,
    }
    checked = flattened(RecorderConfig().updated(changes, "--set").to_mapping())
    given |= {name: checked[name] for name in flattened(changes)}
    return {"autostart": True} | {name: value for name, value in given.items() if value is not None}


def _watch(node: RecorderNode, arguments: argparse.Namespace) -> None:
    """Show the state until enough is recorded, the recording has ended by itself, Ctrl-C, or the key `q`."""
    from foretouch.cli.keys import Keyboard, RecordingKeys, has_keyboard

    end = math.inf if arguments.seconds is None else time.monotonic() + arguments.seconds
    samples = math.inf if arguments.samples is None else arguments.samples
    keys = RecordingKeys(node.act)

    def ended() -> bool:
        return not node.recording or time.monotonic() >= end or node.session_status().message.samples >= samples

    warned = False

    def report() -> None:
        nonlocal warned
        if not warned and without_graph(node.status()):
            warned = True
            warn(_NO_GRAPH)
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
    """Return the sensor by its description; None for a BioTac SP by the type of its messages."""
    return node.reader.sensor if node.config.tactile.sensor else None


def _status_record(status: RecorderStatus, session: SessionStatus) -> dict[str, Any]:
    """Return the status as `--json` prints it, which has null for what is not finite."""
    topics = {
        topic.topic: {name: getattr(topic, name) for name in ("received", "written", "waiting", "lost", "reliable")}
        | {"dropped": dict(zip(topic.drop_reasons, topic.drop_counts, strict=True))}
        for topic in status.topics
    }
    return {
        **{name: getattr(status, name) for name in _COPIED},
        "seconds": stamp_ns(status.duration) * 1e-9,
        "bytes": status.bytes_written,
        "outcomes": dict(zip(status.outcomes, status.outcome_counts, strict=True)),
        "pairing_error_s": {"last": status.pairing_error, "max": status.pairing_error_max},
        "written": status.used,
        "dropped": dict(zip(status.drop_reasons, status.drop_counts, strict=True)),
        "topics": topics,
        "tactile": dict(session.anomalies),
        "sensors": dict(zip(status.sensors, status.sensor_states, strict=True)),
        "disk_left_min": status.disk_left / 60.0,
    }
