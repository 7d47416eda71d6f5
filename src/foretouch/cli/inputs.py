# SPDX-License-Identifier: Apache-2.0
"""Shared by `segment`, `grasp` and `predict`: arguments, input files, folders and recordings, one result per cloud."""

import argparse
import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from typing import Any, Final

from foretouch.cli.output import print_json, warn
from foretouch.config import load_yaml, parse_overrides
from foretouch.dataset.source import SourceItem, open_source
from foretouch.errors import CloudError, ForetouchError
from foretouch.pipeline import Object, Pipeline, PipelineConfig
from foretouch.types import Cloud, Plane, assumed_table

Record = dict[str, Any]

ADDRESS_HELP: Final = "run on Ray: auto, ray://host:port, or local for a node on this machine (default: not on Ray)"
"""Help on `--address` of the commands that can use a cluster."""


def numbers(text: str, count: int = 4) -> list[float]:
    """Numbers with commas between them for argparse, such as `a,b,c,d`."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count:
        raise argparse.ArgumentTypeError(f"{text!r} is not {count} numbers with commas between them")
    return found


def positive_number(text: str, minimum: int = 1) -> int:
    """A whole number of 1 or more for argparse."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if value < minimum:
        raise argparse.ArgumentTypeError(f"{value} is not {minimum} or more")
    return value


seed_number = partial(positive_number, minimum=0)
"""A whole number of 0 or more for argparse."""


def positive_value(text: str, *, or_zero: bool = False) -> float:
    """A finite number above 0 for argparse, such as a rate or a time."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    if value < 0.0 or (value == 0.0 and not or_zero):
        raise argparse.ArgumentTypeError(f"{text} is not {'0 or more' if or_zero else 'above 0'}")
    return value


_REPEATED: dict[str, Any] = {"action": "append", "default": []}

_OPTIONS: dict[str, dict[str, Any]] = {
    "inputs": {
        "metavar": "IN",
        "nargs": "+",
        "help": "cloud file (.pcd, .ply, .npz or .npy), folder of cloud files, dataset or recording",
    },
    "--topic": {"help": "point cloud topic of a recording (default: its only one)"},
    "--config": {"metavar": "YAML", "help": "file with settings of the pipeline"},
    "--set": {"metavar": "KEY=VALUE", **_REPEATED, "help": "change one setting of the pipeline"},
    "--plane": {
        "type": numbers,
        "metavar": "a,b,c,d",
        "help": "table ax+by+cz+d=0 [m]; the cloud then contains only the object (default: found in the cloud)",
    },
    "--scene": {"action": "store_true", "help": "find table and objects in unorganised clouds too"},
    "--target": {
        "choices": ["nearest", "largest", "free", "all"],
        "help": "objects of a cloud to use; free is the nearest whose best grasp no other object blocks (default: nearest; all for predict)",
    },
    "--tare": {
        "metavar": "F|sample",
        **_REPEATED,
        "help": "reading without contact, taken shortly before: JSON with the modalities in lower case (pdc_th, pdc_mf, e_th [24], e_mf [24] and optionally tdc_th, "
        "tdc_mf of the BioTac SP), a list of such, or a vision2tactile tactile.tac; the median of several. `sample`: use each sample's own, for inputs that are datasets",
    },
    "--touched": {
        "metavar": "PATH",
        **_REPEATED,
        "help": "executed grasps of the same object with their readings (a dataset, a training store, vision2tactile folders): "
        "adapt the predictions to all labelled ones, except the sample that is predicted",
    },
    "--history": {
        "metavar": "PATH",
        **_REPEATED,
        "help": "executed grasps of any objects with their readings, earlier ones of the same hand (as --touched), or the file of a hand that "
        "the touch_predictor keeps: adapt the predictions to the state of its sensors",
    },
    "--model": {
        "help": "name of a model, or path of its card, weights or model folder (default: contact-v2; of `run` with a scene: simulated)"
    },
    "--params": {"metavar": "YAML", "help": "ROS parameter file for all nodes"},
    "--sensor": {
        "metavar": "NAME|YAML",
        "help": "description of the tactile sensor, with the type of its messages (default: BioTac SP; `sensor list` names"
        " those of the package)",
    },
    "--thumb": {
        "metavar": "NAME",
        "help": "name of the thumb in the tactile messages (default: TH or 0, by their type, or that of the sensor)",
    },
    "--middle": {"metavar": "NAME", "help": "name of the middle finger, or the other one (default: MF or 1)"},
    "--namespace": {"metavar": "NAME", "help": "namespace of the graph (default: /foretouch)"},
}
"""Arguments that several commands share, by name."""

READ: Final = ("inputs", "--topic", "--config", "--set")
PLANNED: Final = ("--plane", "--scene", "--target")
ADAPTED: Final = ("--tare", "--touched", "--history")


def add_options(parser: argparse._ActionsContainer, *names: str) -> None:
    """Add arguments that several commands share, such as `--topic`."""
    for name in names:
        parser.add_argument(name, **_OPTIONS[name])


def pipeline_config(
    arguments: argparse.Namespace, changes: dict[str, Any] | None = None, defaults: dict[str, Any] | None = None
) -> PipelineConfig:
    """Pipeline settings from the command's `defaults`, --config, --set and its own options, in this order.

    Settings have dotted names; of the options, and of the `changes` that a command makes of others, None changes nothing.
    """
    config = PipelineConfig().updated(defaults or {})
    if arguments.config:
        config = config.updated(load_yaml(arguments.config), arguments.config)
    given = {"target.mode": getattr(arguments, "target", None), "model": getattr(arguments, "model", None) or None}
    options = {name: value for name, value in (given | (changes or {})).items() if value is not None}
    return config.updated(parse_overrides(arguments.set), "--set").updated(options, "options")


def target_objects(item: SourceItem, arguments: argparse.Namespace, pipeline: Pipeline) -> list[Object]:
    """The objects to grasp in one input: the cloud itself, or the targets of its scene; a `CloudError` if it has none.

    An organised cloud, or any with --scene, is a scene; otherwise the cloud is one object
    on --plane or on an assumed table, seen from straight above.
    """
    if holds_one_object(item.cloud, arguments):
        return [only_object(item.cloud, arguments)]
    scene = pipeline.segment(item.cloud)
    if not scene.targets:
        raise CloudError(f"{scene.status}: {scene.reason}")
    return list(scene.targets)


def holds_one_object(cloud: Cloud, arguments: argparse.Namespace) -> bool:
    """Whether a cloud is one object, by the rule of `target_objects`."""
    return arguments.plane is not None or not (arguments.scene or cloud.organised)


def only_object(cloud: Cloud, arguments: argparse.Namespace) -> Object:
    """A cloud as one object, on --plane or on an assumed table."""
    table = assumed_table(cloud) if arguments.plane is None else Plane.from_coefficients(arguments.plane)
    return Object("1", cloud, table)


def heading(record: Record, by: str = "") -> str:
    """What is printed above a table: input, object and status; a remark follows in a line of its own."""
    status = "" if record["status"] == "ok" else f": {record['status'].replace('_', ' ')}"
    remark = f"\n{record['reason']}" if record["reason"] else ""
    return f"{record['input']}, object {record['object']}{by}{status}{remark}"


def process_inputs(
    arguments: argparse.Namespace, process: Callable[[SourceItem], Iterator[Record]], show: Callable[[Record], None]
) -> int:
    """Print the results of all inputs in order; returns exit status 1 if one was refused or failed.

    `process` yields the records of one cloud, of which those with `failed` set are failures; `show` is used without --json.
    """
    failed = False
    for name, result in chain.from_iterable(_results(path, arguments.topic, process) for path in arguments.inputs):
        if isinstance(result, ForetouchError):
            failed = True
            if arguments.json:
                print_json({"input": name, "status": "refused", "reason": str(result)})
            warn(error_line(name, result))
        else:
            failed |= result.pop("failed", False)
            (print_json if arguments.json else show)({"input": name, **result})
    return int(failed)


def _results(
    path: str, topic: str | None, process: Callable[[SourceItem], Iterator[Record]]
) -> Iterator[tuple[str, Record | ForetouchError]]:
    """The records of each cloud, or why it was refused."""
    try:
        source = open_source(path, topic=topic)
        for note in source.notes:
            warn(note)
        for item in source:
            try:
                for record in process(item):
                    yield item.name, record
            except ForetouchError as err:
                yield item.name, err
    except ForetouchError as err:
        yield path, err


def error_line(name: str, err: ForetouchError) -> str:
    """The message of an error, with the name of the input where it lacks it."""
    return str(err) if name in str(err) else f"{name}: {err}"
