# SPDX-License-Identifier: Apache-2.0
"""`foretouch run`: a source of clouds, the whole graph and a live table in one terminal."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from rich.panel import Panel

from foretouch.base.files import PICTURE_SUFFIXES, require_existing, require_writable
from foretouch.camera.source import ImageSource, find_source
from foretouch.cli.answers import answer_record
from foretouch.cli.inputs import CAMERA, add_options, depth_camera, numbers, positive_number, positive_value
from foretouch.cli.live import live_panel
from foretouch.cli.output import JsonLines, announce, warn
from foretouch.cli.parser import CommandParser
from foretouch.cli.screen import terminal, watch
from foretouch.doors import at_work, needs_extras
from foretouch.errors import ConfigError, ForetouchError
from foretouch.grasp import HandConfig
from foretouch.models import History, TouchModel, load_model
from foretouch.ros.graph import Graph, input_of
from foretouch.ros.runtime.parameter_files import nodes_of_file
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor, sensor_in
from foretouch.types import Sample

if TYPE_CHECKING:
    from foretouch.dataset.source import Source
    from foretouch.report.touch_figure import DrawnGrasp
    from foretouch.ros.nodes.bridge import BridgeNode
    from foretouch.ros.nodes.monitor import Drawable
    from foretouch.ros.nodes.replay import ReplayNode
    from foretouch.tactile.messages.table import TactileConfig
    from foretouch_msgs.msg import TouchPredictionArray


_END_S = 1.5  # for what waits to be printed at the end
_TOPIC_S = 5.0  # until somebody must publish a topic


def add_arguments(parser: CommandParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--source",
        required=True,
        metavar="DIR|FILE|SCENE|TOPIC|camera",
        help="files or a folder of clouds or samples, a recording, a scene (.yaml) with simulated camera and hand,"
        " a topic of depth images (with camera_info next to it) or clouds, or `camera`, the RealSense",
    )
    parser.add_argument(
        "--dwell",
        type=positive_value,
        metavar="S",
        help="time that each object of a scene stays on the table (default: 3)",
    )
    add_replay_arguments(parser, "recorded times; files one by one; scenes at 5")
    parser.add_argument(
        "--count",
        type=positive_number,
        metavar="N",
        help="end after N answered clouds (default: at the end of the source, or Ctrl-C)",
    )
    add_options(parser, "--hand", "--model", "--predictor", "--params")
    parser.add_argument(
        "--picture",
        metavar="PNG",
        help="save a picture of the last predictions, and of what the simulated hand then read (.png, .pdf, .svg or .jpg)",
    )
    parser.add_argument(
        "--serve",
        type=_address,
        nargs="?",
        const=("127.0.0.1", 8765),
        metavar="HOST:PORT",
        help="serve the topics to Foxglove or Lichtblick (default: no; without an address at 127.0.0.1:8765)",
    )


def add_replay_arguments(parser: CommandParser, default_rate: str) -> None:
    """Declare what is played, and for whom a replay waits before its first cloud."""
    add_options(parser, "--topic", *CAMERA, "--namespace")
    parser.add_argument(
        "--rate", type=positive_value, metavar="HZ", help=f"clouds per second (default: {default_rate})"
    )
    parser.add_argument(
        "--plane", type=numbers, metavar="a,b,c,d", help="table ax+by+cz+d=0 of clouds that hold one object each"
    )
    parser.add_argument(
        "--wait-for",
        action="append",
        default=[],
        metavar="TOPIC",
        help="wait until this topic has a subscriber besides the nodes of the graph, such as a planner of `touch`"
        " (repeatable)",
    )
    limit = "longest wait for --wait-for, and until no node comes or goes any more (default: 10)"
    parser.add_argument("--wait-limit", type=partial(positive_value, or_zero=True), metavar="S", help=limit)


def _address(text: str) -> tuple[str, int]:
    """Parse `HOST:PORT` for argparse."""
    host, colon, port = text.rpartition(":")
    if not (host and colon and port.isdecimal() and int(port) < 2**16):
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT, such as 127.0.0.1:8765")
    return host.removeprefix("[").removesuffix("]"), int(port)


def run(arguments: argparse.Namespace) -> int:
    """Return exit status 1 if a node did not start, a cloud was not answered, there was no prediction at all, or the last grasp touched nothing.

    3 if the camera never sent a cloud.
    """
    if arguments.picture:
        require_writable(arguments.picture, *PICTURE_SUFFIXES)
    nodes = _nodes(arguments)
    sensor = _sensor(arguments, nodes)
    arguments.lines = None  # the lines of answers, with --json
    monitor: dict[str, Any] = {
        "sensor": sensor,
        "with_clouds": arguments.picture is not None,
        "hand": _hand_of(nodes, sensor),
        "count": arguments.count,
    }
    if arguments.json:
        arguments.lines = JsonLines(partial(_printed, sensor))
        monitor["on_touch"] = arguments.lines.put
    graph = Graph(
        nodes,
        namespace=arguments.namespace,
        params_file=arguments.params,
        monitor=monitor,
        arguments=["--ros-args", *arguments.remapped, "--"],
    )
    announce("starting the nodes")
    with graph:
        graph.require_active()
        if arguments.serve is not None:
            warn(f"serving at {cast('BridgeNode', graph.nodes['bridge']).url}: open it in Foxglove or Lichtblick")
        return _finish(graph, arguments, complete=_watch(graph, arguments))


def _nodes(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return parameters of each node by name, from the options; the source comes last, after its subscribers."""
    from foretouch.dataset.source import open_source
    from foretouch.ros.nodes.camera import DEPTH_TOPIC
    from foretouch.ros.sessions.playlist import cloud_is_object

    stated = list(nodes_of_file(arguments.params)) if arguments.params else []
    perception = _named(arguments)
    nodes: dict[str, dict[str, Any]] = {"perception": perception}
    arguments.remapped = []  # what perception receives
    if arguments.serve is not None:
        from foretouch.ros.nodes.bridge import foxglove_sdk

        foxglove_sdk()  # so that an absent one is reported before anything starts
        nodes["bridge"] = dict(zip(("address", "port"), arguments.serve, strict=True))
    shown = None if _is_topic(arguments.source) else find_source(arguments.source)
    live = shown is not None or arguments.source == "camera" or _is_topic(arguments.source)
    _require_used(arguments, scene=shown is not None, files=not live)
    if not live:
        source = open_source(arguments.source, arguments.topic, camera=depth_camera(arguments))
        if not _is_stated(stated, "perception", "late_after_s"):
            perception["late_after_s"] = 0.0  # the recording's stamps are old
        perception["input"] = "objects" if cloud_is_object(source) else "depth" if source.info_topic else "points"
        if arguments.plane is not None and perception["input"] != "objects":
            raise ConfigError(f"--plane: is for the points of one object; the table is found in {arguments.source}")
        if source.info_topic:
            arguments.remapped = _remapped("depth/image", source.topic, source.color_topic)
        return nodes | {"replay": _replay_parameters(arguments, source)}
    if _is_topic(arguments.source):
        perception["input"] = input_of(arguments.source, _TOPIC_S)
        own = "points" if perception["input"] == "points" else "depth/image"
        if arguments.color and (own == "points" or not _is_topic(arguments.color)):
            raise ConfigError(f"--color: {arguments.color} is no topic beside the depth images of {arguments.source}")
        arguments.remapped = _remapped(own, arguments.source, arguments.color)
        return nodes
    perception["input"] = "depth"
    arguments.remapped = _remapped("depth/image", DEPTH_TOPIC)
    for name, parameters in ({"camera": {}} if shown is None else _shown_nodes(arguments, shown)).items():
        asked = {key: value for key, value in parameters.items() if not _is_stated(stated, name, key)}
        nodes[name] = asked | nodes.get(name, {})
    return nodes


def _is_stated(stated: Sequence[tuple[str, Mapping[str, Any]]], node: str, parameter: str) -> bool:
    """Return whether the parameter file sets a parameter, which goes before what the source asks for; what is shown stays its own."""
    names = {name.rpartition("/")[2] for name, settings in stated if parameter in settings}
    return not parameter.startswith("scene.") and any(name == node or "*" in name for name in names)


def _named(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what options name for perception: model, predictor and hand; an absent one is reported before anything starts."""
    given = {"model": arguments.model, "predictor": arguments.predictor, "hand.name": arguments.hand}
    if arguments.model:
        load_model(arguments.model, arguments.predictor)
    if arguments.hand:
        HandConfig().updated({"name": arguments.hand}, "--hand")
    return {name: str(value) for name, value in given.items() if value}


def _remapped(own: str, topic: str, colours: str | None = None) -> list[str]:
    """Return the remaps by which perception receives a topic as one of its own, and the colours, if there are any."""
    color = ["-r", f"perception:color/image:={colours}"] if colours else []
    return ["-r", f"perception:{own}:={topic}", *color]


def _require_used(arguments: argparse.Namespace, *, scene: bool, files: bool) -> None:
    """Refuse options that the source does not use.

    Args:
        arguments: The options.
        scene: Whether the source is a scene.
        files: Whether it is a recording or files.
    """
    played, shown = (files, "recordings and files"), (scene, "scenes (.yaml)")
    beside = files or _is_topic(arguments.source), f"{played[1]}, and depth images on a topic"
    of_options = {
        "--dwell": shown,
        "--rate": (scene or files, f"{played[1]}, and {shown[1]}"),
        **dict.fromkeys(("--topic", "--plane", *CAMERA, "--wait-for", "--wait-limit"), played),
        "--color": beside,
    }
    for option, (used, users) in of_options.items():
        given = getattr(arguments, option.removeprefix("--").replace("-", "_"))
        if given not in (None, "", []) and not used:
            raise ConfigError(f"{option}: is for {users}, and --source {arguments.source} is another source")


def _is_topic(source: str) -> bool:
    """Return whether a source is the full name of a topic, and no file."""
    return re.fullmatch(r"(/[A-Za-z_]\w*)+", source, re.ASCII) is not None and not Path(source).exists()


def _sensor(arguments: argparse.Namespace, nodes: Mapping[str, Mapping[str, Any]]) -> Sensor:
    """Return the sensor of the model; of one that cannot be loaded, which the predictor reports, the BioTac SP."""
    from foretouch.models.card import read_card
    from foretouch.models.registry import find_cards

    given = dict(nodes_of_file(arguments.params)) if arguments.params else {}
    set_in_file = next((parameters["model"] for parameters in given.values() if "model" in parameters), "default")
    model = str(nodes["perception"].get("model", set_in_file))
    try:
        return sensor_in(read_card(find_cards(model)[0]), model)
    except ForetouchError:
        return BIOTAC_SP


def _hand_of(nodes: Mapping[str, Mapping[str, Any]], sensor: Sensor) -> TactileConfig | None:
    """Return how the messages of the simulated hand are read; None without one that has the sensor of the model."""
    from foretouch.tactile.messages.table import TactileConfig

    config = TactileConfig(sensor=nodes["perception"].get("tactile.sensor", ""))
    return config if "hand" in nodes and config.described.sha256 == sensor.sha256 else None


def _shown_nodes(arguments: argparse.Namespace, source: ImageSource) -> dict[str, dict[str, Any]]:
    """Return parameters of the nodes that show a source, which starts now."""
    from foretouch.camera.config import ScheduleConfig

    path = str(require_existing(arguments.source).resolve()) if Path(arguments.source).suffix else ""
    show = ScheduleConfig(path=path, origin_ns=time.time_ns())
    if arguments.dwell is not None:
        show = show.replace(dwell_s=arguments.dwell)
    with needs_extras(f"--source {arguments.source}"), at_work(f"--source {arguments.source}"):
        nodes = {name: dict(parameters) for name, parameters in source.nodes(show, arguments.rate).items()}
    if arguments.picture and "camera" in nodes:
        nodes["camera"]["camera.color"] = True
    return nodes


def _replay_parameters(arguments: argparse.Namespace, source: Source) -> dict[str, Any]:
    """Return parameters of the replay; without a rate, each file is played when the one before was answered."""
    one_by_one = arguments.rate is None and source.kind != "recording"
    given = source_parameters(arguments, str(Path(arguments.source).resolve()))
    return {"lockstep": True, "rate_hz": 1000.0, **given} if one_by_one else given


def source_parameters(arguments: argparse.Namespace, path: str) -> dict[str, Any]:
    """Return parameters of the replay for the options of `add_replay_arguments`."""
    given = {
        "path": path,
        "topic": arguments.topic or None,
        "intrinsics": arguments.intrinsics,
        "camera_info": None if arguments.camera_info is None else str(arguments.camera_info.resolve()),
        "info_topic": arguments.info_topic or None,
        "rectified": arguments.rectified,
        "depth_scale": arguments.depth_scale,
        "color": _whole_name(arguments.color),
        "rate_hz": arguments.rate,
        "table": arguments.plane,
        "wait_for": arguments.wait_for or None,
        "wait_limit_s": arguments.wait_limit,
    }
    return {name: value for name, value in given.items() if value is not None}


def _whole_name(color: str | None) -> str | None:
    """Return a topic as it is, and the path of a file from the root."""
    return str(Path(color).resolve()) if color and Path(color).exists() else color or None


def replay_fault(replay: ReplayNode | None) -> str:
    """Describe why the source was not played completely; "" if it was."""
    if replay is None:
        return ""
    if replay.outcome == "failed":
        return f"failed: {replay.failure}"
    if replay.unreadable:
        if replay.unreadable == 1:
            return f"1 entry could not be read: {replay.first_refusal}"
        return f"{replay.unreadable} entries could not be read, first {replay.first_refusal}"
    return "" if replay.played.total() or replay.outcome == "stopped" else "holds no cloud and no sample"


def _watch(graph: Graph, arguments: argparse.Namespace) -> bool:
    """Draw until the end of the source, N answers, or Ctrl-C; False if answers are missing."""
    replay, count = graph.replay, arguments.count

    def ended() -> bool:
        if arguments.lines is not None and arguments.lines.fault is not None:
            raise arguments.lines.fault
        return (replay is not None and replay.ended.is_set()) or (count is not None and graph.answered() >= count)

    def panel() -> Panel:
        waiting = f"waiting for the first: {_source_state(graph)}"
        return live_panel(graph.monitor.view(), f"foretouch run: {arguments.source} (Ctrl-C to end)", waiting)

    def report() -> None:
        if not graph.played():
            warn(f"waiting for the first cloud: {_source_state(graph)}")
        elif not arguments.json:
            warn(f"{graph.answered()}{f' of {count}' if count else ''} clouds answered")

    try:
        watch(ended, None if arguments.json else panel, report, every_s=5.0)
    except KeyboardInterrupt:
        arguments.state = _source_state(graph)  # a source that was stopped is neither absent nor stalled
        graph.stop_source()  # or answers would still arrive after the counts
        return True
    announce("waiting for the last answers")
    if replay is None or not replay.ended.is_set():
        graph.stop_source()
    graph.wait_for_hand(timeout_s=10.0)
    # A live source does not wait for answers: the nodes count what they had to drop.
    return replay is None or graph.wait_for_answers(min(graph.played(), count or graph.played()))


def _source_state(graph: Graph) -> str:
    """Return what the source does, or what keeps it from sending."""
    source = graph.nodes[next(name for name in ("replay", "camera", "perception") if name in graph.nodes)]
    received_nothing = ", and has received nothing" if source.get_name() == "perception" else ""
    return "; ".join(source.reported().errors) or f"{source.get_name()} is {source.state_name}{received_nothing}"


def _finish(graph: Graph, arguments: argparse.Namespace, *, complete: bool) -> int:
    """Print the table or the counts, and save the picture."""
    time.sleep(1.2)  # until every node has reported once more
    view = graph.monitor.close_view()
    answered, played = sum(view.answers.values()), graph.played()
    conflicts = graph.conflicts()
    if arguments.json:
        counts = {"played": played, "answered": answered, "conflicts": conflicts}
        counts |= {"answers": view.answers, "reasons": view.reasons}
        if "hand" in graph.nodes:
            counts["executed"] = cast("Any", graph.nodes["hand"]).executed
        _print_end(arguments.lines, counts)
    else:
        answers = f"{answered} of {played} clouds answered"
        if conflicts:
            answers = f"{answered} answers of more than one graph"
        elif complete and played > answered:
            answers += f", {played - answered} dropped or unfinished at the end"
        terminal().print(live_panel(view, f"foretouch run: {arguments.source}, {answers}"))
    if arguments.picture:
        _draw(graph.monitor.last_drawables(), arguments, view.sensor)
    if graph.replay is None and not played:
        _warn_of_no_cloud(graph, arguments)
        return 3
    untouched = at_rest(view.executed and view.executed[1])
    if untouched:
        warn("the last executed grasp touched nothing: its readings are those at rest")
    if fault := replay_fault(graph.replay):
        warn(f"{arguments.source}: {fault}")
    if not complete:
        warn(f"{played - answered} of {played} clouds were not answered")
    predicted = view.answers.get("ok", 0) + view.answers.get("initial_points", 0)
    if not predicted and "camera" in graph.nodes:
        for cause in graph.nodes["camera"].reported().warnings:
            warn(f"no prediction: {cause}")
    return 0 if complete and not fault and not untouched and (predicted or not answered) else 1


def _warn_of_no_cloud(graph: Graph, arguments: argparse.Namespace) -> None:
    """Say which source gave no cloud, and in which state it is."""
    source = arguments.source
    if "hand" in graph.nodes:
        source = "the scene"
    elif "camera" in graph.nodes:
        source = "the camera"
    state = getattr(arguments, "state", _source_state(graph))
    cure = (
        "; of a camera that is no RealSense, give the topic of its driver as --source" if source == "the camera" else ""
    )
    warn(f"no cloud came from {source}: {state}{cure}")


def _draw(drawables: Sequence[Drawable], arguments: argparse.Namespace, sensor: Sensor) -> None:
    from foretouch.report.touch_figure import save_touch_picture

    path = arguments.picture
    if not drawables:
        warn(f"{path}: not drawn, because there was no prediction in the frame of its cloud")
        return
    model = None
    with suppress(ForetouchError):  # which its node has reported
        model = load_model(arguments.model or drawables[0][2].model, arguments.predictor)
    save_touch_picture(path, [_drawn(drawable, sensor, model) for drawable in drawables], sensor)
    warn(f"wrote {path}")


def _drawn(drawable: Drawable, sensor: Sensor, model: TouchModel | None) -> DrawnGrasp:
    from foretouch.report.touch_figure import DrawnGrasp
    from foretouch.ros.messages.conversions import prediction_from_msg, reference_text

    scene, target, message, sample = drawable
    prediction = prediction_from_msg(message, sensor)
    title = f"object {target.id}"
    if prediction.ok:
        first = ["before the first touch"] if sample is not None and not message.touches else []
        based = [*first, f"based on {reference_text(message)}", *prediction.flags]
        nothing = "; touched nothing: the readings are those at rest" if at_rest(sample) else ""
        title += f": {', '.join(based)}; model: {message.model}{nothing}"
    drawn = DrawnGrasp(target=target, prediction=prediction, scene=scene, title=title)
    if sample is None:
        return drawn
    drawn = replace(drawn, rest=sample.tare, read=sample.touch)
    if model is None or not (message.touches and prediction.ok):
        return drawn
    history = History(model)  # of a hand that has touched nothing
    if sample.tare is not None:
        history.tare(sample.tare, stamp_ns=sample.stamp_ns)
    (earlier,) = history.predict(target, [prediction.grasp], stamp_ns=sample.stamp_ns)
    return replace(drawn, earlier=earlier)


def at_rest(sample: Sample | None) -> bool:
    """Return whether a grasp was executed, and no finger in contact."""
    if sample is None or sample.touch is None:
        return False
    return all(f"no_contact_{finger}" in sample.flags for finger in sample.touch.channels.fingers)


def _printed(sensor: Sensor, item: TouchPredictionArray | dict[str, Any]) -> Mapping[str, Any]:
    """Return the line of an answer, or of the counts at the end."""
    return item if isinstance(item, dict) else answer_record(item, sensor)


def _print_end(lines: JsonLines, counts: dict[str, Any]) -> None:
    """Print the counts as the last line, if somebody reads, within a few seconds."""
    counts |= {"not_printed": lines.dropped} if lines.dropped else {}
    lines.put(counts)
    if not lines.close(_END_S):
        warn(f"{lines.dropped} lines were not printed: nobody reads them")
