# SPDX-License-Identifier: Apache-2.0
"""Shared by `segment`, `grasp` and `predict`: arguments, input files, folders and recordings, one result per cloud."""

import argparse
import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final

from foretouch.base.files import PICTURE_SUFFIXES, require_writable
from foretouch.cli.output import print_json, warn
from foretouch.cli.parser import CommandParser, one_of
from foretouch.cloud.io.depth_files import PAIRING, DepthCamera
from foretouch.cloud.io.mask_files import read_mask
from foretouch.config import load_yaml, parse_overrides
from foretouch.dataset.source import SourceItem, open_source
from foretouch.errors import CloudError, ConfigError, ForetouchError, shown
from foretouch.pipeline import Pipeline
from foretouch.stream import Stream, StreamConfig
from foretouch.types import Cloud, Plane, Sample, assumed_table
from foretouch.types.scene import Object, Scene

Record = dict[str, Any]

ADDRESS_HELP: Final = "run on Ray: auto, ray://host:port, or local for a node on this machine (default: not on Ray)"
"""Help on `--address` of the commands that can use a cluster."""


def numbers(text: str, count: int = 4) -> list[float]:
    """Return numbers with commas between them for argparse, such as `a,b,c,d`."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise argparse.ArgumentTypeError(f"{text!r} is not {count} numbers with commas between them")
    return values


def positive_number(text: str, minimum: int = 1) -> int:
    """Return a whole number of 1 or more for argparse."""
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
    """Return a finite number above 0 for argparse, such as a rate or a time."""
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
        "help": f"cloud file (.pcd, .ply, .npz or .npy), depth image (.png, .tif, .npz or .npy), folder of these, dataset or recording; {PAIRING}",
    },
    "--topic": {"help": "topic of point clouds or depth images of a recording (default: its only one)"},
    "--config": {"metavar": "YAML", "help": "file with settings of the pipeline"},
    "--set": {
        "metavar": "KEY=VALUE",
        **_REPEATED,
        "help": "change one setting of the pipeline; preset=fast or exact changes several (docs/accuracy_vs_time.md)",
    },
    "--plane": {
        "type": numbers,
        "metavar": "a,b,c,d",
        "help": "table ax+by+cz+d=0 [m]; the cloud then contains only the object (default: found in the cloud)",
    },
    "--hand": {
        "metavar": "NAME|YAML",
        "help": "hand or gripper that must find a way to the object (default: two_tips; `hand list` names the others)",
    },
    "--scene": {"action": "store_true", "help": "find table and objects in unorganised clouds too"},
    "--target": {
        "type": one_of("nearest", "largest", "free", "all"),
        "metavar": "{nearest,largest,free,all}",
        "help": "objects of a cloud to use; nearest: the nearest of the objects that are most surely whole; free: the nearest whose best grasp no other object blocks (default: nearest; all for predict)",
    },
    "--intrinsics": {
        "type": numbers,
        "metavar": "fx,fy,cx,cy",
        "help": "intrinsics of the depth images [pixels], without distortion (default: what the file, folder or recording states)",
    },
    "--camera-info": {
        "type": Path,
        "metavar": "FILE",
        "help": "camera of the depth images: YAML of ROS or OpenCV, JSON of RealSense, Open3D or BOP, meta.mat of GraspNet, or a matrix as text",
    },
    "--info-topic": {
        "metavar": "TOPIC",
        "help": "topic of the camera infos of a recording (default: camera_info beside the images, or the only one that fits them)",
    },
    "--rectified": {
        "type": one_of("yes", "no"),
        "metavar": "{yes,no}",
        "help": "whether the depth images are rectified, so that P of their camera describes them (default: by their name, image_rect…)",
    },
    "--depth-scale": {
        "type": positive_value,
        "metavar": "M",
        "help": "metres per unit of the depth images (default: what the file or recording states, else 0.001 for 16 bits, 1 for floats)",
    },
    "--color": {
        "metavar": "FILE|TOPIC",
        "help": "colours of the pixels: of a single depth image a .png or .jpg of its size, aligned with it; of a recording a topic. They are drawn, and models "
        "of `xyz+rgb` use them (default: what the file, folder or recording states)",
    },
    "--mask": {
        "metavar": "FILE",
        "help": "labels of the objects in the image of a single input (.png with a label a pixel, .npy, or .npz with `mask`, `label` or `segmap`): they become the "
        "objects, with their labels as ids, on the table that is found in the rest; 0 is no object",
    },
    "--pixel": {
        "metavar": "u,v",
        "type": partial(numbers, count=2),
        "help": "use the object at this column and row of the image",
    },
    "--point": {
        "metavar": "x,y,z",
        "type": partial(numbers, count=3),
        "help": "use the object at this point [m], in the frame of the cloud",
    },
    "--picture": {
        "metavar": "FILE",
        "help": "draw the result of a single input: the image with its objects, its touch on both fingers, and the best grasp from two sides (.png, .pdf, .svg or .jpg)",
    },
    "--panels": {
        "metavar": "NAMES",
        "type": lambda text: tuple(text.split(",")),
        "help": "which panels --picture has, by commas: image, touch, above, side (default: all that there is something to show in)",
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
        "`perception` keeps: adapt the predictions to the state of its sensors",
    },
    "--model": {
        "help": "name of a model, or path of its card, weights or model folder; networks for different modalities are joined by commas"
        " (default: contact-v3; of `run` with a scene: simulated)"
    },
    "--predictor": {
        "metavar": "NAME",
        "help": "predictor of a model of your own, whose code is imported: module:attribute, or an entry point of foretouch.models",
    },
    "--params": {"metavar": "YAML", "help": "ROS parameter file for all nodes"},
    "--sensor": {
        "metavar": "NAME|YAML",
        "help": "description of the tactile sensor, with the type of its messages (default: BioTac SP; `sensor list` names"
        " those of the package)",
    },
    "--thumb": {
        "metavar": "NAME",
        "help": "name of the thumb in the tactile messages (default: TH or 0, by their type, or the sensor's)",
    },
    "--middle": {"metavar": "NAME", "help": "name of the middle finger, or the other one (default: MF or 1)"},
    "--namespace": {"metavar": "NAME", "help": "namespace of the graph (default: /foretouch)"},
}
"""Arguments that several commands share, by name."""

CAMERA: Final = ("--intrinsics", "--camera-info", "--info-topic", "--rectified", "--depth-scale", "--color")
READ: Final = ("inputs", "--topic", "--config", "--set", *CAMERA, "--mask", "--picture", "--panels")
PLANNED: Final = ("--plane", "--scene", "--target", "--hand")
CHOSEN: Final = ("--pixel", "--point")
ADAPTED: Final = ("--tare", "--touched", "--history")


def add_options(parser: CommandParser, *names: str, group: Any = None) -> None:
    """Add arguments that several commands share.

    Args:
        parser: Parser of a command.
        names: Their names, such as `--topic`.
        group: Group that they belong to, or None for their headings.
    """
    for name in names:
        parser.add_argument(name, group=group, **_OPTIONS[name])


_OPTION_OF = {
    "target.mode": "--target",
    "hand.name": "--hand",
    "model": "--model",
    "predictor": "--predictor",
    "grasp.tip_mm": "--tip-mm",
    "grasp.count": "--count",
}


def pipeline_config(
    arguments: argparse.Namespace, changes: dict[str, Any] | None = None, defaults: dict[str, Any] | None = None
) -> StreamConfig:
    """Return the settings of a pipeline, or of a stream, from the command's `defaults`, --config, --set and its own options, in this order.

    Settings have dotted names; of the options, and of the `changes` that a command makes of others, None changes nothing.
    """
    config = StreamConfig().updated(defaults or {})
    if arguments.config:
        stated = load_yaml(arguments.config)
        if not stated:
            warn(f"{arguments.config}: holds no settings: the defaults apply")
        config = config.updated(stated, arguments.config)
    given = {
        "target.mode": getattr(arguments, "target", None),
        "hand.name": getattr(arguments, "hand", None),
        "model": getattr(arguments, "model", None) or None,
        "predictor": getattr(arguments, "predictor", None),
    }
    config = config.updated(parse_overrides(arguments.set), "--set")
    for name, value in (given | (changes or {})).items():
        if value is not None:
            config = config.updated({name: value}, _OPTION_OF[name])
    return config


def depth_camera(arguments: argparse.Namespace) -> DepthCamera:
    """Make the camera of depth images by the options `CAMERA`; a `ConfigError` if they state it twice."""
    return DepthCamera(
        intrinsics=tuple(arguments.intrinsics or ()),
        info=arguments.camera_info,
        scale=arguments.depth_scale,
        rectified=None if arguments.rectified is None else arguments.rectified == "yes",
        info_topic=arguments.info_topic or "",
        color=arguments.color or "",
    )


def check_single(arguments: argparse.Namespace) -> None:
    """Refuse options for a single input with several, options that exclude each other, and a picture that cannot be written.

    Raises:
        ConfigError: Names the option.
    """
    for name in ("mask", "color", "picture"):
        if getattr(arguments, name) and len(arguments.inputs) > 1:
            raise ConfigError(f"--{name}: requires one input, not {len(arguments.inputs)}")
    if getattr(arguments, "pixel", None) and getattr(arguments, "point", None):
        raise ConfigError("--pixel, --point: select an object twice; give one of them")
    for name in ("scene", "mask", "pixel", "point"):
        if getattr(arguments, "plane", None) is not None and getattr(arguments, name):
            raise ConfigError(f"--plane, --{name}: with --plane the cloud is the points of one object; leave one out")
    if arguments.panels and not arguments.picture:
        raise ConfigError("--panels: is for --picture")
    if arguments.picture:
        require_writable(arguments.picture, *PICTURE_SUFFIXES)


def scene_of(
    item: SourceItem, arguments: argparse.Namespace, pipeline: Pipeline, stream: Stream | None = None
) -> Scene:
    """Return the scene of a cloud, by the labels of --mask, or of the mask beside a depth image of a folder; of a stream its next one."""
    file = arguments.mask or item.mask
    mask = read_mask(file) if file else None
    try:
        if stream is not None:
            return stream.with_target(stream.find(item.cloud, mask=mask))
        return pipeline.segment(item.cloud, mask=mask)
    except CloudError as err:
        raise CloudError(f"{file}: {err}" if file else str(err)) from err


def target_objects(
    item: SourceItem, arguments: argparse.Namespace, pipeline: Pipeline, stream: Stream | None = None
) -> tuple[list[Object], Scene | Object, str]:
    """Find the objects to grasp in one input: the cloud itself, or the targets of its scene.

    An organised cloud, or any with --scene, --mask, --pixel or --point, is a scene; otherwise the cloud is one object
    on --plane, on the table of its sample, or on an assumed table, seen from straight above.

    Returns:
        The objects, at least one; the scene that they are in, or the only object; and by what they were selected: `pixel`,
        `point`, or "" for the rule of --target.

    Raises:
        CloudError: If there is no object, or none at --pixel or --point.
    """
    if holds_one_object(item.cloud, arguments):
        if arguments.target:
            raise ConfigError("--target: is for the objects of a scene, and this cloud is one object; add --scene")
        target = only_object(item.cloud, arguments, item.sample)
        return [target], target, ""
    scene = scene_of(item, arguments, pipeline, stream)
    if not scene.objects:
        raise CloudError(f"{scene.status}: {scene.reason}")
    if arguments.pixel:
        if not all(value.is_integer() for value in arguments.pixel):
            raise CloudError(f"--pixel: {','.join(map(str, arguments.pixel))} is not two whole numbers, column and row")
        u, v = map(int, arguments.pixel)
        return [scene.at(u, v)], scene, "pixel"
    if arguments.point:
        return [scene.near(arguments.point, pipeline.config.target.tolerance_m)], scene, "point"
    if not scene.targets:
        raise CloudError(f"{scene.status}: {scene.reason}")
    return list(scene.targets), scene, ""


def holds_one_object(cloud: Cloud, arguments: argparse.Namespace) -> bool:
    """Return whether a cloud is one object, by the rule of `target_objects`."""
    chosen = any(getattr(arguments, name, None) for name in ("scene", "mask", "pixel", "point"))
    return arguments.plane is not None or not (chosen or cloud.organised)


def draw_result(arguments: argparse.Namespace, scene: Scene | Object, *drawn: Any, **options: Any) -> None:
    """Draw the picture of --picture, if the user asks for one, with the panels of --panels. Further arguments go to `draw_scene`."""
    if arguments.picture:
        from foretouch.report.scene_figure import PANELS, draw_scene

        draw_scene(scene, *drawn, path=arguments.picture, panels=arguments.panels or PANELS, **options)
        warn(f"wrote {arguments.picture}")


def only_object(cloud: Cloud, arguments: argparse.Namespace, sample: Sample | None = None) -> Object:
    """Return a cloud as one object, on --plane, on the table of its sample, or on an assumed table."""
    table = None if sample is None else sample.table
    if arguments.plane is not None:
        table = Plane.from_coefficients(arguments.plane)
    return Object.of("1", cloud, table or assumed_table(cloud))


def heading(record: Record, by: str = "") -> str:
    """Return what is printed above a table: input, object and status; a remark follows on the next line."""
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
    for name, result in chain.from_iterable(_results(path, arguments, process) for path in arguments.inputs):
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
    path: str, arguments: argparse.Namespace, process: Callable[[SourceItem], Iterator[Record]]
) -> Iterator[tuple[str, Record | ForetouchError]]:
    """Iterate over the records of each cloud, or why it was refused."""
    try:
        source = open_source(path, topic=arguments.topic, camera=depth_camera(arguments))
        for note in source.notes:
            warn(note)
        if arguments.picture and source.kind != "recording" and len(source) > 1:
            raise ConfigError(f"--picture: requires one cloud, and {path} holds {len(source)}: give one of its files")
        item = None
        for item in source:
            try:
                for record in process(item):
                    yield item.name, record
            except ForetouchError as err:
                yield item.name, err
        for remark in source.remarks:
            warn(remark)
        if item is None:
            yield path, CloudError(f"{path}: holds no cloud and no sample")
    except ForetouchError as err:
        yield path, err


def error_line(name: str, err: ForetouchError) -> str:
    """Return the message of an error, with the name of the input where it lacks it."""
    text = str(err)
    return text if name in text or shown(name) in text else f"{shown(name)}: {text}"
