# SPDX-License-Identifier: Apache-2.0
"""The inputs that `segment`, `grasp` and `predict` share: files, folders and recordings, one line of output each."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from foretouch.cli.output import print_json, warn
from foretouch.config import load_yaml, parse_overrides
from foretouch.errors import CloudError, ForetouchError

if TYPE_CHECKING:
    from foretouch.dataset.source import SourceItem
    from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
    from foretouch.types import Grasp

__all__ = [
    "Record",
    "add_input_arguments",
    "add_plan_arguments",
    "answer_each",
    "found_objects",
    "four_numbers",
    "grasp_record",
    "pipeline_config",
    "positive_number",
    "six_numbers",
]

Record = dict[str, Any]


def add_input_arguments(parser: argparse.ArgumentParser) -> None:
    """IN…, --topic, --config, --set and --json."""
    parser.add_argument("inputs", metavar="IN", nargs="+", help=".pcd .ply .npz .npy, a folder of them, or a recording")
    parser.add_argument("--topic", help="which topic of a recording holds the clouds")
    parser.add_argument("--config", metavar="YAML", help="settings of the pipeline")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="one setting, after --config")
    parser.add_argument("--json", action="store_true", help="one JSON object a line on stdout, and nothing else there")


def add_plan_arguments(parser: argparse.ArgumentParser) -> None:
    """--plane, --scene, --target: what the cloud holds and where its table is."""
    parser.add_argument(
        "--plane",
        type=four_numbers,
        metavar="a,b,c,d",
        help="table ax+by+cz+d=0; the cloud then holds the object alone",
    )
    parser.add_argument(
        "--scene", action="store_true", help="find the table and the objects of an unorganised cloud too"
    )
    parser.add_argument("--target", choices=["nearest", "largest", "all"], help="which object of a scene")


def four_numbers(text: str) -> list[float]:
    """`a,b,c,d` for argparse."""
    return _numbers(text, 4)


def six_numbers(text: str) -> list[float]:
    """`x1,y1,z1,x2,y2,z2` for argparse."""
    return _numbers(text, 6)


def positive_number(text: str) -> int:
    """A whole number from 1 on, for argparse."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not 1 or more")
    return value


def pipeline_config(arguments: argparse.Namespace, changes: dict[str, Any] | None = None) -> PipelineConfig:
    """Defaults, then --config, then --set, then the command's own options.

    Args:
        arguments: With `config`, `set` and maybe `target`.
        changes: Dotted settings from the command's own options.
    """
    from foretouch.pipeline import PipelineConfig

    settings: dict[str, Any] = load_yaml(arguments.config) if arguments.config else {}
    config = PipelineConfig.from_mapping(settings, arguments.config or "")
    target = {"target.mode": arguments.target} if getattr(arguments, "target", None) else {}
    for source, layer in (("--set", parse_overrides(arguments.set)), ("options", {**target, **(changes or {})})):
        config = config.updated(layer, source)
    return config


def found_objects(item: SourceItem, arguments: argparse.Namespace, pipeline: Pipeline) -> list[FoundObject]:
    """What is to be grasped in one input: the cloud itself, or the targets of its scene.

    An organised cloud, or any with --scene, is a scene; otherwise the cloud is one object, which
    stands on --plane or, by assumption, on a table seen from straight above.

    Raises:
        CloudError: If a scene holds no target.
    """
    from foretouch.pipeline import ASSUMED_TABLE, FoundObject
    from foretouch.types import Plane

    if arguments.plane is not None:
        return [FoundObject("1", item.cloud, Plane.from_coefficients(arguments.plane))]
    if not (arguments.scene or item.cloud.organised):
        return [FoundObject("1", item.cloud, ASSUMED_TABLE)]
    sight = pipeline.see(item.cloud)
    if not sight.targets:
        raise CloudError(f"{sight.status}: {sight.reason}")
    return list(sight.targets)


def grasp_record(grasp: Grasp) -> Record:
    """A grasp as JSON holds it: contacts [m], rotation row-major, score (null where GeoGrasp gives none)."""
    return {"g1": grasp.g1, "g2": grasp.g2, "rotation": grasp.rotation.reshape(9), "score": grasp.score}


def answer_each(
    arguments: argparse.Namespace, answer: Callable[[SourceItem], Iterator[Record]], show: Callable[[Record], None]
) -> int:
    """Print the answers for every input, in order; a refused one gets its line and makes the exit status 1.

    Args:
        arguments: With `inputs`, `topic` and `json`.
        answer: Yields the records of one cloud; a record whose `status` is refused counts as a failure.
        show: Prints a record for a person.
    """
    from foretouch.dataset.source import open_source

    failed = False
    for path in arguments.inputs:
        try:
            for item in open_source(path, topic=arguments.topic):
                failed |= _answer_item(item, arguments.json, answer, show)
        except ForetouchError as err:
            failed = True
            _refuse(path, err, as_json=arguments.json)
    return int(failed)


def _answer_item(
    item: SourceItem, as_json: bool, answer: Callable[[SourceItem], Iterator[Record]], show: Callable[[Record], None]
) -> bool:
    failed = False
    try:
        for record in answer(item):
            failed |= record.pop("failed", False)
            if as_json:
                print_json({"input": item.name, **record})
            else:
                show({"input": item.name, **record})
    except ForetouchError as err:
        _refuse(item.name, err, as_json=as_json)
        return True
    return failed


def _refuse(name: str, err: ForetouchError, *, as_json: bool) -> None:
    reason = str(err)
    if as_json:
        print_json({"input": name, "status": "refused", "reason": reason})
    warn(reason if name in reason else f"{name}: {reason}")


def _numbers(text: str, count: int) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise argparse.ArgumentTypeError(f"{text!r} is not {count} numbers with commas between them")
    return numbers
