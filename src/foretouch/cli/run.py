# SPDX-License-Identifier: Apache-2.0
"""`foretouch run`: a source, the whole graph and a live table in one terminal."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.cli.output import print_json, warn
from foretouch.errors import ForetouchError

if TYPE_CHECKING:
    from foretouch.ros.graph import Graph
    from foretouch.ros.nodes.replay import ReplayNode

__all__ = ["add_arguments", "replay_fault", "replay_parameters", "run"]

_REFRESH_S = 0.2
_DIAGNOSED_S = 1.2  # by then every node has reported once more, all that it did
_SCENE_FILES = (".yaml", ".yml")
_SCENE_FPS = 5  # leaves a small machine time for the rest of the graph
_LONGEST_GRASP_S = 10.0
_NEAR_M = 0.1  # of the middle of a scene's object, to what is seen of it
_PATIENT = {"camera.timeouts.stall_s": 5.0, "camera.timeouts.reopen_s": 20.0}  # a busy machine renders slowly


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the clouds come from, and what is made of the answers."""
    parser.add_argument(
        "--source",
        required=True,
        metavar="DIR|FILE|SCENE|camera",
        help="clouds or samples, a recording, a scene (.yaml) with a simulated camera and hand, or the RealSense",
    )
    parser.add_argument("--topic", help="which topic of a recording holds the clouds")
    parser.add_argument("--serial", help="serial number of the camera")
    parser.add_argument(
        "--rate",
        type=float,
        metavar="HZ",
        help="clouds a second (default: recorded times; files one by one; 5 of a scene)",
    )
    parser.add_argument("--dwell", type=float, metavar="S", help="how long each object of a scene stays (default: 3)")
    parser.add_argument("--count", type=int, metavar="N", help="end after so many answered clouds")
    parser.add_argument("--plane", metavar="a,b,c,d", help="table of clouds that hold one object each")
    parser.add_argument("--model", help="name of a shipped model, or path of a checkpoint")
    parser.add_argument("--params", metavar="YAML", help="ROS parameter file for all nodes")
    parser.add_argument("--namespace", help="of the graph (default: /foretouch)")
    parser.add_argument("--picture", metavar="PNG", help="draw the last prediction at the end")
    parser.add_argument("--json", action="store_true", help="one JSON object a cloud, and a last line with the counts")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a node did not start, a cloud went unanswered, or none gave a prediction."""
    from foretouch.ros.graph import Graph

    nodes = _nodes(arguments)
    monitor: dict[str, Any] = {"with_clouds": arguments.picture is not None, "with_hand": "hand" in nodes}
    if arguments.json:
        monitor["on_touch"] = _print_answer
    graph = Graph(nodes, namespace=arguments.namespace, params_file=arguments.params, monitor=monitor)
    with graph:
        if not graph.started:
            raise ForetouchError("; ".join(_refusals(graph)) or "a node did not start; its log tells why")
        complete = _watch(graph, arguments)
        return _finish(graph, arguments, complete=complete)


def _nodes(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Node names with the parameters that the options stand for; the source last, when all others listen."""
    from foretouch.ros.executables import PERCEPTION

    nodes: dict[str, dict[str, Any]] = {name: {} for name in PERCEPTION}
    if arguments.model:
        nodes["touch_predictor"]["model"] = str(arguments.model)
    if arguments.source == "camera":
        nodes["camera"] = {"camera.serial": arguments.serial} if arguments.serial else {}
        return nodes
    if Path(arguments.source).suffix in _SCENE_FILES:
        for name, parameters in _scene_nodes(arguments).items():
            nodes.setdefault(name, {}).update(parameters)
        return nodes
    nodes["replay"] = replay_parameters(arguments, arguments.source)
    return nodes


def _scene_nodes(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """A hand and a camera before one scene, whose first object is there from now on."""
    from foretouch.simulation.show import ShowConfig, middle_of

    show = ShowConfig(path=str(Path(arguments.source).resolve()), origin_ns=time.time_ns())
    if arguments.dwell is not None:
        show = show.replace(dwell_s=arguments.dwell)
    scene = show.load()  # a mistake in it is told before anything starts
    shown = {f"scene.{name}": value for name, value in show.to_mapping().items()}
    fps = _SCENE_FPS if arguments.rate is None else max(1, round(arguments.rate))
    nodes = {"hand": shown, "camera": {"source": "scene", "camera.fps": fps, **_PATIENT, **shown}}
    if scene.clutter is not None:  # nothing is known of how clutter feels, so only the object is grasped
        point = middle_of(scene).tolist()
        nodes["segmentation"] = {"target.mode": "point", "target.point": point, "target.tolerance_m": _NEAR_M}
    return nodes


def replay_parameters(arguments: argparse.Namespace, path: str) -> dict[str, Any]:
    """Parameters of the replay: files are played one by one, as fast as they are answered, unless a rate is given."""
    from foretouch.cli.inputs import four_numbers
    from foretouch.dataset.source import open_source

    parameters: dict[str, Any] = {"path": str(Path(path).resolve())}
    one_by_one = arguments.rate is None and open_source(path, arguments.topic).kind != "recording"
    if one_by_one:
        parameters |= {"lockstep": True, "rate_hz": 1000.0}
    if arguments.rate is not None:
        parameters["rate_hz"] = arguments.rate
    if arguments.topic:
        parameters["topic"] = arguments.topic
    if arguments.plane:
        parameters["table"] = four_numbers(arguments.plane)
    return parameters


def replay_fault(replay: ReplayNode | None) -> str | None:
    """What was wrong with the source, in words; None if all of it was played."""
    if replay is None:
        return None
    if replay.outcome == "failed":
        return f"broke off: {replay.reason}"
    return f"{replay.unreadable} entries could not be read" if replay.unreadable else None


def _watch(graph: Graph, arguments: argparse.Namespace) -> bool:
    """Draw until the source has ended and is answered, enough is answered, or Ctrl-C; False if answers are missing."""
    replay, count = graph.replay, arguments.count

    def ended() -> bool:
        return (replay is not None and replay.ended.is_set()) or (count is not None and graph.answered() >= count)

    title = f"foretouch run: {arguments.source} (Ctrl-C ends it)"
    try:
        if arguments.json or not sys.stdout.isatty():
            while not ended():
                time.sleep(_REFRESH_S)
        else:
            _draw_until(ended, graph, title)
    except KeyboardInterrupt:
        graph.stop_source()  # or answers would still come after the counts
        return True
    if replay is None or not replay.ended.is_set():
        graph.stop_source()
    graph.wait_for_hand(_LONGEST_GRASP_S)
    # A live source does not wait to be answered: what it sent too fast is counted by the nodes as dropped.
    return replay is None or graph.wait_for_answers(graph.played())


def _draw_until(ended: Callable[[], bool], graph: Graph, title: str) -> None:
    from rich.live import Live

    from foretouch.cli.live import live_panel

    with Live(refresh_per_second=1 / _REFRESH_S, transient=True) as live:
        while not ended():
            live.update(live_panel(graph.monitor.view(), title))
            time.sleep(_REFRESH_S)


def _finish(graph: Graph, arguments: argparse.Namespace, *, complete: bool) -> int:
    """The last words: a table or a line of counts, and the picture."""
    time.sleep(_DIAGNOSED_S)
    view = graph.monitor.view()
    answered, played = sum(view.answers.values()), graph.played()
    if arguments.json:
        counts = {
            "played": played,
            "answered": answered,
            "answers": dict(view.answers),
            "reasons": dict(view.reasons),
        }
        print_json(counts | ({"executed": graph.executed()} if "hand" in graph.nodes else {}))
    else:
        from rich.console import Console

        from foretouch.cli.live import live_panel

        Console().print(
            live_panel(view, f"foretouch run: {arguments.source}, {played} clouds played, {answered} answered")
        )
    if arguments.picture:
        _draw(graph, arguments.picture)
    if (fault := replay_fault(graph.replay)) is not None:
        warn(f"{arguments.source}: {fault}")
    if not complete:
        warn(f"{played - answered} of {played} clouds were not answered")
    predicted = view.answers.get("ok", 0) + view.answers.get("initial_points", 0)
    whole = complete and replay_fault(graph.replay) is None
    return 0 if whole and (predicted or not answered) else 1


def _draw(graph: Graph, path: str) -> None:
    from foretouch.report.touch_figure import save_touch_picture
    from foretouch.ros.messages.conversions import prediction_from_msg, reference_text

    found = graph.monitor.last_drawable()
    if found is None:
        warn(f"{path}: not drawn, for there was no prediction")
        return
    prediction, felt = prediction_from_msg(found.prediction), found.readings
    title = f"object {found.target.id}"
    if prediction.value is not None:
        title += f", predicted by {found.prediction.model} from {reference_text(found.prediction)}"
        title += "".join(f", {flag}" for flag in prediction.flags)
    save_touch_picture(
        path,
        found.scene,
        found.target,
        prediction,
        rest=None if felt is None else felt.tare,
        read=None if felt is None else felt.touch,
        title=title if felt is None else f"{title}; read by the simulated hand",
    )
    warn(f"wrote {path}")


def _refusals(graph: Graph) -> list[str]:
    return [f"{name}: {node.state_name}" for name, node in graph.nodes.items() if node.state_name != "active"]


def _print_answer(message: Any) -> None:
    from foretouch.cli.predict import prediction_record
    from foretouch.ros.messages.conversions import prediction_from_msg, stamp_ns
    from foretouch.ros.messages.status import status_name

    print_json(
        {
            "stamp_ns": stamp_ns(message.header.stamp),
            "frame_id": message.header.frame_id,
            "status": status_name(message.status),
            "reason": message.reason,
            "predictions": [prediction_record(prediction_from_msg(one)) for one in message.predictions],
        }
    )
