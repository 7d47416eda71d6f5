# SPDX-License-Identifier: Apache-2.0
"""`foretouch view`: show clouds, grasps, predicted touch and readings in Rerun."""

import argparse
import itertools
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.cli import inputs
from foretouch.cli.adaptation import Adaptation, read_adaptation
from foretouch.cli.output import progress_bar, warn
from foretouch.dataset.record import DISCARDED, SampleRecord, readings
from foretouch.dataset.samples import SampleSet, has_points, is_sample_set, open_samples, sensor_of_samples
from foretouch.dataset.source import SourceItem, open_source
from foretouch.errors import ForetouchError
from foretouch.files import require_existing, require_writable
from foretouch.pipeline import FoundObject, Pipeline
from foretouch.report.rerun_view import ViewStep, write_view
from foretouch.report.rerun_viewer import open_viewer, save_screenshot
from foretouch.tactile.description import require_same
from foretouch.types import Cloud, Grasp, GraspSample, Touch


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("path", metavar="PATH", help="a cloud, a folder of clouds, a dataset or a recording")
    parser.add_argument("--save", type=Path, metavar="F.rrd", help="write a file for Rerun instead of opening a window")
    parser.add_argument("--screenshot", type=Path, metavar="F.png", help="draw a picture instead of opening a window")
    parser.add_argument(
        "--count", type=inputs.positive_number, metavar="N", help="show the first N clouds or samples (default: all)"
    )
    inputs.add_options(parser, "--topic", "--config", "--set", "--model", *inputs.PLANNED, *inputs.ADAPTED)


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a cloud could not be read."""
    path = require_existing(arguments.path)
    for out, suffix in ((arguments.save, ".rrd"), (arguments.screenshot, ".png")):
        if out is not None:
            require_writable(out, suffix)
    steps = _Steps(arguments)
    with tempfile.TemporaryDirectory(prefix="foretouch-view-") as folder:
        file = arguments.save or Path(folder) / "view.rrd"
        with progress_bar("reading", arguments.count) as advance:
            counted = (step for step in itertools.islice(steps, arguments.count) if advance() is None)
            write_view(file, counted, f"foretouch view {path}", steps.sensor)
        if arguments.screenshot:
            save_screenshot(file, arguments.screenshot)
        if not (arguments.save or arguments.screenshot):
            open_viewer(file)
    for written in filter(None, (arguments.save, arguments.screenshot)):
        warn(f"wrote {written}")
    return int(steps.failed)


class _Steps:
    """Makes the steps of the view, whose inputs are as those of `predict`."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.failed = False  # whether an input could not be read
        self._arguments = arguments
        self._pipeline = Pipeline(inputs.pipeline_config(arguments, defaults={"grasp.count": 10}))
        self._adaptation: Adaptation
        samples = arguments.topic is None and is_sample_set(arguments.path)
        self._samples = open_samples(arguments.path, unfinished=True) if samples else None
        self._without_camera = False
        if self._samples is None:
            self.sensor = self._pipeline.model.sensor
        else:
            self._without_camera = len(self._samples) > 0 and not has_points(self._samples.record(0).sample)
            self.sensor = sensor_of_samples(self._samples) if self._without_camera else self._samples.sensor

    def __iter__(self) -> Iterator[ViewStep]:
        if self._samples is not None and self._without_camera:
            return self._of_readings(self._samples)
        return self._of_source()

    def _of_source(self) -> Iterator[ViewStep]:
        """A step for each cloud, or sample that was not discarded, with the touch that the model predicts now."""
        require_same(self._pipeline.model.sensor.channels, self.sensor.channels, f"model {self._pipeline.model.name}")
        self._adaptation = read_adaptation(self._arguments, self._pipeline.model)
        if self._samples is not None:
            for k in range(len(self._samples)):
                try:
                    record = self._samples.record(k)
                    if DISCARDED not in record.flags:
                        yield self._of_sample(record)
                except ForetouchError as err:
                    self._refuse(self._samples.name(k), err)
            return
        source = open_source(self._arguments.path, topic=self._arguments.topic)
        for item in source:
            try:
                yield self._of_cloud(item, stamped=source.kind == "recording")
            except ForetouchError as err:
                self._refuse(item.name, err)

    def _of_readings(self, samples: SampleSet) -> Iterator[ViewStep]:
        """The readings of all samples of a recording without a camera, with what became of their grasp."""
        for record in samples.records():
            series, tare, name = readings(record), record.sample.tare, f"{record.sample.id}: {record.outcome}"
            for stamp, counts in () if series is None else zip(series.stamps_ns.tolist(), series.counts, strict=True):
                read = Touch(counts.astype(np.float64), samples.sensor.channels)
                yield ViewStep(name=name, stamp_ns=stamp, read=read, tare=tare, reason="recorded without a camera")

    def _refuse(self, name: str, err: ForetouchError) -> None:
        self.failed = True
        warn(inputs.error_line(name, err))

    def _of_cloud(self, item: SourceItem, *, stamped: bool) -> ViewStep:
        found, target = self._found(item.cloud)
        shown = {"name": item.name, "stamp_ns": item.cloud.stamp_ns if stamped else 0, **found}
        if target is None:
            return ViewStep(**shown)
        plan = self._pipeline.plan(target)
        if not plan.grasps:
            return ViewStep(**shown, reason=f"{plan.status}: {plan.reason}")
        return ViewStep(**shown, **self._predicted(target, plan.grasps[0], None), candidates=plan.grasps[1:])

    def _of_sample(self, record: SampleRecord) -> ViewStep:
        sample = record.sample
        target = inputs.only_object(sample.cloud, self._arguments)
        shown: dict[str, Any] = {"cloud": sample.cloud, "table": target.plane, "candidates": record.candidates}
        shown |= {"stamp_ns": sample.stamp_ns, "read": sample.touch, "tare": sample.tare}
        return ViewStep(name=sample.id, **shown, **self._predicted(target, sample.grasp, sample))

    def _predicted(self, target: FoundObject, grasp: Grasp, sample: GraspSample | None) -> dict[str, Any]:
        (prediction,) = self._adaptation.predict(self._pipeline, target, [grasp], sample)
        return {"grasp": prediction.grasp, "prediction": prediction, "model": self._pipeline.model.name}

    def _found(self, cloud: Cloud) -> tuple[dict[str, Any], FoundObject | None]:
        """Table and objects of a cloud, the target first, as `predict` finds them; and the target, if there is one."""
        if inputs.holds_one_object(cloud, self._arguments):
            target = inputs.only_object(cloud, self._arguments)
            return {"cloud": cloud, "table": target.plane}, target
        scene = self._pipeline.segment(cloud)
        objects = {one.id: one.cloud for one in scene.targets[:1]}
        objects |= {str(one.id): one.cloud for one in scene.segmentation.objects if str(one.id) not in objects}
        found = {"cloud": cloud, "table": scene.segmentation.plane, "objects": objects}
        if not scene.targets:
            return {**found, "reason": f"{scene.status}: {scene.reason}"}, None
        return found, scene.targets[0]
