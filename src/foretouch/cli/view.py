# SPDX-License-Identifier: Apache-2.0
"""`foretouch view`: show clouds, grasps, predicted touch and readings in Rerun."""

import argparse
import itertools
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foretouch.base.files import require_existing, require_writable
from foretouch.cli import inputs
from foretouch.cli.adaptation import Adaptation, read_adaptation
from foretouch.cli.output import progress_bar, warn
from foretouch.cli.parser import CommandParser
from foretouch.dataset.formats import is_sample_set, open_samples
from foretouch.dataset.samples import SampleSet, sensor_of_samples
from foretouch.dataset.source import SourceItem, open_source
from foretouch.errors import ConfigError, ForetouchError
from foretouch.pipeline import Pipeline
from foretouch.report.rerun_view import ViewStep, open_viewer, save_screenshot, write_view
from foretouch.tactile.description import require_same
from foretouch.types import DISCARDED, Grasp, Sample, Touch
from foretouch.types.scene import Object


def add_arguments(parser: CommandParser) -> None:
    """Declare the options."""
    parser.add_argument("path", metavar="PATH", help="a cloud, a folder of clouds, a dataset or a recording")
    parser.add_argument("--save", type=Path, metavar="F.rrd", help="write a file for Rerun instead of opening a window")
    parser.add_argument("--screenshot", type=Path, metavar="F.png", help="draw a picture instead of opening a window")
    parser.add_argument(
        "--count", type=inputs.positive_number, metavar="N", help="show the first N clouds or samples (default: all)"
    )
    inputs.add_options(
        parser,
        "--topic",
        *inputs.CAMERA,
        "--config",
        "--set",
        "--model",
        "--predictor",
        *inputs.PLANNED,
        *inputs.ADAPTED,
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a cloud could not be read."""
    path = require_existing(arguments.path)
    for out, suffix in ((arguments.save, ".rrd"), (arguments.screenshot, ".png")):
        if out is not None:
            require_writable(out, suffix)
    pipeline = Pipeline(inputs.pipeline_config(arguments, defaults={"grasp.count": 10}))
    is_set = arguments.topic is None and is_sample_set(path)
    if is_set:
        inputs.depth_camera(arguments).require_none(path, "is a dataset, whose clouds are stored")
        _require_unset(arguments, "--scene", "--target", "--hand")
    samples, refused = open_samples(path, unfinished=True) if is_set else None, list[str]()
    sensor = pipeline.model.sensor if samples is None else samples.sensor
    if samples is not None and len(samples) and not len(samples.read(0).cloud.finite):
        _require_unset(arguments, "--plane", "--model", "--config", "--set", *inputs.ADAPTED)
        sensor, steps = sensor_of_samples(samples), _readings(samples)
    else:
        require_same(pipeline.model.sensor.channels, sensor.channels, f"model {pipeline.model.name}")
        view = _View(arguments, pipeline, read_adaptation(arguments, pipeline.model))
        steps = _steps(view, samples, refused)
    with tempfile.TemporaryDirectory(prefix="foretouch-view-") as folder:
        file = arguments.save or Path(folder) / "view.rrd"
        with progress_bar("reading", arguments.count) as advance:
            counted = (step for step in itertools.islice(steps, arguments.count) if advance() is None)
            write_view(file, counted, f"foretouch view {path}", sensor)
        if arguments.screenshot:
            save_screenshot(file, arguments.screenshot)
        if not (arguments.save or arguments.screenshot):
            open_viewer(file)
    for written in filter(None, (arguments.save, arguments.screenshot)):
        warn(f"wrote {written}")
    return int(bool(refused))


def _require_unset(arguments: argparse.Namespace, *options: str) -> None:
    """Refuse options that samples have no use for, by a `ConfigError`."""
    for option in options:
        if getattr(arguments, option.removeprefix("--")) not in (None, False, []):
            raise ConfigError(
                f"{option}: is not for the samples of {arguments.path}, which are shown as they were recorded"
            )


def _readings(samples: SampleSet) -> Iterator[ViewStep]:
    """Iterate over the readings of all samples of a recording without a camera, with what became of their grasp."""
    for sample in samples:
        series = sample.readings
        tare = sample.tare
        name = f"{sample.id}: {sample.outcome}"
        for stamp, counts in () if series is None else zip(series.stamps_ns.tolist(), series.counts, strict=True):
            read = Touch(counts.astype(np.float64), samples.sensor.channels)
            yield ViewStep(name=name, stamp_ns=stamp, read=read, tare=tare, reason="recorded without a camera")


class _View(NamedTuple):
    """What steps are made with; `predict` takes the same inputs."""

    arguments: argparse.Namespace
    pipeline: Pipeline
    adaptation: Adaptation


def _steps(view: _View, samples: SampleSet | None, refused: list[str]) -> Iterator[ViewStep]:
    """Iterate over a step for each cloud, or sample that was not discarded, with the touch that the model predicts now; names of others are kept."""
    made: Iterator[tuple[str, Callable[[], ViewStep | None]]]
    remarks: list[str] = []
    if samples is None:
        source = open_source(
            view.arguments.path, topic=view.arguments.topic, camera=inputs.depth_camera(view.arguments)
        )
        for note in source.notes:
            warn(note)
        remarks = source.remarks
        made = ((item.name, partial(_of_cloud, view, item, stamped=source.kind == "recording")) for item in source)
    else:
        made = ((samples.name(k), partial(_of_sample, view, samples, k)) for k in range(len(samples)))
    for name, make in made:
        try:
            step = make()
        except ForetouchError as err:
            refused.append(name)
            warn(inputs.error_line(name, err))
        else:
            if step is not None:
                yield step
    for remark in remarks:
        warn(remark)


def _of_sample(view: _View, samples: SampleSet, number: int) -> ViewStep | None:
    """Return the step of a sample; None if the operator has discarded it."""
    sample = samples.read(number)
    if DISCARDED in sample.flags:
        return None
    target = inputs.only_object(sample.cloud, view.arguments, sample)
    shown: dict[str, Any] = {"cloud": sample.cloud, "table": target.plane, "candidates": sample.candidates}
    shown |= {"stamp_ns": sample.stamp_ns, "read": sample.touch, "tare": sample.tare}
    return ViewStep(name=sample.id, **shown, **_predicted(view, target, sample.grasp, sample))


def _of_cloud(view: _View, item: SourceItem, *, stamped: bool) -> ViewStep:
    """Return the step of a cloud: table and objects, the target first, as `predict` finds them."""
    cloud, target = item.cloud, None
    shown: dict[str, Any] = {"name": item.name, "cloud": cloud, "stamp_ns": cloud.stamp_ns if stamped else 0}
    if inputs.holds_one_object(cloud, view.arguments):
        if view.arguments.target:
            raise ConfigError("--target: is for the objects of a scene, and this cloud is one object; add --scene")
        target = inputs.only_object(cloud, view.arguments)
        shown["table"] = target.plane
    else:
        scene = view.pipeline.segment(cloud)
        objects = {shown_object.id: shown_object.cloud for shown_object in scene.targets[:1]}
        objects |= {object_.id: object_.cloud for object_ in scene.objects if object_.id not in objects}
        shown |= {"table": scene.table, "outline": scene.outline, "objects": objects, "labels": scene.labels}
        if not scene.targets:
            return ViewStep(**shown, reason=f"{scene.status}: {scene.reason}")
        target = scene.targets[0]
    plan = view.pipeline.plan(target)
    if not plan.grasps:
        return ViewStep(**shown, reason=f"{plan.status}: {plan.reason}")
    return ViewStep(**shown, **_predicted(view, target, plan.grasps[0], None), candidates=plan.grasps[1:])


def _predicted(view: _View, target: Object, grasp: Grasp, sample: Sample | None) -> dict[str, Any]:
    (prediction,) = view.adaptation.predict(view.pipeline, target, [grasp], sample)
    return {"grasp": prediction.grasp, "prediction": prediction, "model": view.pipeline.model.name}
